//! The result of pooling, as it goes into `fleet.json`: for each quantity what was estimated, and over all quantities what was found.

use serde::Serialize;

use super::estimate::EstimateScale;

/// The result of pooling a table of estimates.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct FleetFindings {
    /// Rows of the table, and different specimens, families, benches and operators in it.
    pub rows: usize,
    pub specimens: usize,
    pub families: usize,
    pub benches: usize,
    pub operators: usize,
    /// Number of questions asked. The chance of one wrong finding or more over all of them is [`super::FAMILY_WISE_ERROR`].
    pub questions: usize,
    pub family_wise_error: f64,
    /// What was found, in the order of the kinds, the surest first; empty if nothing was.
    pub findings: Vec<FleetFinding>,
    /// How many specimens were judged by a drawing, with the verdicts; null if no drawings were given.
    pub against_drawings: Option<DrawingCounts>,
    /// Specimens that deviate, but not by enough to be findings: one sentence each, the clearest first.
    pub worth_a_look: Vec<String>,
    /// For each bench whose forces or displacements deviate, the error of gain that fits.
    pub bench_causes: Vec<BenchCause>,
    /// What the table cannot tell, and what to do.
    pub cannot_tell: Vec<String>,
    /// Sorted by name.
    pub quantities: Vec<QuantityFindings>,
}

/// Something that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct FleetFinding {
    pub kind: QuestionKind,
    pub quantity: String,
    /// Bench, operator, specimen, family or `family / batch`; empty for a slope of all families.
    pub subject: String,
    /// p value after correction for all questions, 0 to the family-wise error.
    pub adjusted_p: f64,
    pub sentence: String,
}

/// Which error of gain explains how a bench deviates in several quantities.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct BenchCause {
    pub bench: String,
    /// The benches against whose mean it was judged.
    pub against: Vec<String>,
    /// The quantities that a gain would move.
    pub quantities: Vec<String>,
    pub error: BenchError,
    /// The gain of the force that fits best; null if no quantity depends on it.
    pub force_gain: Option<GainFit>,
    /// The gain of the displacement that fits best; null if no quantity depends on it.
    pub displacement_gain: Option<GainFit>,
    pub sentence: String,
}

/// Errors of gain of a bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum BenchError {
    ForceGain,
    DisplacementGain,
    /// Both fit: the recordings cannot tell.
    Either,
    /// Neither alone fits.
    Neither,
}

/// An error of gain, fitted to the deviations of a bench.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct GainFit {
    /// Fraction by which the bench reads high, with its 95 % interval.
    pub error: f64,
    pub low95: f64,
    pub high95: f64,
    /// p value of what the gain leaves; small if another error is at work.
    pub misfit_p: f64,
}

/// Kinds of questions. Each kind has a share of the family-wise error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum QuestionKind {
    /// Does a bench read differently from the others?
    Bench,
    /// Does an operator measure differently from the others?
    Operator,
    /// Is an effect present in a family or batch?
    Group,
    /// Does a batch differ from the others of its family?
    Batch,
    /// Does a quantity change with cycles or years?
    Age,
    /// Is a specimen outside of what its drawing allows?
    Drawing,
    /// Does a specimen differ from its family in a parameter?
    Specimen,
    /// Has a specimen more of an effect than its family, or less?
    SpecimenEffect,
}

impl QuestionKind {
    /// The kind of a question about a specimen in a quantity of this role.
    pub(crate) fn about_specimens(role: QuantityRole) -> QuestionKind {
        match role {
            QuantityRole::Parameter => QuestionKind::Specimen,
            QuantityRole::Effect | QuantityRole::InstrumentEffect => QuestionKind::SpecimenEffect,
        }
    }
}

/// What pooling says about one quantity. Values of a `relative` quantity are fractions (0.01 is 1 %), except levels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct QuantityFindings {
    pub quantity: String,
    pub unit: String,
    pub scale: EstimateScale,
    /// How the quantity is read: a parameter, an effect of the specimens, or an effect of the instruments.
    pub role: QuantityRole,
    pub runs: usize,
    /// Standard deviation between specimens of a family.
    pub between_specimens: f64,
    /// Standard deviation from run to run, beyond the standard errors of the estimates.
    pub run_to_run: f64,
    /// Mean of each family, and of each batch where a family has several.
    pub groups: Vec<GroupLevel>,
    pub benches: Vec<LevelEffect>,
    pub operators: Vec<LevelEffect>,
    pub slopes: Vec<AgeSlope>,
    pub specimen_deviations: Vec<SpecimenDeviation>,
    /// Specimens whose drawing limits the quantity; empty without drawings.
    pub against_drawing: Vec<DrawingJudgement>,
}

