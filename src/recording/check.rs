//! Checks a recording that another program put together: columns of equal length, finite values, time that rises.

use super::Recording;

/// Why columns are no recording. Places are indices from 0, because they are in memory and not in a file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name}, column {column}{}: {reason}", index.map_or(String::new(), |i| format!(", index {i}")))]
pub struct RecordingError {
    /// Name of the recording.
    pub name: String,
    /// Name of the column.
    pub column: &'static str,
    /// Sample, from 0, if it is one sample.
    pub index: Option<usize>,
    /// What is wrong and what to do.
    pub reason: String,
}

impl Recording {
    /// Refuses columns of different length, values that are not finite, and time that does not rise. NaN is allowed in `command`.
    pub fn check(&self) -> Result<(), RecordingError> {
        let error = |column, index, reason| RecordingError {
            name: self.name.clone(),
            column,
            index,
            reason,
        };
        if self.is_empty() {
            return Err(error(
                "time_s",
                None,
                "there are no samples: give at least one".to_owned(),
            ));
        }
        for (column, length) in self.lengths() {
            if length != self.len() {
                let reason = format!(
                    "it has {length} values and time_s has {}: give one value for each sample",
                    self.len()
                );
                return Err(error(column, None, reason));
            }
        }
        let finite = [
            ("time_s", &self.time_s),
            ("displacement_mm", &self.displacement_mm),
            ("force_n", &self.force_n),
        ];
        for (column, values) in finite {
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                let reason = format!(
                    "{} is not a finite number: correct or remove the sample",
                    values[index]
                );
                return Err(error(column, Some(index), reason));
            }
        }
        let falls = self.time_s.windows(2).position(|pair| pair[1] <= pair[0]);
        if let Some(before) = falls {
            let reason = format!(
                "{} s comes after {} s, but time must rise: sort the samples by time and remove repeated ones",
                self.time_s[before + 1],
                self.time_s[before]
            );
            return Err(error("time_s", Some(before + 1), reason));
        }
        Ok(())
    }

    /// Number of values of each column that is there.
    fn lengths(&self) -> Vec<(&'static str, usize)> {
        let optional = [
            ("command", self.command.as_ref().map(Vec::len)),
            ("cycle", self.cycle.as_ref().map(Vec::len)),
            ("flags", self.flags.as_ref().map(Vec::len)),
        ];
        let needed = [
            ("displacement_mm", self.displacement_mm.len()),
            ("force_n", self.force_n.len()),
        ];
        let there = optional
            .into_iter()
            .filter_map(|(name, length)| Some((name, length?)));
        needed.into_iter().chain(there).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_mistake_is_named_with_its_column_and_index() {
        let sound = Recording {
            name: "a".to_owned(),
            time_s: vec![0.0, 1.0, 2.0],
            displacement_mm: vec![0.0; 3],
            force_n: vec![0.0; 3],
            command: Some(vec![f64::NAN; 3]),
            ..Recording::default()
        };
        assert_eq!(sound.check(), Ok(()));
        let place = |change: &dyn Fn(&mut Recording)| {
            let mut wrong = sound.clone();
            change(&mut wrong);
            wrong.check().map_err(|e| (e.column, e.index))
        };
        assert_eq!(place(&|r| r.time_s.clear()), Err(("time_s", None)));
        assert_eq!(place(&|r| r.force_n.truncate(2)), Err(("force_n", None)));
        assert_eq!(place(&|r| r.cycle = Some(vec![1])), Err(("cycle", None)));
        assert_eq!(place(&|r| r.force_n[1] = f64::NAN), Err(("force_n", Some(1))));
        assert_eq!(place(&|r| r.time_s[2] = 1.0), Err(("time_s", Some(2))));
    }
}
