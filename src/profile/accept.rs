//! The `accept` blocks of a profile: limits that a run is judged by after its end. They move nothing and stop nothing; the
//! limits that do are those of the bench. `acceptance` measures a run against them.

use std::ops::Range;

use serde::Deserialize;
use toml::Spanned;

use super::reader::Reader;
use super::{Block, ProfileError, Segment};

/// A value that every cycle has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CycleValue {
    /// Highest force, N.
    ForcePeak,
    /// Lowest force, N.
    ForceValley,
    /// Half of peak minus valley of the force, N.
    ForceAmplitude,
    /// Highest displacement, mm.
    DisplacementPeak,
    /// Lowest displacement, mm.
    DisplacementValley,
    /// Half of peak minus valley of the displacement, mm.
    DisplacementAmplitude,
    /// Peak minus valley of the displacement, mm.
    Travel,
    /// Energy that the loop dissipates, J.
    LoopEnergy,
    /// Spring rate from valley to peak, N/mm.
    SecantRate,
    /// NRMSE of the twin, a pure number.
    TwinNrmse,
}

impl CycleValue {
    /// All values, in the order in which a result shows them.
    pub(crate) const ALL: [CycleValue; 10] = [
        CycleValue::ForcePeak,
        CycleValue::ForceValley,
        CycleValue::ForceAmplitude,
        CycleValue::DisplacementPeak,
        CycleValue::DisplacementValley,
        CycleValue::DisplacementAmplitude,
        CycleValue::Travel,
        CycleValue::LoopEnergy,
        CycleValue::SecantRate,
        CycleValue::TwinNrmse,
    ];

    /// What people call it.
    pub(crate) fn words(self) -> &'static str {
        match self {
            CycleValue::ForcePeak => "peak force",
            CycleValue::ForceValley => "valley force",
            CycleValue::ForceAmplitude => "force amplitude",
            CycleValue::DisplacementPeak => "peak displacement",
            CycleValue::DisplacementValley => "valley displacement",
            CycleValue::DisplacementAmplitude => "displacement amplitude",
            CycleValue::Travel => "travel",
            CycleValue::LoopEnergy => "loop energy",
            CycleValue::SecantRate => "secant rate",
            CycleValue::TwinNrmse => "twin error (NRMSE)",
        }
    }

    /// Unit as text; empty for a pure number.
    pub(crate) fn unit(self) -> &'static str {
        match self {
            CycleValue::ForcePeak | CycleValue::ForceValley | CycleValue::ForceAmplitude => "N",
            CycleValue::DisplacementPeak
            | CycleValue::DisplacementValley
            | CycleValue::DisplacementAmplitude
            | CycleValue::Travel => "mm",
            CycleValue::LoopEnergy => "J",
            CycleValue::SecantRate => "N/mm",
            CycleValue::TwinNrmse => "",
        }
    }

    /// Unit of its change from cycle to cycle.
    pub(crate) fn trend_unit(self) -> &'static str {
        match self.unit() {
            "N" => "N/cycle",
            "mm" => "mm/cycle",
            "J" => "J/cycle",
            "N/mm" => "N/mm/cycle",
            _ => "1/cycle",
        }
    }
}

/// Samples that are counted over the whole run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SampleCount {
    /// Ticks whose sample did not arrive.
    Lost,
    /// Samples that the link delivered too late.
    Late,
    /// Samples without a valid reading of a channel.
    Flagged,
}

impl SampleCount {
    /// What people call it.
    pub(crate) fn words(self) -> &'static str {
        match self {
            SampleCount::Lost => "lost samples",
            SampleCount::Late => "late samples",
            SampleCount::Flagged => "flagged samples",
        }
    }
}

/// What a limit is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum JudgedValue {
    /// A value of each cycle: the worst cycle counts.
    Cycle(CycleValue),
    /// Slope of the line of least squares through a value over the number of its cycle.
    Trend(CycleValue),
    /// A number of samples of the whole run.
    Samples(SampleCount),
}

