//! What was found, as sentences for the technician.

use super::estimate::EstimateScale;
use super::findings::{
    AgeSlope, DrawingJudgement, FleetFinding, GroupLevel, LevelEffect, PooledValue, QuantityFindings,
    QuantityRole, QuestionKind, SpecimenDeviation,
};
use super::wording::{counted, interval, named, rounded};
use crate::effect::EFFECTS;

/// All findings, in the order of their kinds, the surest first. `reference`: the bench that counts as right.
pub(super) fn sentences(quantities: &[QuantityFindings], reference: Option<&str>) -> Vec<FleetFinding> {
    let mut found: Vec<(f64, FleetFinding)> = Vec::new();
    for quantity in quantities {
        let answered = answers(quantity, reference).into_iter();
        found.extend(answered.filter(|a| a.value.found).map(|answer| {
            let finding = FleetFinding {
                kind: answer.kind,
                quantity: quantity.quantity.clone(),
                subject: answer.subject,
                adjusted_p: answer.value.adjusted_p.unwrap_or(1.0),
                sentence: answer.sentence,
            };
            (answer.value.p.unwrap_or(1.0), finding)
        }));
    }
    found.sort_by(|(p, a), (q, b)| {
        let names = |f: &FleetFinding| (f.subject.clone(), f.quantity.clone());
        (a.kind.cmp(&b.kind))
            .then(p.total_cmp(q))
            .then_with(|| names(a).cmp(&names(b)))
    });
    found.into_iter().map(|(_, finding)| finding).collect()
}

/// A value, and what it means if it is a finding.
struct AnsweredQuestion<'q> {
    kind: QuestionKind,
    subject: String,
    value: &'q PooledValue,
    sentence: String,
}

fn answers<'q>(quantity: &'q QuantityFindings, reference: Option<&str>) -> Vec<AnsweredQuestion<'q>> {
    let answer =
        |kind: QuestionKind, subject: &str, value: &'q PooledValue, sentence: String| AnsweredQuestion {
            kind,
            subject: subject.to_owned(),
            value,
            sentence,
        };
    let benches = quantity.benches.iter().map(|bench| {
        let text = of_bench(quantity, bench, reference);
        answer(QuestionKind::Bench, &bench.name, &bench.effect, text)
    });
    let operators = quantity.operators.iter().map(|operator| {
        let text = of_operator(quantity, operator);
        answer(QuestionKind::Operator, &operator.name, &operator.effect, text)
    });
    let groups = quantity.groups.iter().flat_map(|group| {
        let said = group_answers(quantity, group).into_iter();
        said.map(|(kind, value, text)| answer(kind, &group_name(group), value, text))
    });
    let slopes = quantity.slopes.iter().map(|slope| {
        let subject = slope.family.as_deref().unwrap_or_default();
        answer(
            QuestionKind::Age,
            subject,
            &slope.slope,
            of_slope(quantity, slope),
        )
    });
    let specimens = quantity.specimen_deviations.iter().map(|specimen| {
        let text = of_specimen(quantity, specimen);
        answer(
            QuestionKind::about_specimens(quantity.role),
            &specimen.specimen,
            &specimen.deviation,
            text,
        )
    });
    let drawings = quantity.against_drawing.iter().map(|judgement| {
        let text = of_drawing(quantity, judgement);
        answer(QuestionKind::Drawing, &judgement.specimen, &judgement.value, text)
    });
    benches
        .chain(operators)
        .chain(groups)
        .chain(slopes)
        .chain(specimens)
        .chain(drawings)
        .collect()
}

/// What is said about a group, each with the value that decides whether it is.
fn group_answers<'q>(
    quantity: &QuantityFindings,
    group: &'q GroupLevel,
) -> Vec<(QuestionKind, &'q PooledValue, String)> {
    let mut said = Vec::new();
    match &group.on_least_sure_bench {
        Some(sure) if sure.found => said.push((QuestionKind::Group, sure, of_group(quantity, group))),
        // That the group or one of its benches has it follows from the finding about the bench.
        _ if bench_is_found(quantity, group) => {}
        _ => said.push((
            QuestionKind::Group,
            &group.level,
            of_group_or_bench(quantity, group),
        )),
    }
    let difference = group.from_other_batches.iter();
    said.extend(difference.map(|value| (QuestionKind::Batch, value, of_batch(quantity, group, value))));
    said
}

