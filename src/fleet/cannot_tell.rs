//! What the table cannot tell, and what to do about it.

use std::collections::BTreeMap;

use super::design::DesignTerm;
use super::outliers::{QuantityFits, RobustFit};
use super::quantity::FEWEST_SPECIMENS;
use super::quantity_data::PooledSpecimen;
use super::wording::named;

/// One sentence for each thing that cannot be told, with the quantities for which it holds. `too_few`: quantities without a fit.
pub(super) fn cannot_tell(fits: &[QuantityFits], too_few: &[&str]) -> Vec<String> {
    let mut quantities_of: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for robust in fits.iter().map(|fit| &fit.within) {
        let reasons = [
            benches(robust),
            confounded(robust),
            small_groups(robust),
            alone_in_batch(robust),
            alone_on_bench(robust),
            not_asked(robust),
        ];
        for reason in reasons.into_iter().flatten() {
            let quantities = quantities_of.entry(reason).or_default();
            quantities.push(&robust.design.of.rows[0].quantity);
        }
    }
    if !too_few.is_empty() {
        let reason = "there are too few runs for a fit: add runs".to_owned();
        quantities_of.insert(reason, too_few.to_vec());
    }
    let all = fits.len() + too_few.len();
    let sentence = |(reason, quantities): (String, Vec<&str>)| match quantities.len() == all {
        true => format!("For all quantities {reason}."),
        false => format!("For {} {reason}.", named(&quantities)),
    };
    quantities_of.into_iter().map(sentence).collect()
}

/// Benches that no specimen connects.
fn benches(robust: &RobustFit) -> Vec<String> {
    let data = robust.design.of;
    let names = |part: usize| -> Vec<&str> {
        let benches = data.benches_of_part(part).into_iter();
        benches.map(|b| data.benches.names[b]).collect()
    };
    if data.benches.names.len() == 1 {
        return vec![format!(
            "an error of bench {} cannot be told: test one specimen on another bench, too",
            names(0)[0]
        )];
    }
    if data.parts() == 1 {
        return Vec::new();
    }
    let parts: Vec<String> = (0..data.parts())
        .map(|p| format!("({})", names(p).join(", ")))
        .collect();
    vec![format!(
        "the benches {} cannot be compared, as no specimen was tested on both sides: test one specimen on a bench of each",
        named(&parts)
    )]
}

/// Effects that follow from others.
fn confounded(robust: &RobustFit) -> Vec<String> {
    let (design, data) = (&robust.design, robust.design.of);
    let mut reasons = Vec::new();
    let slopes = [
        (
            DesignTerm::Cycles(None),
            "cycles",
            "with another number of cycles",
        ),
        (DesignTerm::Years, "time", "at another time"),
    ];
    for (term, word, again) in slopes {
        if design.is_confounded(term) {
            reasons.push(format!(
                "a change with {word} cannot be told from families and benches: test some specimens again {again}"
            ));
        }
    }
    for (g, group) in data.groups.iter().enumerate() {
        if (0..group.batches.len()).any(|b| design.is_confounded(DesignTerm::Batch(g, b))) {
            reasons.push(format!(
                "the batches of family {} cannot be told from benches and age: test a batch on another bench, too",
                group.family
            ));
        }
    }
    let operators = &data.operators.names;
    if (0..operators.len()).any(|o| design.is_confounded(DesignTerm::Operator(o))) {
        reasons.push(
            "some operators cannot be told from benches, families or batches: let two operators test one specimen on one bench"
                .to_owned(),
        );
    }
    reasons
}

/// Families with too few specimens to call one of them different.
fn small_groups(robust: &RobustFit) -> Vec<String> {
    let data = robust.design.of;
    let members = |g: usize| data.specimens.iter().filter(|s| s.group == g).count();
    let small = (0..data.groups.len()).filter(|g| members(*g) < FEWEST_SPECIMENS);
    let mut families: Vec<&str> = small.map(|g| data.groups[g].family).collect();
    families.dedup();
    match families.is_empty() {
        true => Vec::new(),
        false => vec![format!(
            "a specimen that differs cannot be told in family {}, which has fewer than {FEWEST_SPECIMENS} specimens that can be compared: \
             test more of them",
            named(&families)
        )],
    }
}

