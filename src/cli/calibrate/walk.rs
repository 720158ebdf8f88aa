//! Walks a technician through the steps: shows the reading as it is now, takes the value of the reference, keeps the point.

use std::io::{BufRead, IsTerminal, Write};
use std::path::Path;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::super::CliError;
use super::super::shared::client::Client;
use super::session::{CalibrationSession, Step, Taken};
use crate::calibration::CalibratedChannel;
use crate::daemon::client_types::SensorReadings;
use crate::daemon::reading::WINDOW_SAMPLES;

/// Time between two looks at the reading.
const LOOK_PERIOD: Duration = Duration::from_millis(250);
/// A point is a second of samples; no rig needs longer for it than this.
const POINT_WITHIN: Duration = Duration::from_secs(20);
/// A reading that spreads more than this many times its noise moves.
const STILL_SIGMAS: f64 = 5.0;

/// The sensor at its daemon.
pub(super) struct Instrument<'a> {
    pub client: &'a Client,
    pub channel: CalibratedChannel,
    /// Name of the bench whose counts and limits are used.
    pub bench: &'a str,
    /// N or mm for one count.
    pub per_count: f64,
    /// Standard deviation of one sample, N or mm.
    pub noise: f64,
}

/// The reading of the last second, N or mm, uncorrected.
struct Look {
    first_tick: u64,
    last_tick: u64,
    samples: usize,
    mean: f64,
    scatter: f64,
}

/// How the walk ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Walked {
    /// All steps are taken.
    ToTheEnd,
    /// The technician left, or the input ended.
    Interrupted,
}

impl Instrument<'_> {
    fn look(&self) -> Result<Look, CliError> {
        let found: SensorReadings = self.client.get("/api/reading")?;
        if found.bench != self.bench {
            return Err(CliError::Input(format!(
                "the daemon has the bench {} and --bench is {}: name the file with which the daemon was started",
                found.bench, self.bench
            )));
        }
        let sensor = match self.channel {
            CalibratedChannel::Force => found.force,
            CalibratedChannel::Displacement => found.displacement,
        };
        let whole = sensor.invalid == 0;
        Ok(Look {
            first_tick: found.first_tick,
            last_tick: found.last_tick,
            samples: if whole { found.samples as usize } else { 0 },
            mean: sensor.mean_counts * self.per_count,
            scatter: sensor.sigma_counts * self.per_count,
        })
    }

    /// The mean of one whole second that begins now; a sentence if there is none.
    fn take(&self) -> Result<Result<Look, String>, CliError> {
        let (from, deadline) = (self.look()?.last_tick, Instant::now() + POINT_WITHIN);
        while Instant::now() < deadline {
            let look = self.look()?;
            if look.samples == WINDOW_SAMPLES && look.first_tick > from {
                return Ok(match look.scatter > STILL_SIGMAS * self.noise {
                    true => Err(format!(
                        "the reading moves: its scatter is {}, the noise of the sensor {}: wait until it is still",
                        self.text(look.scatter),
                        self.text(self.noise)
                    )),
                    false => Ok(look),
                });
            }
            std::thread::sleep(LOOK_PERIOD);
        }
        Ok(Err(
            "there was no second without a gap: look at the link and the sensor with `leafbench status`"
                .to_owned(),
        ))
    }

    fn text(&self, value: f64) -> String {
        let decimals = match self.channel {
            CalibratedChannel::Force => 2,
            CalibratedChannel::Displacement => 4,
        };
        format!("{value:.decimals$} {}", self.channel.unit())
    }
}

/// The lines that a person types, or a script sends; reading them does not hold up the live reading.
pub(super) fn typed_lines() -> Receiver<String> {
    let (send, lines) = mpsc::channel();
    // Ends with the process: nothing else can wake a thread that waits for a terminal.
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { return };
            if send.send(line).is_err() {
                return;
            }
        }
    });
    lines
}