impl JudgedValue {
    /// What people call it.
    pub(crate) fn words(self) -> String {
        match self {
            JudgedValue::Cycle(value) => value.words().to_owned(),
            JudgedValue::Trend(value) => format!("trend of the {}", value.words()),
            JudgedValue::Samples(count) => count.words().to_owned(),
        }
    }

    /// Unit as text; empty for a pure number.
    pub(crate) fn unit(self) -> &'static str {
        match self {
            JudgedValue::Cycle(value) => value.unit(),
            JudgedValue::Trend(value) => value.trend_unit(),
            JudgedValue::Samples(_) => "samples",
        }
    }

    /// True for what cannot be below zero.
    fn is_a_size(self) -> bool {
        use CycleValue::{DisplacementAmplitude, ForceAmplitude, Travel, TwinNrmse};
        match self {
            JudgedValue::Cycle(value) => {
                matches!(value, DisplacementAmplitude | ForceAmplitude | Travel | TwinNrmse)
            }
            JudgedValue::Trend(_) => false,
            JudgedValue::Samples(_) => true,
        }
    }
}

/// On which side of a limit the measured value must be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum LimitSide {
    /// The value is at least the limit.
    Min,
    /// The value is at most the limit.
    Max,
}

/// One limit of an `accept` block.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct AcceptLimit {
    /// Key in the profile, with its unit.
    pub key: &'static str,
    pub judged: JudgedValue,
    pub side: LimitSide,
    /// The limit, in the unit of the key.
    pub limit: f64,
    /// First and last counted cycle that it is about; `None`: all of them, or the whole motion of a profile that counts none.
    pub cycles: Option<[u32; 2]>,
}

/// Declares the keys of an `accept` block, each with what it is about and its side.
macro_rules! accept_keys {
    ($($key:ident: $value:ty = $judged:expr, $side:ident;)*) => {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(super) struct RawAccept {
            cycles: Option<Spanned<[u32; 2]>>,
            $($key: Option<Spanned<$value>>,)*
        }

        /// Key of a limit; `None` if there is none for this value on this side.
        pub(crate) fn key_of(judged: JudgedValue, side: LimitSide) -> Option<&'static str> {
            let keys = [$((stringify!($key), $judged, LimitSide::$side)),*];
            keys.into_iter().find(|key| (key.1, key.2) == (judged, side)).map(|key| key.0)
        }

        impl RawAccept {
            /// The limits that are written, each with the place of its value.
            fn limits(&self) -> Vec<(AcceptLimit, Range<usize>)> {
                let cycles = self.cycles.as_ref().map(|c| *c.get_ref());
                let written = [$(self.$key.as_ref().map(|value| {
                    let limit = AcceptLimit {
                        key: stringify!($key),
                        judged: $judged,
                        side: LimitSide::$side,
                        limit: f64::from(*value.get_ref()),
                        cycles,
                    };
                    (limit, value.span())
                }),)*];
                written.into_iter().flatten().collect()
            }
        }
    };
}