/// Specimens that deviate, but not by enough to be findings, the clearest first.
pub(super) fn worth_a_look(quantities: &[QuantityFindings]) -> Vec<String> {
    let mut seen: Vec<(f64, String)> = Vec::new();
    for quantity in quantities {
        let doubtful = quantity
            .specimen_deviations
            .iter()
            .filter(|specimen| specimen.worth_a_look);
        seen.extend(doubtful.map(|s| (s.deletion_t.abs(), of_specimen(quantity, s))));
    }
    seen.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
    seen.into_iter().map(|(_, sentence)| sentence).collect()
}

/// The size of a difference, without its sign, with its interval.
fn size(quantity: &QuantityFindings, value: &PooledValue) -> String {
    unsigned(
        [value.value, value.low95, value.high95],
        quantity.scale,
        &quantity.unit,
    )
}

/// A value with the ends of its interval, without its sign.
fn unsigned([value, low, high]: [f64; 3], scale: EstimateScale, unit: &str) -> String {
    match value < 0.0 {
        true => interval(-value, -high, -low, scale, unit),
        false => interval(value, low, high, scale, unit),
    }
}

fn of_bench(quantity: &QuantityFindings, bench: &LevelEffect, reference: Option<&str>) -> String {
    let (name, effect) = (&bench.name, &bench.effect);
    if bench.against.is_empty() {
        let value = interval(
            effect.value,
            effect.low95,
            effect.high95,
            quantity.scale,
            &quantity.unit,
        );
        return format!("Bench {name} has {}: {value}.", quantity.quantity);
    }
    let direction = if effect.value > 0.0 { "higher" } else { "lower" };
    let compared = named(&bench.against);
    let benches = if bench.against.len() == 1 {
        "bench"
    } else {
        "the mean of benches"
    };
    let unknown = match bench.against[..] {
        [ref only] if reference != Some(only) => {
            " Which of the two is wrong needs a third bench or a reference."
        }
        _ => "",
    };
    format!(
        "Bench {name} reads {} {direction} than {benches} {compared} by {}.{unknown}",
        quantity.quantity,
        size(quantity, effect)
    )
}

fn of_operator(quantity: &QuantityFindings, operator: &LevelEffect) -> String {
    let direction = if operator.effect.value > 0.0 {
        "higher"
    } else {
        "lower"
    };
    format!(
        "Operator {} measures {} {direction} than {} by {}.",
        operator.name,
        quantity.quantity,
        named(&operator.against),
        size(quantity, &operator.effect)
    )
}

/// `family` or `family / batch`.
fn group_name(group: &GroupLevel) -> String {
    match &group.batch {
        Some(batch) if batch.is_empty() => format!("{} / no batch", group.family),
        Some(batch) => format!("{} / {batch}", group.family),
        None => group.family.clone(),
    }
}

/// The group in a sentence.
fn group_words(group: &GroupLevel) -> String {
    match &group.batch {
        Some(batch) if batch.is_empty() => {
            format!("The specimens without a batch of family {}", group.family)
        }
        Some(batch) => format!("Batch {batch} of family {}", group.family),
        None => format!("Family {}", group.family),
    }
}

/// True if a bench of the group deviates in the quantity.
fn bench_is_found(quantity: &QuantityFindings, group: &GroupLevel) -> bool {
    let mut found = quantity.benches.iter().filter(|b| b.effect.found);
    found.any(|b| group.benches.contains(&b.name))
}

fn of_group(quantity: &QuantityFindings, group: &GroupLevel) -> String {
    let has = format!("{} has {}", group_words(group), quantity.quantity);
    format!("{has}: {}.", group_evidence(quantity, group))
}

fn of_group_or_bench(quantity: &QuantityFindings, group: &GroupLevel) -> String {
    let benches = if group.benches.len() == 1 {
        "bench"
    } else {
        "one of the benches"
    };
    format!(
        "{} or {benches} {} has {}: {}. To tell which, test some of its specimens on another bench, too.",
        group_words(group),
        named(&group.benches),
        quantity.quantity,
        group_evidence(quantity, group)
    )
}

fn group_evidence(quantity: &QuantityFindings, group: &GroupLevel) -> String {
    let level = &group.level;
    let value = interval(
        level.value,
        level.low95,
        level.high95,
        quantity.scale,
        &quantity.unit,
    );
    format!(
        "{value} (mean of {}, {}; the clearest single specimen is {:.1} standard errors from 0)",
        counted(group.specimens, "specimen"),
        counted(group.runs, "run"),
        group.largest_single_z.abs()
    )
}

fn of_batch(quantity: &QuantityFindings, group: &GroupLevel, difference: &PooledValue) -> String {
    let direction = if difference.value > 0.0 { "higher" } else { "lower" };
    format!(
        "{} has a {direction} {} than the other batches of its family by {}.{}",
        group_words(group),
        quantity.quantity,
        size(quantity, difference),
        alike(&quantity.quantity)
    )
}

