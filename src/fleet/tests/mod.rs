//! Tests of pooling on synthetic labs.

mod synthetic;

use super::*;
use synthetic::SyntheticLab;

#[test]
#[ignore]
fn look() {
    let t = std::time::Instant::now();
    for seed in [1, 2, 3, 4] {
        let f = pool(
            &SyntheticLab::with_everything().table(seed),
            &FleetOptions::default(),
        )
        .unwrap();
        println!("--- seed {seed} questions {} {:?}", f.questions, t.elapsed());
        for x in &f.findings {
            println!("{:.1e} {}", x.adjusted_p, x.sentence);
        }
        for q in f.quantities.iter().filter(|q| q.quantity == "series_compliance") {
            println!("tau {} sigma {}", q.between_specimens, q.run_to_run);
            for g in &q.groups {
                println!("{} {:?} {:?} {:?}", g.family, g.batch, g.benches, g.level);
            }
            for g in &q.benches {
                println!("{} {:?}", g.name, g.effect);
            }
        }
        for x in &f.bench_causes {
            println!("{}", x.sentence);
        }
        for x in &f.cannot_tell {
            println!("? {x}");
        }
    }
    let big = SyntheticLab {
        specimens: 400,
        runs: 10000,
        ..SyntheticLab::with_everything()
    }
    .table(3);
    let one: Vec<_> = big
        .into_iter()
        .filter(|r| r.quantity == "rate_n_per_mm")
        .collect();
    let t = std::time::Instant::now();
    let d = QuantityData::of(one.iter().collect());
    println!("data {:?}", t.elapsed());
    let r = RobustFit::with(&d, Default::default());
    println!("one fit {:?} {:?}", t.elapsed(), r.map(|r| r.fit.variances));
    let r = RobustFit::of(&d, true);
    println!("robust fit {:?} {:?}", t.elapsed(), r.map(|r| r.choice));
    let t = std::time::Instant::now();
    pool(&one, &FleetOptions::default()).unwrap();
    println!("10000 rows {:?}", t.elapsed());
}

#[test]
#[ignore]
fn nothing() {
    let mut names: BTreeMap<String, usize> = BTreeMap::new();
    let mut wrong = 0;
    for seed in 1000..1200 {
        let f = pool(&SyntheticLab::default().table(seed), &FleetOptions::default()).unwrap();
        wrong += usize::from(!f.findings.is_empty());
        for x in &f.findings {
            *names.entry(format!("{:?} {}", x.kind, x.quantity)).or_default() += 1;
            println!("{seed} {:.1e} {}", x.adjusted_p, x.sentence);
        }
    }
    println!("wrong {wrong} of 200 {names:#?}");
}