accept_keys! {
    force_peak_min_n: f64 = JudgedValue::Cycle(CycleValue::ForcePeak), Min;
    force_peak_max_n: f64 = JudgedValue::Cycle(CycleValue::ForcePeak), Max;
    force_valley_min_n: f64 = JudgedValue::Cycle(CycleValue::ForceValley), Min;
    force_valley_max_n: f64 = JudgedValue::Cycle(CycleValue::ForceValley), Max;
    force_amplitude_min_n: f64 = JudgedValue::Cycle(CycleValue::ForceAmplitude), Min;
    force_amplitude_max_n: f64 = JudgedValue::Cycle(CycleValue::ForceAmplitude), Max;
    displacement_peak_min_mm: f64 = JudgedValue::Cycle(CycleValue::DisplacementPeak), Min;
    displacement_peak_max_mm: f64 = JudgedValue::Cycle(CycleValue::DisplacementPeak), Max;
    displacement_valley_min_mm: f64 = JudgedValue::Cycle(CycleValue::DisplacementValley), Min;
    displacement_valley_max_mm: f64 = JudgedValue::Cycle(CycleValue::DisplacementValley), Max;
    displacement_amplitude_min_mm: f64 = JudgedValue::Cycle(CycleValue::DisplacementAmplitude), Min;
    displacement_amplitude_max_mm: f64 = JudgedValue::Cycle(CycleValue::DisplacementAmplitude), Max;
    travel_min_mm: f64 = JudgedValue::Cycle(CycleValue::Travel), Min;
    travel_max_mm: f64 = JudgedValue::Cycle(CycleValue::Travel), Max;
    loop_energy_min_j: f64 = JudgedValue::Cycle(CycleValue::LoopEnergy), Min;
    loop_energy_max_j: f64 = JudgedValue::Cycle(CycleValue::LoopEnergy), Max;
    secant_rate_min_n_per_mm: f64 = JudgedValue::Cycle(CycleValue::SecantRate), Min;
    secant_rate_max_n_per_mm: f64 = JudgedValue::Cycle(CycleValue::SecantRate), Max;
    twin_nrmse_max: f64 = JudgedValue::Cycle(CycleValue::TwinNrmse), Max;
    force_peak_trend_min_n_per_cycle: f64 = JudgedValue::Trend(CycleValue::ForcePeak), Min;
    force_peak_trend_max_n_per_cycle: f64 = JudgedValue::Trend(CycleValue::ForcePeak), Max;
    force_valley_trend_min_n_per_cycle: f64 = JudgedValue::Trend(CycleValue::ForceValley), Min;
    force_valley_trend_max_n_per_cycle: f64 = JudgedValue::Trend(CycleValue::ForceValley), Max;
    travel_trend_min_mm_per_cycle: f64 = JudgedValue::Trend(CycleValue::Travel), Min;
    travel_trend_max_mm_per_cycle: f64 = JudgedValue::Trend(CycleValue::Travel), Max;
    loop_energy_trend_min_j_per_cycle: f64 = JudgedValue::Trend(CycleValue::LoopEnergy), Min;
    loop_energy_trend_max_j_per_cycle: f64 = JudgedValue::Trend(CycleValue::LoopEnergy), Max;
    secant_rate_trend_min_n_per_mm_per_cycle: f64 = JudgedValue::Trend(CycleValue::SecantRate), Min;
    secant_rate_trend_max_n_per_mm_per_cycle: f64 = JudgedValue::Trend(CycleValue::SecantRate), Max;
    lost_max_samples: u32 = JudgedValue::Samples(SampleCount::Lost), Max;
    late_max_samples: u32 = JudgedValue::Samples(SampleCount::Late), Max;
    flagged_max_samples: u32 = JudgedValue::Samples(SampleCount::Flagged), Max;
}

/// Counted cycles of a profile.
fn counted_cycles(blocks: &[Block]) -> u64 {
    let of_segment = |segment: &Segment| match segment {
        Segment::Cycles(cycles) => u64::from(cycles.cycles),
        _ => 0,
    };
    let of_block = |block: &Block| {
        u64::from(block.repeat).saturating_mul(block.segments.iter().map(of_segment).sum::<u64>())
    };
    blocks.iter().map(of_block).fold(0, u64::saturating_add)
}

