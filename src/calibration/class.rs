//! Limits of the classes: ISO 7500-1 for force, ISO 9513 for displacement. The figures are those of the 2018 and 2012 editions; a
//! laboratory that issues certificates checks them against its own copy.

use serde::Serialize;

use super::points::CalibratedChannel;
use Criterion::{Indication, Repeatability, Resolution, Reversibility, Zero};

/// A property that a class limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Criterion {
    /// Error of the corrected indication.
    Indication,
    /// Spread of the series at one level.
    Repeatability,
    /// Difference between the way down and the way up.
    Reversibility,
    /// Indication at zero after the series, as a share of the range.
    Zero,
    /// Smallest difference that can be read.
    Resolution,
}

/// Largest value that a class allows: a share of the reference, or this much where that is more.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Allowed {
    /// Percent of the reference.
    pub percent: f64,
    /// N or mm, whatever the reference.
    pub at_least: f64,
}

impl Allowed {
    /// The limit at this reference, N or mm.
    pub(crate) fn at(self, reference: f64) -> f64 {
        (0.01 * self.percent * reference.abs()).max(self.at_least)
    }
}

/// A class and its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AccuracyClass {
    /// Its name in the standard.
    pub name: &'static str,
    limits: &'static [(Criterion, Allowed)],
}

impl AccuracyClass {
    /// The limit of a criterion; `None` where the standard has none.
    pub(crate) fn allowed(&self, criterion: Criterion) -> Option<Allowed> {
        let found = self.limits.iter().find(|(limited, _)| *limited == criterion);
        found.map(|(_, allowed)| *allowed)
    }
}

/// A standard with its classes, the best first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Standard {
    pub name: &'static str,
    /// Series of measurements that it asks for.
    pub series: u32,
    pub classes: &'static [AccuracyClass],
}

const fn percent(percent: f64) -> Allowed {
    Allowed {
        percent,
        at_least: 0.0,
    }
}

const fn percent_or_mm(percent: f64, at_least: f64) -> Allowed {
    Allowed { percent, at_least }
}

const ISO_7500_1: Standard = Standard {
    name: "ISO 7500-1",
    series: 3,
    classes: &[
        AccuracyClass {
            name: "0.5",
            limits: &[
                (Indication, percent(0.5)),
                (Repeatability, percent(0.5)),
                (Reversibility, percent(0.75)),
                (Zero, percent(0.05)),
                (Resolution, percent(0.25)),
            ],
        },
        AccuracyClass {
            name: "1",
            limits: &[
                (Indication, percent(1.0)),
                (Repeatability, percent(1.0)),
                (Reversibility, percent(1.5)),
                (Zero, percent(0.1)),
                (Resolution, percent(0.5)),
            ],
        },
        AccuracyClass {
            name: "2",
            limits: &[
                (Indication, percent(2.0)),
                (Repeatability, percent(2.0)),
                (Reversibility, percent(3.0)),
                (Zero, percent(0.2)),
                (Resolution, percent(1.0)),
            ],
        },
        AccuracyClass {
            name: "3",
            limits: &[
                (Indication, percent(3.0)),
                (Repeatability, percent(3.0)),
                (Reversibility, percent(4.5)),
                (Zero, percent(0.3)),
                (Resolution, percent(1.5)),
            ],
        },
    ],
};

const ISO_9513: Standard = Standard {
    name: "ISO 9513",
    series: 2,
    classes: &[
        AccuracyClass {
            name: "0.2",
            limits: &[
                (Indication, percent_or_mm(0.2, 0.0006)),
                (Resolution, percent_or_mm(0.1, 0.0002)),
            ],
        },
        AccuracyClass {
            name: "0.5",
            limits: &[
                (Indication, percent_or_mm(0.5, 0.0015)),
                (Resolution, percent_or_mm(0.25, 0.0005)),
            ],
        },
        AccuracyClass {
            name: "1",
            limits: &[
                (Indication, percent_or_mm(1.0, 0.003)),
                (Resolution, percent_or_mm(0.5, 0.001)),
            ],
        },
        AccuracyClass {
            name: "2",
            limits: &[
                (Indication, percent_or_mm(2.0, 0.006)),
                (Resolution, percent_or_mm(1.0, 0.002)),
            ],
        },
    ],
};

/// The standard for a channel.
pub(crate) fn standard(channel: CalibratedChannel) -> &'static Standard {
    match channel {
        CalibratedChannel::Force => &ISO_7500_1,
        CalibratedChannel::Displacement => &ISO_9513,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_ordered_and_a_small_length_has_an_absolute_limit() {
        for channel in [CalibratedChannel::Force, CalibratedChannel::Displacement] {
            for pair in standard(channel).classes.windows(2) {
                for (criterion, allowed) in pair[0].limits {
                    let next = pair[1].allowed(*criterion).expect("the same criteria");
                    assert!(next.percent > allowed.percent && next.at_least >= allowed.at_least);
                }
            }
        }
        let half = ISO_9513.classes[1].allowed(Indication).expect("limited");
        assert_eq!((half.at(0.1), half.at(-10.0)), (0.0015, 0.05));
    }
}