/// Specimens that are the only one of their batch.
fn alone_in_batch(robust: &RobustFit) -> Vec<String> {
    let data = robust.design.of;
    let same_batch = |a: &PooledSpecimen, b: &PooledSpecimen| a.group == b.group && a.batch == b.batch;
    let is_alone = |s: &&PooledSpecimen| {
        let beside = data.specimens.iter().filter(|o| same_batch(o, s)).count();
        beside == 1 && data.groups[s.group].batches.len() > 1
    };
    let alone: Vec<&str> = data.specimens.iter().filter(is_alone).map(|s| s.name).collect();
    match alone.is_empty() {
        true => Vec::new(),
        false => vec![format!(
            "a difference of {} from its family is one of its batch, of which there is no other specimen: test another one of the batch",
            named(&alone)
        )],
    }
}

/// Specimens that are the only one of their family on the only bench on which they were tested.
fn alone_on_bench(robust: &RobustFit) -> Vec<String> {
    let data = robust.design.of;
    let bench = |s: usize| data.benches.of_row[data.specimens[s].rows.start];
    let is_alone = |s: &usize| {
        let (own, members) = (&data.specimens[*s], data.specimens.iter());
        let mut others = members.filter(|o| o.group == own.group && o.name != own.name);
        let is_there = |o: &PooledSpecimen| data.benches.of_row[o.rows.clone()].contains(&bench(*s));
        !data.travels(*s) && data.groups[own.group].benches.len() > 1 && !others.any(is_there)
    };
    let alone = (0..data.specimens.len()).filter(is_alone);
    let alone: Vec<&str> = alone.map(|s| data.specimens[s].name).collect();
    match alone.is_empty() {
        true => Vec::new(),
        false => vec![format!(
            "a difference of {} from its family is one of its bench, where no other specimen of the family was tested: test it on \
             another bench, too",
            named(&alone)
        )],
    }
}

/// Questions that the table has no spread for.
fn not_asked(robust: &RobustFit) -> Vec<String> {
    let design = &robust.design;
    let is_missing = |term: DesignTerm| !design.has(term) && !design.is_confounded(term);
    let mut reasons = Vec::new();
    if is_missing(DesignTerm::Cycles(None)) {
        reasons.push("a change with cycles cannot be told, as all runs have the same age_cycles".to_owned());
    }
    if is_missing(DesignTerm::Years) {
        reasons.push(
            "a change with time cannot be told, as the runs span less than a quarter of a year".to_owned(),
        );
    }
    reasons
}

#[cfg(test)]
mod tests {
    use crate::fleet::tests::synthetic::SyntheticLab;
    use crate::fleet::{FleetOptions, pool};

    #[test]
    fn a_specimen_alone_on_its_bench_is_named_and_one_beside_others_is_not() {
        let lab = SyntheticLab {
            specimens: 12,
            runs: 96,
            ..SyntheticLab::default()
        };
        let mut rows = lab.table(5);
        rows.retain(|row| row.quantity == "rate_n_per_mm");
        let said = |rows: &[_]| {
            let pooled = pool(rows, &FleetOptions::default()).expect("pooled");
            pooled.cannot_tell.join("\n")
        };
        assert!(!said(&rows).contains("is one of its bench"), "{}", said(&rows));
        // S004 was the only one of family F1 on bench B3 and on B1, too; now S008 is there alone and nowhere else.
        for row in &mut rows {
            match row.specimen.as_str() {
                "S004" => row.bench = "B1".to_owned(),
                "S008" => row.bench = "B3".to_owned(),
                _ => {}
            }
        }
        let said = said(&rows);
        assert!(
            said.contains("a difference of S008 from its family is one of its bench"),
            "{said}"
        );
    }
}