/// Reads the `accept` blocks of a profile with these blocks.
pub(super) fn read(
    reader: &Reader<'_>,
    accept: Vec<Spanned<RawAccept>>,
    blocks: &[Block],
) -> Result<Vec<AcceptLimit>, ProfileError> {
    let counted = counted_cycles(blocks);
    let mut all = Vec::new();
    for block in accept {
        let span = block.span();
        let raw = block.into_inner();
        let judged_cycles = match &raw.cycles {
            Some(cycles) => cycles_within(reader, cycles, counted)?,
            None => counted,
        };
        let limits = raw.limits();
        if limits.is_empty() {
            let reason =
                "the accept block has no limit: add one, such as force_peak_max_n, or remove the block";
            return Err(reader.refuse(span, reason));
        }
        for (limit, place) in &limits {
            if let Some(reason) = objection(limit, judged_cycles) {
                return Err(reader.refuse(place.clone(), reason));
            }
        }
        for pair in limits.windows(2) {
            let [(low, _), (high, place)] = pair else { continue };
            if low.judged == high.judged && low.limit > high.limit {
                let reason = format!(
                    "{} = {} is below {} = {}: no value keeps both, exchange them",
                    high.key, high.limit, low.key, low.limit
                );
                return Err(reader.refuse(place.clone(), reason));
            }
        }
        all.extend(limits.into_iter().map(|(limit, _)| limit));
    }
    Ok(all)
}

/// How many cycles `cycles = [first, last]` names.
fn cycles_within(reader: &Reader<'_>, cycles: &Spanned<[u32; 2]>, counted: u64) -> Result<u64, ProfileError> {
    let [first, last] = *cycles.get_ref();
    let refuse = |reason: String| Err(reader.refuse(cycles.span(), reason));
    if counted == 0 {
        return refuse(
            "cycles are given, but this profile counts no cycles: remove cycles, then the limits are about its whole motion"
                .to_owned(),
        );
    }
    if first == 0 || first > last {
        return refuse(format!(
            "cycles = [{first}, {last}] is no range: enter the first and the last cycle, from 1"
        ));
    }
    if u64::from(last) > counted {
        return refuse(format!(
            "cycles = [{first}, {last}] ends after the last counted cycle of this profile, {counted}: enter at most {counted}"
        ));
    }
    Ok(u64::from(last - first) + 1)
}

