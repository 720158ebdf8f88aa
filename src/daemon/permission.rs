//! What must be right before a run besides the state of the rig: calibrations that are not overdue, and the specimen that the
//! bench file describes. A person may answer for a start all the same; their name goes into the header of the recording.

use axum::http::StatusCode;
use jiff::civil::Date;

use super::error::ApiError;
use crate::config::Bench;

/// Longest name of a person, characters.
const NAME_MAX_CHARS: usize = 80;

/// Remarks for the header of a run of `specimen` on the day `today` (UTC). Refused if something is not right and nobody answers
/// for it: `override_by` is the name of the person who does.
pub(super) fn remarks(
    bench: &Bench,
    specimen: &str,
    today: Date,
    override_by: Option<&str>,
) -> Result<Vec<String>, ApiError> {
    let mut objections = overdue(bench, today);
    objections.extend(foreign(bench, specimen));
    let name = override_by.map(str::trim).filter(|name| !name.is_empty());
    match name {
        _ if objections.is_empty() => Ok(Vec::new()),
        Some(name) => {
            let name: String = name.chars().take(NAME_MAX_CHARS).collect();
            let remark = |objection| format!("override by {name}: {objection}");
            Ok(objections.into_iter().map(remark).collect())
        }
        None => Err(ApiError::new(
            StatusCode::CONFLICT,
            objections.join("; "),
            "correct the bench file; or, if you answer for it, start with your name: --override NAME, on the page the field \
             Override"
                .to_owned(),
        )),
    }
}

/// One sentence for each calibration that is overdue on the day `today`. The day on which it is due is still allowed.
pub(super) fn overdue(bench: &Bench, today: Date) -> Vec<String> {
    let (force, displacement) = (&bench.force_channel, &bench.displacement_channel);
    let channels = [
        ("load cell", &force.certificate, &force.due),
        ("LVDT", &displacement.certificate, &displacement.due),
    ];
    // The config has checked that the text is a date.
    let late = channels
        .into_iter()
        .filter(|(.., due)| due.parse::<Date>().is_ok_and(|due| due < today));
    late.map(|(sensor, certificate, due)| {
        format!(
            "the calibration of the {sensor} (certificate {certificate}) was due on {due}, and today is {today} (UTC)"
        )
    })
    .collect()
}

/// The objection to a specimen that is not the bench's. `leaf 7` of the bench file stands for one spring, `leaf` also for
/// `leaf-7`, `leaf 8` and every other name that begins with it as a whole word.
fn foreign(bench: &Bench, specimen: &str) -> Option<String> {
    let own = bench.specimen.name.as_str();
    let one_of_its_kind = specimen
        .strip_prefix(own)
        .is_some_and(|rest| !rest.starts_with(char::is_alphanumeric));
    (!one_of_its_kind).then(|| {
        format!(
            "the specimen is \"{specimen}\", but model and limits of the bench file are for \"{own}\" (a single spring of that \
             kind is \"{own} 7\")"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bench() -> Bench {
        let mut bench = Bench::shipped().expect("built in");
        bench.force_channel.due = "2026-11-22".to_owned();
        bench
    }

    fn day(text: &str) -> Date {
        text.parse().expect("a date")
    }

    #[test]
    fn a_calibration_holds_until_its_day_is_over() {
        assert!(remarks(&bench(), "samurai-front", day("2026-11-22"), None).is_ok_and(|r| r.is_empty()));
        let refused = remarks(&bench(), "samurai-front", day("2026-11-23"), None).expect_err("overdue");
        assert_eq!(refused.status(), StatusCode::CONFLICT);
        let why = overdue(&bench(), day("2026-11-23")).join("; ");
        assert_eq!(
            why,
            "the calibration of the load cell (certificate mock) was due on 2026-11-22, and today is 2026-11-23 (UTC)"
        );
    }

    #[test]
    fn a_specimen_of_another_kind_is_foreign_and_a_single_one_of_the_kind_is_not() {
        for own in [
            "samurai-front",
            "samurai-front 7",
            "samurai-front-7",
            "samurai-front #b",
        ] {
            assert_eq!(foreign(&bench(), own), None, "{own}");
        }
        for other in ["leaf 7", "samurai-frontier", "", "samurai"] {
            assert!(foreign(&bench(), other).is_some(), "{other}");
        }
    }

    #[test]
    fn a_name_overrides_and_is_recorded_with_each_objection() {
        let today = day("2027-01-01");
        let remarks = remarks(&bench(), "leaf 7", today, Some(" R. Meier ")).expect("overridden");
        assert_eq!(remarks.len(), 2, "{remarks:?}");
        assert!(
            remarks
                .iter()
                .all(|r| r.starts_with("override by R. Meier: the ")),
            "{remarks:?}"
        );
        assert!(super::remarks(&bench(), "leaf 7", today, Some("  ")).is_err());
    }
}
