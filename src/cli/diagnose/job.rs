//! `diagnose --job`: a diagnosis that the daemon started. It takes a low priority, prints its progress as lines of JSON,
//! and ends when the daemon ends.

use std::io::{Read, Write};

/// Exit code of a job whose daemon has ended; nobody is left to read it.
const DAEMON_GONE: i32 = 3;
/// A line is printed when the share has grown by this, or when the step is another one.
const LEAST_GROWTH: f64 = 0.005;

/// Gives way to everything else on this computer, and ends this process when its stdin is closed.
pub(super) fn begin() {
    give_way();
    // If memory runs out, this process is ended, not the daemon. Linux without /proc decides by itself.
    let _ = std::fs::write("/proc/self/oom_score_adj", "1000");
    std::thread::spawn(|| {
        let _ = std::io::stdin().lock().read_to_end(&mut Vec::new());
        std::process::exit(DAEMON_GONE);
    });
}

/// Niceness 10 on the scale 0 to 99 of the crate, 99 being the most urgent. Niceness 0 gets nine times the share of the
/// processor; at 19 it would get seventy times, and a diagnosis beside another busy program would not end.
const NICE_10: u8 = 22;

/// This thread, and the threads that it starts, give way to others. The control thread has its real-time priority besides.
fn give_way() {
    use thread_priority::{
        NormalThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    };
    let Ok(low) = ThreadPriorityValue::try_from(NICE_10) else {
        return;
    };
    // Fails where this program is nicer already.
    let _ = thread_priority::set_thread_priority_and_policy(
        thread_priority::thread_native_id(),
        ThreadPriority::Crossplatform(low),
        ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Batch),
    );
}

/// Prints progress on stdout: `{"share": 0.25, "step": "..."}`.
#[derive(Debug, Default)]
pub(super) struct ProgressLines {
    printed: Option<(f64, String)>,
}

impl ProgressLines {
    /// `share` is what is done, 0 to 1; `step` is in words.
    pub(super) fn show(&mut self, share: f64, step: &str) {
        let is_same = |(before, words): &(f64, String)| share < before + LEAST_GROWTH && words == step;
        if self.printed.as_ref().is_some_and(is_same) {
            return;
        }
        self.printed = Some((share, step.to_owned()));
        // The diagnosis goes on without its reader until stdin closes.
        let _ = writeln!(
            std::io::stdout().lock(),
            "{}",
            serde_json::json!({ "share": share, "step": step })
        );
    }
}