/// Why a limit over so many cycles cannot be used.
fn objection(limit: &AcceptLimit, cycles: u64) -> Option<String> {
    let AcceptLimit {
        key, limit: value, ..
    } = limit;
    if !value.is_finite() {
        return Some(format!("{key} = {value} is not finite: enter a finite number"));
    }
    if limit.judged.is_a_size() && limit.side == LimitSide::Max && *value < 0.0 {
        return Some(format!(
            "{key} = {value} is below 0, so that no run can keep it: enter 0 or more"
        ));
    }
    if matches!(limit.judged, JudgedValue::Trend(_)) && cycles < 2 {
        return Some(format!(
            "{key} needs two cycles or more, and there {}: remove it",
            match cycles {
                0 => "are none".to_owned(),
                _ => "is one".to_owned(),
            }
        ));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::super::Profile;
    use super::*;

    const SINE: &str = "name = \"a\"\ncontrol = \"displacement\"\n[[block]]\nrepeat = 2\n[[block.segment]]\nkind = \"sine\"\n\
                        mean_mm = 0.0\namplitude_mm = 1.0\nfrequency_hz = 1.0\ncycles = 5\n";
    const RAMP: &str = "name = \"a\"\ncontrol = \"force\"\n[[block]]\n[[block.segment]]\nkind = \"ramp\"\nto_n = 9.0\n\
                        duration_s = 1.0\n";

    fn read(profile: &str, accept: &str) -> Result<Vec<AcceptLimit>, String> {
        let profile = Profile::from_toml(&format!("{profile}{accept}"), "a.toml");
        profile.map(|p| p.accept).map_err(|e| e.to_string())
    }

    #[test]
    fn each_key_is_one_limit_with_the_cycles_of_its_block() {
        let limits = read(
            SINE,
            "[[accept]]\ncycles = [2, 10]\nforce_peak_max_n = 1900\nsecant_rate_trend_min_n_per_mm_per_cycle = -0.5\n\
             [[accept]]\nlost_max_samples = 0\n",
        )
        .expect("three limits");
        let of = |key, judged, side, limit, cycles| AcceptLimit {
            key,
            judged,
            side,
            limit,
            cycles,
        };
        let rate = JudgedValue::Trend(CycleValue::SecantRate);
        assert_eq!(
            limits,
            [
                of(
                    "force_peak_max_n",
                    JudgedValue::Cycle(CycleValue::ForcePeak),
                    LimitSide::Max,
                    1900.0,
                    Some([2, 10])
                ),
                of(
                    "secant_rate_trend_min_n_per_mm_per_cycle",
                    rate,
                    LimitSide::Min,
                    -0.5,
                    Some([2, 10])
                ),
                of(
                    "lost_max_samples",
                    JudgedValue::Samples(SampleCount::Lost),
                    LimitSide::Max,
                    0.0,
                    None
                ),
            ]
        );
        assert_eq!(read(SINE, ""), Ok(Vec::new()));
    }

    #[test]
    fn a_limit_that_cannot_be_judged_is_refused_at_its_line_and_column() {
        let first_line = SINE.lines().count();
        for (accept, line, column, said) in [
            (
                "[[accept]]\nforce_peak_max = 3.0\n",
                2,
                1,
                "unknown field `force_peak_max`",
            ),
            ("[[accept]]\n", 1, 1, "has no limit"),
            ("[[accept]]\ntravel_max_mm = nan\n", 2, 17, "is not finite"),
            ("[[accept]]\ntravel_max_mm = -1\n", 2, 17, "no run can keep it"),
            ("[[accept]]\nlost_max_samples = -1\n", 2, 20, "invalid value"),
            ("[[accept]]\nlost_max_samples = 1.5\n", 2, 20, "invalid type"),
            (
                "[[accept]]\ncycles = [3, 2]\nlost_max_samples = 0\n",
                2,
                10,
                "is no range",
            ),
            (
                "[[accept]]\ncycles = [0, 2]\nlost_max_samples = 0\n",
                2,
                10,
                "is no range",
            ),
            (
                "[[accept]]\ncycles = [1, 11]\nlost_max_samples = 0\n",
                2,
                10,
                "enter at most 10",
            ),
            (
                "[[accept]]\ncycles = [4, 4]\ntravel_trend_max_mm_per_cycle = 1.0\n",
                3,
                33,
                "needs two cycles or more",
            ),
            (
                "[[accept]]\ntravel_max_mm = 2.0\ntravel_min_mm = 3.0\n",
                2,
                17,
                "travel_max_mm = 2 is below travel_min_mm = 3",
            ),
        ] {
            let refused = read(SINE, accept).expect_err(accept);
            let place = format!("line {}, column {column}: ", first_line + line);
            assert!(
                refused.contains(&place) && refused.contains(said),
                "{accept}: {refused}"
            );
        }
        let ramp = |accept: &str| read(RAMP, accept).expect_err(accept);
        assert!(ramp("[[accept]]\ncycles = [1, 1]\nlost_max_samples = 0\n").contains("counts no cycles"));
        assert!(ramp("[[accept]]\ntravel_trend_max_mm_per_cycle = 1.0\n").contains("there are none"));
        assert_eq!(
            read(RAMP, "[[accept]]\nforce_peak_max_n = 9.5\n").map(|l| l.len()),
            Ok(1)
        );
    }

    #[test]
    fn the_key_of_a_limit_is_found_by_what_it_is_about() {
        let peak = JudgedValue::Cycle(CycleValue::ForcePeak);
        assert_eq!(key_of(peak, LimitSide::Max), Some("force_peak_max_n"));
        let twin = JudgedValue::Cycle(CycleValue::TwinNrmse);
        assert_eq!(
            (key_of(twin, LimitSide::Max), key_of(twin, LimitSide::Min)),
            (Some("twin_nrmse_max"), None)
        );
    }
}
