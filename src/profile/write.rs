//! Writes a profile as TOML, so that `file` reads it back the same.

use std::fmt::Write;

use super::{Level, Profile, Segment};
use crate::units::Mode;

impl Profile {
    /// The file's text: `from_toml` of it gives this profile again.
    pub(crate) fn to_toml(&self) -> String {
        let unit = self.mode.unit_suffix();
        let quoted = |s: &str| toml::Value::String(s.to_owned()).to_string();
        let control = match self.mode {
            Mode::Displacement => "displacement",
            Mode::Force => "force",
        };
        let (name, description) = (quoted(&self.name), quoted(&self.description));
        let mut out = format!("name = {name}\ndescription = {description}\ncontrol = \"{control}\"\n");
        for block in &self.blocks {
            out += &format!("\n[[block]]\nrepeat = {}\n", block.repeat);
            for segment in &block.segments {
                out += "\n[[block.segment]]\n";
                write_segment(&mut out, segment, unit);
            }
        }
        out
    }
}

fn write_segment(out: &mut String, segment: &Segment, unit: &str) {
    let level = |key: &str, level: Level| match level {
        Level::Absolute(v) => format!("{key}_{unit} = {v:?}\n"),
        Level::Relative(v) if key == "to" => format!("by_{unit} = {v:?}\n"),
        Level::Relative(v) => format!("{key}_by_{unit} = {v:?}\n"),
    };
    // Writing into a String cannot fail.
    let _ = match segment {
        Segment::Ramp { to, duration_s } => {
            write!(
                out,
                "kind = \"ramp\"\n{}duration_s = {duration_s:?}\n",
                level("to", *to)
            )
        }
        Segment::Hold { duration_s } => write!(out, "kind = \"hold\"\nduration_s = {duration_s:?}\n"),
        Segment::Sine {
            mean,
            amplitude,
            frequency_hz,
            cycles,
            taper_cycles,
            correct,
        }
        | Segment::Triangle {
            mean,
            amplitude,
            frequency_hz,
            cycles,
            taper_cycles,
            correct,
        } => write!(
            out,
            "kind = \"{}\"\n{}amplitude_{unit} = {amplitude:?}\nfrequency_hz = {frequency_hz:?}\ncycles = {cycles}\n\
             taper_cycles = {taper_cycles}\ncorrect = {correct}\n",
            if matches!(segment, Segment::Sine { .. }) {
                "sine"
            } else {
                "triangle"
            },
            level("mean", *mean),
        ),
        Segment::Table {
            time_s,
            level,
            relative,
        } => write!(
            out,
            "kind = \"table\"\ntime_s = {time_s:?}\nlevel{}_{unit} = {level:?}\n",
            if *relative { "_by" } else { "" },
        ),
    };
}
