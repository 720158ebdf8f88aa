//! A progress bar with cycles and remaining time; plain lines where stderr is no terminal.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};

/// Plain lines come at each tenth of the way.
const PLAIN_STEPS: f64 = 10.0;

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ProgressMark {
    /// Seconds done.
    pub elapsed_s: f64,
    /// Seconds to go.
    pub remaining_s: f64,
    /// Counted cycles done.
    pub cycles: u32,
    /// Counted cycles in all.
    pub cycles_total: u32,
}

impl ProgressMark {
    fn share(&self) -> f64 {
        let total = self.elapsed_s + self.remaining_s;
        if total > 0.0 { self.elapsed_s / total } else { 0.0 }
    }

    fn text(&self) -> String {
        let cycles = match self.cycles_total {
            0 => String::new(),
            total => format!("cycle {} of {total}, ", self.cycles),
        };
        format!("{cycles}{} left", duration(self.remaining_s))
    }
}

/// `1 h 05 min`, `2 min 03 s`, `8 s`.
pub(super) fn duration(seconds: f64) -> String {
    let s = seconds.max(0.0).round() as u64;
    match (s / 3600, s / 60 % 60, s % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s:02} s"),
        (h, m, _) => format!("{h} h {m:02} min"),
    }
}

/// Progress of one thing, on stderr.
pub(super) struct Progress {
    bar: Option<ProgressBar>,
    name: String,
    told: u32,
    silent: bool,
}

impl Progress {
    /// `silent`: nothing at all (for scripts).
    pub(super) fn new(name: &str, silent: bool) -> Progress {
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
            told: 0,
            silent,
        }
    }

    /// Moves on.
    pub(super) fn show(&mut self, mark: ProgressMark) {
        if let Some(bar) = &self.bar {
            bar.set_position((1000.0 * mark.share()) as u64);
            bar.set_message(mark.text());
            return;
        }
        let step = (PLAIN_STEPS * mark.share()) as u32;
        if !self.silent && step > self.told {
            self.told = step;
            eprintln!("{}: {} %, {}", self.name, step * 10, mark.text());
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_read_as_people_say_them() {
        assert_eq!(duration(7.6), "8 s");
        assert_eq!(duration(123.0), "2 min 03 s");
        assert_eq!(duration(3900.0), "1 h 05 min");
        assert_eq!(duration(-1.0), "0 s");
    }

    #[test]
    fn a_mark_tells_cycles_only_where_there_are_some() {
        let mark = ProgressMark {
            elapsed_s: 30.0,
            remaining_s: 90.0,
            cycles: 3,
            cycles_total: 50,
        };
        assert_eq!(mark.share(), 0.25);
        assert_eq!(mark.text(), "cycle 3 of 50, 1 min 30 s left");
        assert_eq!(
            ProgressMark {
                cycles_total: 0,
                ..mark
            }
            .text(),
            "1 min 30 s left"
        );
    }
}