/// How a quantity is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum QuantityRole {
    /// A parameter of the model: groups are compared with each other.
    Parameter,
    /// An effect of specimen, mounting or frame: groups are compared with 0, which means absent.
    Effect,
    /// An effect of load cell, LVDT or their channels: benches are compared with 0.
    InstrumentEffect,
}

/// A pooled value with its 95 % interval. If a question was asked about it, the question is whether it is 0, and for a value that is
/// judged by a drawing whether it lies outside of the limits.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct PooledValue {
    pub value: f64,
    pub low95: f64,
    pub high95: f64,
    /// Degrees of freedom of the interval.
    pub degrees: f64,
    /// p value of the question alone; null if none was asked.
    pub p: Option<f64>,
    /// p value after correction for all questions.
    pub adjusted_p: Option<f64>,
    /// True if the question was answered with yes.
    pub found: bool,
}

/// The mean of a family or batch.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct GroupLevel {
    pub family: String,
    /// Null for the whole family.
    pub batch: Option<String>,
    /// Benches on which it was tested.
    pub benches: Vec<String>,
    pub specimens: usize,
    pub runs: usize,
    /// Mean in the unit of the quantity, at the mean age of the runs of the group. For an effect on the benches where it was measured:
    /// the question is whether the group or one of these benches has it. For a parameter at the mean of the benches.
    pub level: PooledValue,
    /// The mean of an effect if that bench is right for which it is least sure. The question is whether the group itself has the effect,
    /// whichever bench is right (the largest p value counts: Berger 1982). Null for a parameter, and where one bench is all there is.
    pub on_least_sure_bench: Option<PooledValue>,
    /// Difference from the other batches of the family; null for a family, and for the second one of two batches.
    pub from_other_batches: Option<PooledValue>,
    /// Largest absolute ratio of estimate to standard error of a single specimen.
    pub largest_single_z: f64,
}

/// The effect of a bench or an operator.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct LevelEffect {
    pub name: String,
    /// The benches or operators against whose mean it is given; empty for an effect of the instruments, which is given against 0.
    pub against: Vec<String>,
    pub effect: PooledValue,
}

/// A slope with age.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct AgeSlope {
    pub per: AgeUnit,
    /// Null for the slope that all families share.
    pub family: Option<String>,
    pub slope: PooledValue,
}

/// What age is counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub(crate) enum AgeUnit {
    /// Load cycles of the specimen.
    #[serde(rename = "1000 cycles")]
    ThousandCycles,
    /// Time since the first run of the quantity.
    #[serde(rename = "year")]
    Year,
}

impl AgeUnit {
    /// The unit in words.
    pub(crate) fn word(self) -> &'static str {
        match self {
            AgeUnit::ThousandCycles => "1000 cycles",
            AgeUnit::Year => "year",
        }
    }
}

/// How far a specimen is from its family, or from its batch where the family has several.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct SpecimenDeviation {
    pub specimen: String,
    pub family: String,
    pub batch: String,
    pub benches: Vec<String>,
    pub runs: usize,
    /// Deviation, drawn towards 0 as far as its runs are few (best linear unbiased prediction); an outlier's is not drawn.
    pub deviation: PooledValue,
    /// Deviation over its standard error without this specimen in the fit.
    pub deletion_t: f64,
    /// p value if specimens of a family followed the normal law; null if no question was asked.
    pub normal_p: Option<f64>,
    /// True if it is no finding but would be one if specimens followed the normal law.
    pub worth_a_look: bool,
}

/// A specimen judged by the drawing of its family.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct DrawingJudgement {
    pub specimen: String,
    pub family: String,
    pub batch: String,
    pub benches: Vec<String>,
    pub runs: usize,
    /// Value of the specimen at 0 cycles and at its first run, in the unit of the quantity. The interval and the p value hold whichever
    /// connected bench is right.
    pub value: PooledValue,
    /// Nominal of the drawing, or the mean of the family in place of it; null if the limits need none.
    pub nominal: Option<f64>,
    pub nominal_is_family_mean: bool,
    /// Limits in the unit of the quantity.
    pub at_least: Option<f64>,
    pub at_most: Option<f64>,
    /// The limits as the drawing has them: "tolerance 7 %".
    pub limits: String,
    pub verdict: DrawingVerdict,
    /// The bench that makes it least certain that the limit is exceeded, if that bench reads right; null if all benches say the same.
    pub least_sure_bench: Option<String>,
    /// The bench that makes it most certain, if that one reads right; null as above.
    pub clearest_bench: Option<String>,
    /// p value if that second bench reads right.
    #[serde(skip)]
    pub clearest_p: f64,
    /// What else may explain the verdict: the family, the batch or a bench.
    pub remark: Option<String>,
}

