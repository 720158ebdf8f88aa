//! A progress bar with what is being done and the remaining time; plain lines where stderr is no terminal.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::control::RigStatus;

/// A run in virtual time gets a plain line at most this often: most are over before.
const PLAYED_LINES: Duration = Duration::from_secs(2);
/// Number of plain lines over the whole way.
const PLAIN_LINES: f64 = 10.0;

/// Progress of one run, fit or diagnosis, on stderr.
pub(crate) struct Progress {
    bar: Option<ProgressBar>,
    name: String,
    begun: Instant,
    lines_printed: u32,
    silent: bool,
}

impl Progress {
    /// `silent` shows nothing at all (for scripts).
    pub(crate) fn new(name: &str, silent: bool) -> Progress {
        let bar = (!silent && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::new(1000);
            let style = ProgressStyle::with_template("{prefix} [{bar:40}] {percent:>3} %  {msg}");
            bar.set_style(
                style
                    .unwrap_or_else(|_| ProgressStyle::default_bar())
                    .progress_chars("=> "),
            );
            bar.set_prefix(name.to_owned());
            bar
        });
        Progress {
            bar,
            name: name.to_owned(),
            begun: Instant::now(),
            lines_printed: 0,
            silent,
        }
    }

    /// Shows a run on a rig: its counted cycles and the time that its profile still takes.
    pub(crate) fn show_run(&mut self, status: &RigStatus) {
        self.show(share(status), &message(&cycles(status), Some(status.remaining_s)));
    }

    /// Shows a run in virtual time. Its own seconds are not those of the one who waits, so the time left follows from the speed.
    pub(crate) fn show_played(&mut self, status: &RigStatus) {
        let (share, elapsed) = (share(status), self.begun.elapsed());
        let due = PLAYED_LINES * (self.lines_printed + 1);
        if self.bar.is_some() {
            self.show_share(share, &cycles(status));
        } else if !self.silent && elapsed > due {
            self.lines_printed += 1;
            let message = message(&cycles(status), remaining_s(share, elapsed.as_secs_f64()));
            eprintln!("{}: {:.0} %, {message}", self.name, 100.0 * share);
        }
    }

    /// Shows a computation: the share that is done, 0 to 1, and the step in words. The remaining time follows from the time so far.
    pub(crate) fn show_share(&mut self, share: f64, step: &str) {
        let remaining_s = remaining_s(share, self.begun.elapsed().as_secs_f64());
        self.show(share, &message(step, remaining_s));
    }

    fn show(&mut self, share: f64, message: &str) {
        if let Some(bar) = &self.bar {
            bar.set_position((1000.0 * share) as u64);
            bar.set_message(message.to_owned());
            return;
        }
        let lines = (PLAIN_LINES * share) as u32;
        if !self.silent && lines > self.lines_printed {
            self.lines_printed = lines;
            eprintln!("{}: {} %, {message}", self.name, lines * 10);
        }
    }

    /// Removes the bar from the terminal.
    pub(crate) fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

/// Share of the profile that is done, 0 to 1.
fn share(status: &RigStatus) -> f64 {
    let total_s = status.elapsed_s + status.remaining_s;
    if total_s > 0.0 {
        status.elapsed_s / total_s
    } else {
        0.0
    }
}

/// The counted cycles in words; empty for a profile without any.
fn cycles(status: &RigStatus) -> String {
    match status.cycles_total {
        0 => String::new(),
        total => format!("cycle {} of {total}", status.cycles_completed),
    }
}

/// Remaining time at the speed so far; none where nothing or all is done.
fn remaining_s(share: f64, elapsed_s: f64) -> Option<f64> {
    (share > 0.0 && share < 1.0).then(|| elapsed_s * (1.0 - share) / share)
}

/// `step, 1 min 30 s left`, without the part that is not known.
fn message(step: &str, remaining_s: Option<f64>) -> String {
    let left = remaining_s.map(|s| format!("{} left", duration(s)));
    let parts = [Some(step.to_owned()).filter(|s| !s.is_empty()), left];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// A duration in s as `1 h 05 min`, `2 min 03 s` or `8 s`.
pub(crate) fn duration(seconds: f64) -> String {
    let s = seconds.max(0.0).round() as u64;
    match (s / 3600, s / 60 % 60, s % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s:02} s"),
        (h, m, _) => format!("{h} h {m:02} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_two_units_at_most() {
        assert_eq!(duration(7.6), "8 s");
        assert_eq!(duration(123.0), "2 min 03 s");
        assert_eq!(duration(3900.0), "1 h 05 min");
        assert_eq!(duration(-1.0), "0 s");
    }

    #[test]
    fn a_message_has_the_step_and_the_remaining_time() {
        assert_eq!(
            message("cycle 3 of 50", Some(90.0)),
            "cycle 3 of 50, 1 min 30 s left"
        );
        assert_eq!(message("", Some(90.0)), "1 min 30 s left");
        assert_eq!(message("comparing candidates", None), "comparing candidates");
    }

    #[test]
    fn the_remaining_time_follows_from_the_speed_so_far() {
        assert_eq!(remaining_s(0.25, 30.0), Some(90.0));
        assert_eq!(remaining_s(0.0, 30.0), None);
        assert_eq!(remaining_s(1.0, 30.0), None);
    }
}
