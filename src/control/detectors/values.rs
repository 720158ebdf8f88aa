//! The second layer of limits: readings beyond the limits of the bench, and sensors without a reading. The firmware acts
//! within 2 ms; these act only where it does not.

use crate::control::channel::Reading;
use crate::control::physical_limits::PhysicalLimits;
use crate::recording::Flags;

/// Samples in a row that make a finding: 5 ms, after the firmware's own reaction and its STATUS.
const SAMPLES_IN_A_ROW: u32 = 5;

/// A channel, what is wrong with it, and for how many samples in a row.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ValueWatch {
    force_over: u32,
    displacement_over: u32,
    force_invalid: u32,
    displacement_invalid: u32,
}

impl ValueWatch {
    /// Takes a reading. Returns what is wrong and what to do.
    pub(super) fn take(&mut self, reading: &Reading, limits: &PhysicalLimits) -> Option<String> {
        let no_force = reading.flags.contains(Flags::FORCE_INVALID);
        let no_displacement = reading.flags.contains(Flags::DISPLACEMENT_INVALID);
        let (x, f) = (reading.displacement_mm, reading.force_n);
        let (f_min, f_max) = (limits.force_min_n, limits.force_max_n);
        let (x_min, x_max) = (limits.displacement_min_mm, limits.displacement_max_mm);
        if in_a_row(&mut self.force_invalid, no_force) {
            return Some(no_reading("load cell"));
        }
        if in_a_row(&mut self.displacement_invalid, no_displacement) {
            return Some(no_reading("LVDT"));
        }
        let over = in_a_row(&mut self.force_over, !no_force && !(f_min..=f_max).contains(&f));
        if over {
            return Some(beyond("force", f, f_min, f_max, "N"));
        }
        let outside = !no_displacement && !(x_min..=x_max).contains(&x);
        in_a_row(&mut self.displacement_over, outside).then(|| beyond("displacement", x, x_min, x_max, "mm"))
    }
}

fn no_reading(sensor: &str) -> String {
    format!(
        "the {sensor} has had no valid reading for {SAMPLES_IN_A_ROW} ms and the rig did not unload by itself: check sensor, cable and firmware"
    )
}

fn beyond(what: &str, value: f64, low: f64, high: f64, unit: &str) -> String {
    format!(
        "{what} {value:.2} {unit} is beyond the limits {low} to {high} {unit} and the rig did not react by itself: check the firmware before the next run"
    )
}

/// Counts samples in a row; true from [`SAMPLES_IN_A_ROW`] on.
fn in_a_row(count: &mut u32, on: bool) -> bool {
    *count = if on { count.saturating_add(1) } else { 0 };
    *count >= SAMPLES_IN_A_ROW
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(force_n: f64, displacement_mm: f64, flags: Flags) -> Reading {
        Reading {
            force_n,
            displacement_mm,
            flags,
        }
    }

    fn found(reading: Reading) -> String {
        let limits = PhysicalLimits::EXAMPLE;
        let mut watch = ValueWatch::default();
        for _ in 1..SAMPLES_IN_A_ROW {
            assert_eq!(watch.take(&reading, &limits), None);
        }
        watch.take(&reading, &limits).unwrap_or_default()
    }

    #[test]
    fn values_beyond_a_limit_are_found_after_five_samples() {
        let none = Flags::default();
        assert!(found(reading(5526.0, 10.0, none)).contains("force 5526.00 N"));
        assert!(found(reading(-1634.0, 10.0, none)).contains("force -1634.00 N"));
        assert!(found(reading(0.0, 60.0, none)).contains("displacement 60.00 mm"));
        assert!(
            found(reading(f64::NAN, 0.0, none)).contains("force"),
            "NaN is in no range"
        );
        assert_eq!(found(reading(1000.0, 10.0, none)), "");
    }

    #[test]
    fn a_sensor_without_reading_is_found_and_its_value_not_judged() {
        assert!(found(reading(-13_107.2, 10.0, Flags::FORCE_INVALID)).contains("load cell"));
        assert!(found(reading(0.0, -65.5, Flags::DISPLACEMENT_INVALID)).contains("LVDT"));
    }

    #[test]
    fn a_spike_is_no_finding() {
        let limits = PhysicalLimits::EXAMPLE;
        let mut watch = ValueWatch::default();
        for k in 0..100 {
            let force_n = if k % 5 == 0 { 100.0 } else { 9000.0 };
            let taken = watch.take(&reading(force_n, 1.0, Flags::default()), &limits);
            assert_eq!(taken, None, "four of five samples");
        }
    }
}