/// What is said of a specimen by its drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum DrawingVerdict {
    /// Outside, also after correction for all questions.
    OutOfTolerance,
    /// The 95 % interval lies inside of the limits.
    Within,
    /// Neither: the runs say too little.
    Undecided,
}

impl DrawingVerdict {
    /// The verdict in words.
    pub(crate) fn words(self) -> &'static str {
        match self {
            DrawingVerdict::OutOfTolerance => "out of tolerance",
            DrawingVerdict::Within => "within tolerance",
            DrawingVerdict::Undecided => "undecided",
        }
    }
}

/// How many judgements by drawings had each verdict.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub(crate) struct DrawingCounts {
    pub judged: usize,
    pub out_of_tolerance: usize,
    pub within: usize,
    pub undecided: usize,
}

impl DrawingCounts {
    /// Counts the judgements of all quantities.
    pub(super) fn of(quantities: &[QuantityFindings]) -> DrawingCounts {
        let verdicts: Vec<DrawingVerdict> = (quantities.iter())
            .flat_map(|q| q.against_drawing.iter().map(|j| j.verdict))
            .collect();
        let count = |verdict: DrawingVerdict| verdicts.iter().filter(|v| **v == verdict).count();
        DrawingCounts {
            judged: verdicts.len(),
            out_of_tolerance: count(DrawingVerdict::OutOfTolerance),
            within: count(DrawingVerdict::Within),
            undecided: count(DrawingVerdict::Undecided),
        }
    }

    /// The counts as a sentence.
    pub(crate) fn sentence(&self) -> String {
        format!(
            "Against the drawings {} were judged, one for each specimen and quantity: {} out of tolerance, {} within, {} undecided.",
            match self.judged {
                1 => "1 value".to_owned(),
                n => format!("{n} values"),
            },
            self.out_of_tolerance,
            self.within,
            self.undecided
        )
    }
}

impl FleetFindings {
    /// How sure all findings are together, as a part of a sentence.
    pub(crate) fn sureness(&self) -> String {
        format!(
            "the chance that one finding or more is wrong is at most {:.0} %, if the standard errors of the table are right",
            100.0 * self.family_wise_error
        )
    }
}

impl SpecimenDeviation {
    /// True for a deviation that is no finding and that somebody should look at. If specimens followed the normal law, at most a share
    /// `level` of all labs would have one as large by chance among their `questions` about specimens. Its interval must not hold 0: where
    /// specimens do not scatter, the estimate is drawn to 0, and there is nothing to look at.
    pub(super) fn is_worth_a_look(&self, questions: usize, level: f64) -> bool {
        let value = &self.deviation;
        let holds_zero = value.low95 <= 0.0 && value.high95 >= 0.0;
        let rare = |p: f64| p * (questions as f64) < level;
        value.p.is_some() && !value.found && !holds_zero && self.normal_p.is_some_and(rare)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deviation_whose_interval_holds_0_is_not_worth_a_look() {
        let specimen = |low95: f64, high95: f64, found: bool, normal_p: f64| SpecimenDeviation {
            specimen: "S1".to_owned(),
            family: "F1".to_owned(),
            batch: String::new(),
            benches: Vec::new(),
            runs: 10,
            deviation: PooledValue {
                value: 0.5 * (low95 + high95),
                low95,
                high95,
                degrees: 20.0,
                p: Some(0.001),
                adjusted_p: Some(0.2),
                found,
            },
            deletion_t: 4.6,
            normal_p: Some(normal_p),
            worth_a_look: false,
        };
        assert!(specimen(0.1, 0.3, false, 1e-4).is_worth_a_look(160, 0.05));
        assert!(specimen(-0.3, -0.1, false, 1e-4).is_worth_a_look(160, 0.05));
        assert!(!specimen(-0.1, 0.38, false, 1e-4).is_worth_a_look(160, 0.05));
        assert!(
            !specimen(0.1, 0.3, true, 1e-4).is_worth_a_look(160, 0.05),
            "a finding"
        );
        assert!(
            !specimen(0.1, 0.3, false, 1e-4).is_worth_a_look(640, 0.05),
            "one of many"
        );
    }
}