/// The effects that look like an effect, as a sentence. One step from the model cannot tell them apart.
fn alike(code: &str) -> String {
    let Some(effect) = EFFECTS.iter().find(|effect| effect.code == code) else {
        return String::new();
    };
    let others = EFFECTS
        .iter()
        .filter(|o| effect.looks_like(o) || o.looks_like(effect));
    let codes: Vec<&str> = others.map(|o| o.code).collect();
    match codes.is_empty() {
        true => String::new(),
        false => format!(" What looks like it in such tests: {}.", named(&codes)),
    }
}

fn of_slope(quantity: &QuantityFindings, slope: &AgeSlope) -> String {
    let direction = if slope.slope.value > 0.0 { "grows" } else { "falls" };
    let where_seen = match &slope.family {
        Some(family) => format!("Family {family}:"),
        None => "All families together:".to_owned(),
    };
    format!(
        "{where_seen} {} {direction} per {} by {}.",
        quantity.quantity,
        slope.per.word(),
        size(quantity, &slope.slope)
    )
}

fn of_specimen(quantity: &QuantityFindings, specimen: &SpecimenDeviation) -> String {
    let direction = if specimen.deviation.value > 0.0 {
        "above"
    } else {
        "below"
    };
    let family = match specimen.batch.as_str() {
        "" => format!("family {}", specimen.family),
        batch => format!("batch {batch} of family {}", specimen.family),
    };
    let share = match (quantity.role, quantity.scale) {
        (QuantityRole::Effect, EstimateScale::Absolute) => "amplitude of ",
        _ => "",
    };
    format!(
        "Specimen {} has {share}{} {direction} the mean of {family} by {} ({:.1} standard errors of a specimen; {} on {} {}).",
        specimen.specimen,
        quantity.quantity,
        size(quantity, &specimen.deviation),
        specimen.deletion_t.abs(),
        counted(specimen.runs, "run"),
        if specimen.benches.len() == 1 {
            "bench"
        } else {
            "benches"
        },
        named(&specimen.benches)
    )
}

/// "F1-01: rate_n_per_mm 9.8 % above the drawing's 62 N/mm (95 % interval 9.2 to 10.4 %), tolerance 7 %: out of tolerance (10 runs)."
fn of_drawing(quantity: &QuantityFindings, judgement: &DrawingJudgement) -> String {
    let value = [
        judgement.value.value,
        judgement.value.low95,
        judgement.value.high95,
    ];
    let (size, place) = match judgement.nominal.filter(|nominal| *nominal > 0.0) {
        Some(nominal) => {
            let shares = value.map(|v| v / nominal - 1.0);
            let direction = if shares[0] < 0.0 { "below" } else { "above" };
            let unit = if quantity.unit == "1" { "" } else { &quantity.unit };
            let nominal = format!("{} {unit}", rounded(nominal));
            let of = match judgement.nominal_is_family_mean {
                true => format!("the mean of family {}, {},", judgement.family, nominal.trim_end()),
                false => format!("the drawing's {}", nominal.trim_end()),
            };
            let size = unsigned(shares, EstimateScale::Relative, "");
            (size, format!(" {direction} {of}"))
        }
        None => {
            let [value, low, high] = value;
            let size = interval(value, low, high, EstimateScale::Absolute, &quantity.unit);
            (size, String::new())
        }
    };
    let (size, range) = size.split_once(", ").unwrap_or((&size, ""));
    let remark = judgement
        .remark
        .as_ref()
        .map_or(String::new(), |remark| format!(" {remark}"));
    format!(
        "{}: {} {size}{place} ({range}), {}: {} ({}).{remark}",
        judgement.specimen,
        quantity.quantity,
        judgement.limits,
        judgement.verdict.words(),
        counted(judgement.runs, "run")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_alikes_are_named_from_both_sides_and_others_not_at_all() {
        let listing = EFFECTS
            .iter()
            .flat_map(|e| e.confusable_with.iter().map(move |other| (e.code, other.code)));
        let pairs: Vec<(&str, &str)> = listing.collect();
        assert!(!pairs.is_empty());
        for (code, other) in &pairs {
            assert!(
                alike(code).contains(other) && alike(other).contains(code),
                "{code} and {other}"
            );
        }
        let lonely = EFFECTS
            .iter()
            .find(|e| pairs.iter().all(|(a, b)| *a != e.code && *b != e.code));
        assert_eq!(lonely.map_or(String::new(), |e| alike(e.code)), "");
        assert_eq!(alike("rate_n_per_mm"), "", "a parameter looks like nothing");
    }
}
