//! `leafbench status`.

use super::client::{Client, data_argument};
use super::progress::duration;
use super::{Command, Done};
use crate::control::Phase;
use crate::daemon::client_types::Status;

/// See [`super::COMMANDS`].
pub(super) const COMMAND: Command = Command {
    name: "status",
    what: "Show what the bench is doing",
    arguments: |command| command.arg(data_argument()),
    run: |matches, output| {
        let client = Client::of(matches)?;
        let status: Status = client.get("/api/status")?;
        output.result(&status, || text(&status, &client.page()))?;
        Ok(Done::Well)
    },
};

/// The phase in a word for people.
pub(super) fn phase_word(phase: Phase) -> &'static str {
    match phase {
        Phase::Connecting => "no rig: it is not heard yet",
        Phase::Ready => "ready",
        Phase::Arming => "arming",
        Phase::Running => "running",
        Phase::Held => "on hold: resume or stop",
        Phase::Unloading => "unloading",
        Phase::Interlocked => "interlocked: remove the cause, then `leafbench reset`",
    }
}

fn text(s: &Status, page: &str) -> String {
    let reading = |value: Option<f64>, digits: usize, unit: &str| {
        value.map_or("no reading".to_owned(), |v| format!("{v:.digits$} {unit}"))
    };
    let mut lines = vec![
        format!("bench         {} at {}, page {page}", s.bench, s.link),
        format!("state         {}", phase_word(s.rig.phase)),
        format!("force         {}", reading(s.rig.force_n, 1, "N")),
        format!("displacement  {}", reading(s.rig.displacement_mm, 3, "mm")),
    ];
    if let (Some(run), Some(profile)) = (&s.rig.run_id, &s.rig.profile) {
        lines.push(format!(
            "run           {run} ({profile}), cycle {} of {}, {} left",
            s.rig.cycles_completed,
            s.rig.cycles_total,
            duration(s.rig.remaining_s)
        ));
    } else if let Some(run) = &s.run {
        let ending = run.ending.as_deref().unwrap_or("not started");
        lines.push(format!(
            "last run      {} ({}), {ending} {}",
            run.run_id, run.profile, run.cause
        ));
    }
    lines.push(format!(
        "link          {}, {} samples, {} lost, {} frames refused, {} bus errors",
        if s.link_open { "open" } else { "closed" },
        s.rig.counters.samples,
        s.rig.counters.lost,
        s.rig.counters.frames_refused,
        s.rig.counters.bus_errors
    ));
    lines.push(format!(
        "control loop  {} of {} turns late, worst {:.1} ms",
        s.control_loop.late_turns,
        s.control_loop.turns,
        s.control_loop.worst_lateness_us as f64 / 1000.0
    ));
    if !s.rig.notice.is_empty() {
        lines.push(format!("notice        {}", s.rig.notice));
    }
    lines.extend(s.degraded.iter().map(|d| format!("degraded      {d}")));
    lines.join("\n")
}