/// Takes the steps that are left. `references` are the values of the reference where they are known beforehand: each line then takes
/// one point. The session is kept at `part` after each point.
pub(super) fn walk(
    instrument: &Instrument,
    session: &mut CalibrationSession,
    references: Option<&[f64]>,
    lines: &Receiver<String>,
    part: &Path,
) -> Result<Walked, CliError> {
    let steps = session.steps();
    let mut said = usize::MAX;
    while let Some(step) = steps.get(session.taken.len()) {
        let at = session.taken.len();
        let known = references.and_then(|references| references.get(at).copied());
        if said != at {
            say(&order(instrument, step, at, steps.len(), known));
            said = at;
        }
        let Some(line) = next_line(instrument, lines)? else {
            return Ok(Walked::Interrupted);
        };
        // Which point a decimal comma separates is not to be guessed.
        let typed = line.parse::<f64>().ok().filter(|value| value.is_finite());
        match (line.as_str(), known.or(typed)) {
            ("q", _) => return Ok(Walked::Interrupted),
            ("b", _) => {
                session.taken.pop();
                said = usize::MAX;
            }
            (_, Some(reference)) => take(instrument, session, step, reference)?,
            (_, None) => say(&format!(
                "\"{line}\" is not a number: type the value of the reference in {}, such as 812.4; b goes one step back, q leaves",
                instrument.channel.unit()
            )),
        }
        session.keep(part)?;
    }
    Ok(Walked::ToTheEnd)
}

/// The next line that is typed, without spaces around it; `None` at the end of the input. A terminal shows the reading meanwhile.
fn next_line(instrument: &Instrument, lines: &Receiver<String>) -> Result<Option<String>, CliError> {
    let live = std::io::stderr().is_terminal();
    loop {
        match lines.recv_timeout(LOOK_PERIOD) {
            Ok(line) => return Ok(Some(line.trim().to_owned())),
            Err(RecvTimeoutError::Timeout) if live => show(instrument)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(None),
        }
    }
}

/// Takes the point of a step, or says why it cannot be taken.
fn take(
    instrument: &Instrument,
    session: &mut CalibrationSession,
    step: &Step,
    reference: f64,
) -> Result<(), CliError> {
    let look = match instrument.take()? {
        Ok(look) => look,
        Err(why) => {
            say(&why);
            return Ok(());
        }
    };
    say(&format!(
        "  taken: reference {}, reading {}, scatter {}",
        instrument.text(reference),
        instrument.text(look.mean),
        instrument.text(look.scatter)
    ));
    session.taken.push(Taken {
        series: step.series,
        down: step.down,
        reference,
        reading: look.mean,
        scatter: look.scatter,
    });
    Ok(())
}

/// What to do at a step.
fn order(instrument: &Instrument, step: &Step, at: usize, of: usize, known: Option<f64>) -> String {
    let way = if step.down { "down" } else { "up" };
    let place = match step.level == 0.0 {
        true => "take the load off".to_owned(),
        false => format!("go {way} to about {}", instrument.text(step.level)),
    };
    let place = match (step.level == 0.0, instrument.channel) {
        (true, CalibratedChannel::Displacement) => "go to the zero of the reference".to_owned(),
        _ => place,
    };
    let then = match known {
        Some(value) => format!("press Enter when the reference shows {}", instrument.text(value)),
        None => "wait until it is still, then type the value of the reference".to_owned(),
    };
    format!(
        "step {} of {of}, series {}, {way}: {place}; {then}",
        at + 1,
        step.series
    )
}

/// The reading as it is now, on one line that is written over.
fn show(instrument: &Instrument) -> Result<(), CliError> {
    let look = instrument.look()?;
    let text = match look.samples {
        0 => "no reading".to_owned(),
        _ => format!(
            "reading {}, scatter {} (uncorrected)",
            instrument.text(look.mean),
            instrument.text(look.scatter)
        ),
    };
    let mut stderr = std::io::stderr().lock();
    let _ = write!(stderr, "\r\x1b[K{text} > ");
    let _ = stderr.flush();
    Ok(())
}

/// A line for people, on stderr: stdout has the result.
fn say(text: &str) {
    let mut stderr = std::io::stderr().lock();
    let begin = if stderr.is_terminal() { "\r\x1b[K" } else { "" };
    let _ = writeln!(stderr, "{begin}{text}");
}
