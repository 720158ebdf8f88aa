//! The worlds of the blind test draw, size and record their cases, and the labels stay sealed. How often the diagnosis is right
//! there is measured by `leafbench blind --world all`, not here.

use rayon::prelude::*;

use crate::blind::settle::settle;
use crate::blind::{BlindRequest, by_world, examine, run};
use crate::diagnose::note::NoteKind;
use crate::diagnose::{Diagnosis, Verdict};
use crate::effect::Axis;
use crate::truth::catalogue::PHYSICS;
use crate::truth::{Case, Family, World};

/// All worlds but that of the other tests.
const FOREIGN: [World; 4] = [
    World::PrandtlIshlinskii,
    World::BoucWen,
    World::Lugre,
    World::Pack,
];
/// Strength in detection limits.
const CLEAR: f64 = 5.0;

#[test]
fn the_same_seed_draws_the_same_bits_in_every_world_and_each_world_other_ones() {
    let drawn: Vec<Vec<Case>> = World::ALL
        .par_iter()
        .map(|&world| {
            let round = (0..8).map(|number| Case::draw(world, 3, number, None));
            round.collect()
        })
        .collect();
    for (world, cases) in World::ALL.into_iter().zip(&drawn) {
        for case in cases.iter().take(3) {
            assert_eq!(*case, Case::draw(world, 3, case.label.number, None));
            assert_eq!(case.label.world, world);
        }
        for (case, own) in cases.iter().zip(&drawn[0]).filter(|_| world != World::Own) {
            assert_ne!(case.recordings, own.recordings, "{world:?}");
        }
    }
}

/// Every effect of the catalogue has a size that makes it visible in two of the worlds, every second in each, and its recordings
/// are valid.
#[test]
fn effects_are_visible_in_every_world() {
    let pairs: Vec<(World, &str)> = (0..FOREIGN.len())
        .flat_map(|w| {
            let every_second = PHYSICS.iter().skip(w % 2).step_by(2);
            every_second
                .filter(move |p| p.is_in(FOREIGN[w]))
                .map(move |p| (FOREIGN[w], p.code))
        })
        .collect();
    assert!(pairs.len() > 40, "{}", pairs.len());
    let wrong: Vec<String> = pairs
        .par_iter()
        .filter_map(|&(world, code)| {
            let Some(case) = Case::foreign(world, code, 5, CLEAR) else {
                return Some(format!("{code} in {world:?}: not visible"));
            };
            let hidden = case.label.hidden[0];
            let has_laws = PHYSICS.iter().any(|p| p.code == code && !p.laws.is_empty());
            let finite = case
                .recordings
                .iter()
                .all(|r| r.force_n.iter().chain(&r.displacement_mm).all(|v| v.is_finite()));
            let right = finite && hidden.code == code && hidden.law.is_some() == has_laws;
            (!right).then(|| format!("{code} in {world:?}: {hidden:?}, finite: {finite}"))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The diagnosis receives the recordings and the baseline: nothing in them names world, law, effect or imperfection.
#[test]
fn the_label_is_not_in_what_the_diagnosis_receives() {
    for (world, number) in FOREIGN.into_iter().flat_map(|w| (0..10).map(move |n| (w, n))) {
        let case = Case::draw(world, 9, number, Some(CLEAR));
        let label = serde_json::to_value(&case.label).expect("plain data");
        assert_eq!(label["world"], serde_json::to_value(world).expect("a name"));
        assert_eq!(
            label["nuisance"].is_string(),
            case.label.family == Family::Nuisance
        );
        for (k, r) in case.recordings.iter().enumerate() {
            assert_eq!(r.name, format!("case-{number:04}-{}.csv", k + 1));
            let columns = (&r.command, &r.cycle, &r.flags, &r.command_mode);
            assert_eq!(columns, (&None, &None, &None, &None));
        }
        assert_eq!((case.baseline.tuned, case.baseline.smoothing_mm_s.is_some()), {
            let smoothed = case
                .label
                .hidden
                .iter()
                .any(|h| h.code == "rate_independent_friction");
            (None, smoothed)
        });
    }
}

/// A case of the pack took 356 million steps of the model: half of them in the search for the knee of a progressive spring, which
/// followed a valley in small moves. In another, each search of single effects found the baseline's minimum a little lower and began
/// again; it had no end after 15 minutes.
#[test]
fn a_difficult_case_stays_near_the_budget() {
    for (seed, number) in [(424_242, 11), (633_368_069, 34)] {
        let case = Case::draw(World::Pack, seed, number, None);
        let diagnosis = examine(&case, &case.recordings, 0).expect("valid recordings");
        let steps = diagnosis.model_steps;
        assert!(steps < 250_000_000, "{seed}: {steps}");
        assert!(!diagnosis.search_cut_short, "{seed}: {}", diagnosis.summary);
    }
}

/// A pack of beams whose leaves touch at 0.4, 2.3 and 5.9 mm, and nothing hidden in a case that was looked at. With one knee, and with
/// friction from no load on, seven times the noise was left, and a presliding of 50 mm, the end of its range, had to make up for it.
#[test]
fn the_leaves_of_a_pack_touch_one_after_the_other() {
    let case = Case::draw(World::Pack, 633_368_069, 16, None);
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    let [knees] = found.effects.as_slice() else {
        panic!("{}", found.summary);
    };
    assert_eq!(knees.code, "progressive_stiffness", "{}", found.summary);
    assert!(
        knees.statement.contains("leaves touch one after the other"),
        "{}",
        knees.statement
    );
    let after = found.fit.improved.nrmse_heldout / found.fit.noise_floor_nrmse;
    assert!(after < 1.5, "{after}");
    let presliding = found
        .baseline_parameters
        .iter()
        .find(|p| p.name == "presliding_mm");
    assert!(presliding.is_some_and(|p| p.value < 5.0), "{presliding:?}");
}

/// Packs that were looked at. A leaf that touches at 3 to 5 % of the travel was named a contact that closes, with 48 to 72 %, although 10 to 130 N
/// were measured below it: alone where nothing was hidden (52), beside the other leaves (19), and beside a friction that falls with speed. A
/// contact on a pad (34) is still one: the force rises a little just below it.
#[test]
fn a_leaf_that_touches_low_in_the_travel_is_no_contact_that_closes() {
    let named = |seed, number| {
        let case = Case::draw(World::Pack, seed, number, None);
        let found = examine(&case, &case.recordings, 0).expect("valid recordings");
        let codes = found.effects.iter().map(|e| e.code.clone());
        codes.collect::<Vec<_>>()
    };
    let contact = "lift_off".to_owned();
    assert!(!named(2_804_809_184, 19).contains(&contact));
    assert_eq!(named(2_804_809_184, 52), ["progressive_stiffness"]);
    assert_eq!(named(1_427_208_227, 46), ["progressive_stiffness", "stribeck"]);
    assert!(named(3_850_344_161, 34).contains(&contact));
}

/// LuGre friction and nothing hidden but what its law does otherwise than the library's. With its shape in doubt only at a tenth of the
/// friction, a Coulomb friction was named at 99 % beside or instead of the truth.
#[test]
fn the_shape_of_a_friction_law_is_no_coulomb_friction() {
    for number in [9, 28] {
        let case = Case::draw(World::Lugre, 3_789_621_201, number, None);
        let diagnosis = examine(&case, &case.recordings, 0).expect("valid recordings");
        let hidden: Vec<&str> = case.label.hidden.iter().map(|h| h.code).collect();
        let named: Vec<&str> = diagnosis.effects.iter().map(|e| e.code.as_str()).collect();
        assert_eq!(named, hidden, "{number}: {}", diagnosis.summary);
    }
}

/// Cases that were looked at, with what they answered before: zeros of the LVDT beside a foreign friction (unexplained, 20 times the
/// noise), a run-in by the travel (warming, 97 %), and a lift-off on a pad beside a foreign friction (warming).
#[test]
fn effects_of_time_are_not_what_a_foreign_friction_looks_like() {
    let diagnosed = |world, seed, number| {
        let case = Case::draw(world, seed, number, None);
        examine(&case, &case.recordings, 0).expect("valid recordings")
    };
    let zeros = diagnosed(World::PrandtlIshlinskii, 850_540_988, 22);
    assert_eq!(zeros.verdict, Verdict::Adequate, "{}", zeros.summary);
    assert!(
        zeros
            .notes
            .iter()
            .any(|n| n.text.contains("zero of the displacement differs")),
        "{:?}",
        zeros.notes
    );
    let names = |d: &Diagnosis| d.effects.iter().map(|e| e.code.clone()).collect::<Vec<_>>();
    let run_in = diagnosed(World::BoucWen, 5001, 5);
    assert!(
        names(&run_in).contains(&"run_in".to_owned()),
        "{}",
        run_in.summary
    );
    assert!(
        !names(&run_in).contains(&"warming".to_owned()),
        "{}",
        run_in.summary
    );
    let pad = diagnosed(World::BoucWen, 5001, 0);
    assert!(!names(&pad).contains(&"warming".to_owned()), "{}", pad.summary);
}

/// A specimen that carries less in the middle of its travel after the third cycle. What had changed once was taken for slow noise of 3.8 N
/// in every recording, and the answer was `adequate`.
#[test]
fn a_loss_of_strength_is_no_slow_noise() {
    let case = Case::draw(World::BoucWen, 5001, 3, None);
    assert_eq!(case.label.hidden[0].code, "strength_loss");
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    assert_eq!(found.verdict, Verdict::Unexplained, "{}", found.summary);
    assert!(found.notes.is_empty(), "{:?}", found.notes);
}

/// Nothing is hidden here but friction that forgets reversals, in random motions. What the usual law leaves of them is 40 times the noise
/// and follows no axis, so the other law was not tried, and the answer was `unexplained`.
#[test]
fn another_friction_law_is_tried_where_a_random_motion_leaves_more_than_noise() {
    let mut case = Case::draw(World::BoucWen, 2_893_685_161, 32, None);
    for recording in &mut case.recordings {
        recording.turn_signs(false, true);
    }
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    assert_eq!(found.verdict, Verdict::Adequate, "{}", found.summary);
}

/// Cases that were looked at, with what they answered before: a joint of two rates (a helper leaf, 95 %, without an alternative) and a contact
/// with a soft corner (a helper leaf, 47 %).
#[test]
fn a_joint_that_closes_and_a_soft_contact_are_named() {
    let cases = [
        (World::Lugre, 3_500_918_740, 26, "series_compliance"),
        (World::Lugre, 3_989_117_048, 15, "lift_off"),
    ];
    for (world, seed, number, hidden) in cases {
        let case = Case::draw(world, seed, number, None);
        let found = examine(&case, &case.recordings, 0).expect("valid recordings");
        let named: Vec<&str> = found.effects.iter().map(|e| e.code.as_str()).collect();
        assert_eq!(named, [hidden], "{}", found.summary);
        assert!(found.effects[0].confidence < 0.86, "{}", found.summary);
        // The bench file that is written has the law with all its parameters.
        found.improved.plant().expect("a model that can be built");
    }
}

/// Cases that were looked at: contacts that close at 0.4, 0.4 and 0.9 mm, beside nothing, Stribeck friction and relaxation. A helper leaf
/// was named for each, with 48 to 79 %, but below its knee the spring had 10 to 14 % of its rate, and there is no such spring.
#[test]
fn where_hardly_a_spring_is_left_below_a_knee_a_contact_closes() {
    let cases: [(u64, u64, &[&str]); 3] = [
        (2_102_910_507, 59, &["lift_off"]),
        (2_102_910_507, 54, &["lift_off", "stribeck"]),
        (1_427_208_227, 34, &["lift_off", "relaxation"]),
    ];
    for (seed, number, hidden) in cases {
        let case = Case::draw(World::BoucWen, seed, number, None);
        let found = examine(&case, &case.recordings, 0).expect("valid recordings");
        let mut named: Vec<&str> = found.effects.iter().map(|e| e.code.as_str()).collect();
        named.sort_unstable();
        assert_eq!(named, hidden, "{seed} {number}: {}", found.summary);
        found.improved.plant().expect("a model that can be built");
    }
}

/// A case that was looked at: delays of 1 to 3 ms in fast recordings. A ramp of 0.4 mm/s got a delay of 29 ms, too, which no ramp shows, and
/// friction near zero speed and warm friction were named with 95 and 91 %.
#[test]
fn a_slow_ramp_shows_no_delay() {
    let case = Case::draw(World::PrandtlIshlinskii, 1_427_208_227, 58, None);
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    let skew = found.notes.iter().filter(|note| note.kind == NoteKind::Skew);
    let skewed: Vec<&str> = skew.map(|note| note.recording.as_str()).collect();
    assert!(
        !skewed.is_empty() && !skewed.contains(&case.recordings[0].name.as_str()),
        "{skewed:?}"
    );
    assert!(
        found.effects.iter().all(|e| e.confidence < 0.9),
        "{}",
        found.summary
    );
}

/// A case that was looked at: nothing is hidden but spikes. One of 330 N in a fast motion was not seen, and a compliance was named.
#[test]
fn a_spike_in_a_fast_motion_is_no_compliance() {
    let case = Case::draw(World::Lugre, 1_427_208_227, 52, None);
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    assert_eq!(found.verdict, Verdict::Adequate, "{}", found.summary);
    assert!(!found.summary.contains("fit badly"), "{}", found.summary);
}

/// Cases that were looked at: friction at one place, and a ripple. Only the slow ramp shows them, and a single sweep has no cycle to hold out:
/// both were `baseline_adequate`.
#[test]
fn what_only_a_slow_ramp_shows_is_unknown() {
    let diagnosed = |seed, number| {
        let case = Case::draw(World::Lugre, seed, number, None);
        let found = examine(&case, &case.recordings, 0).expect("valid recordings");
        assert_eq!(found.verdict, Verdict::Unexplained, "{}", found.summary);
        let single = format!("{} is a single sweep", case.recordings[0].name);
        assert!(found.summary.contains(&single), "{}", found.summary);
        (case, found)
    };
    diagnosed(1_427_208_227, 3);
    let (case, found) = diagnosed(777_013, 83);
    // What is located first is the place of the friction.
    let (place, hidden) = (&found.location[0], &case.label.hidden[0]);
    assert_eq!(place.axis, Axis::DisplacementMm, "{}", found.summary);
    let middle_mm = 0.5 * (place.from + place.to);
    assert!(
        (middle_mm - hidden.place).abs() < 0.5 * hidden.width,
        "{}",
        found.summary
    );
    // The next test repeats the ramp. Its cycles show the friction, too, and it stays unknown.
    let settled = settle(&case, found);
    assert_eq!(settled.tests[0], "next-test-ramp-60-s-four-times");
    let last = settled.answer.expect("valid recordings");
    assert_eq!(last.verdict, Verdict::Unexplained, "{:?}", settled.path);
    let place = last.locations.iter().find(|l| l.0 == "displacement_mm");
    let (_, from, to) = place.expect("located");
    assert!((0.5 * (from + to) - hidden.place).abs() < 0.5 * hidden.width);
}

/// A case that was looked at: slow noise that was not found. The place of what the baseline leaves and of what the chosen set leaves is the same.
#[test]
fn no_place_is_told_twice() {
    let case = Case::draw(World::BoucWen, 3_883_214_968, 38, None);
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    assert_eq!(found.verdict, Verdict::Unexplained, "{}", found.summary);
    for (k, place) in found.location.iter().enumerate() {
        assert!(!found.location[..k].contains(place), "{}", place.words);
    }
}

/// Friction that fades with the logarithm of the speed. What its law misses looked like a compliance of the fixture, which was named, too,
/// with 30 %.
#[test]
fn what_a_law_of_speed_misses_is_no_compliance() {
    let case = Case::draw(World::Lugre, 3_500_918_740, 39, None);
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    let named: Vec<&str> = found.effects.iter().map(|e| e.code.as_str()).collect();
    assert_eq!(named, ["stribeck"], "{}", found.summary);
}

/// Nothing is hidden here. The freer friction law leaves 3 % of the force that it explains; that was `unexplained`.
#[test]
fn what_a_friction_law_leaves_of_another_is_its_own_error() {
    let case = Case::draw(World::BoucWen, 3_500_918_740, 16, None);
    assert!(case.label.hidden.is_empty());
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    assert_eq!(found.verdict, Verdict::Adequate, "{}", found.summary);
    assert!(
        found
            .summary
            .contains("of what the freer friction law changes in the force"),
        "{}",
        found.summary
    );
}

/// Nothing is hidden here. The recordings were shifted along the line of the spring, by up to -73 N and -1.4 mm with a delay of 11 ms, to
/// fit what the model does not know; then the rest was `unexplained`.
#[test]
fn a_shift_along_the_line_of_a_spring_is_no_offset() {
    let case = Case::draw(World::Own, 910_159_277, 38, None);
    assert!(case.label.hidden.is_empty());
    let found = examine(&case, &case.recordings, 0).expect("valid recordings");
    assert_eq!(found.verdict, Verdict::Adequate, "{}", found.summary);
    assert!(found.notes.is_empty(), "{:?}", found.notes);
}

/// Cases that were looked at, with what they answered before: a joint that closes under load and a contact on a pad (a helper leaf, 95
/// and 99 %), gaps and a start within a cycle (`unexplained`), and a shaken displacement (a helper leaf and a clipped load cell, 98 %).
/// Beside the elements the joint is an alternative; beside the friction that forgets it is not listed any more.
#[test]
fn a_curve_may_be_that_of_a_joint_and_a_bad_point_is_no_physics() {
    let diagnosed = |world, number| {
        let case = Case::draw(world, 910_159_277, number, None);
        examine(&case, &case.recordings, 0).expect("valid recordings")
    };
    for (number, other) in [(79, "series_compliance"), (55, "lift_off")] {
        let found = diagnosed(World::BoucWen, number);
        let named = found.effects.iter().map(|effect| &effect.code);
        let listed = found.alternatives.iter().map(|alternative| &alternative.code);
        let said = named.chain(listed).any(|code| code == other);
        assert!(said, "{number}: {}", found.summary);
        let sure = found
            .effects
            .iter()
            .any(|e| e.code != other && e.confidence >= 0.9);
        assert!(!sure, "{number}: {}", found.summary);
    }
    let (pi, bouc_wen) = (World::PrandtlIshlinskii, World::BoucWen);
    for (world, number) in [(pi, 67), (pi, 47), (bouc_wen, 38)] {
        let found = diagnosed(world, number);
        assert_eq!(
            found.verdict,
            Verdict::Adequate,
            "{world:?} {number}: {}",
            found.summary
        );
    }
}

/// Cases that were looked at: filters on one channel, and no effect. Friction near zero speed was named with its exponent at the limit of its
/// range, or the delay was refused although its size was right, because the law beside the path is another one. In the third, a few
/// points of one small loop were off by up to 77 N, and all was `unexplained`; the law forgets now.
#[test]
fn a_foreign_friction_law_neither_refuses_a_delay_nor_makes_one_small_loop_unexplained() {
    let diagnosed = |seed, number| {
        let case = Case::draw(World::Lugre, seed, number, None);
        examine(&case, &case.recordings, 0).expect("valid recordings")
    };
    for late in [diagnosed(910_159_277, 4), diagnosed(4_067_032_518, 35)] {
        let named: Vec<&str> = late.effects.iter().map(|e| e.code.as_str()).collect();
        assert_eq!(named, ["channel_delay"], "{}", late.summary);
    }
    let loops = diagnosed(4_067_032_518, 38);
    assert_eq!(loops.verdict, Verdict::Adequate, "{}", loops.summary);
}

/// Nothing is hidden in these cases that were looked at, but the friction forgets earlier reversals. Beside elements that close every small
/// loop, a compliance of the fixture was named in the first four (33, 54, 58 and 64 %). In the last three, no structure was left and up to a
/// third more than noise, or the fit of the other law went back to the baseline's own; two of them were `unexplained` and a damping (40 %).
#[test]
fn friction_that_forgets_is_no_compliance() {
    let cases = [
        (World::Lugre, 4_067_032_518, 1),
        (World::Lugre, 4_067_032_518, 9),
        (World::Lugre, 4_067_032_518, 16),
        (World::Lugre, 821_968_164, 9),
        (World::BoucWen, 3_500_918_740, 9),
        (World::BoucWen, 3_500_918_740, 21),
    ];
    for (world, seed, number) in cases {
        let case = Case::draw(world, seed, number, None);
        assert!(case.label.hidden.is_empty());
        let found = examine(&case, &case.recordings, 0).expect("valid recordings");
        assert_eq!(
            found.verdict,
            Verdict::Adequate,
            "{world:?} {seed} {number}: {}",
            found.summary
        );
    }
}

/// Twenty cases of the worlds that do not share the library's formulas, five of each, beside the sixty of `tests/blind.rs`, and one that
/// does: sealed, diagnosed, opened and scored in the row of their world. Only recordings of imperfect instruments are refused, and at
/// most one wrong name is given with 90 %. How often the names are right is in docs/blind-worlds.md.
#[test]
fn twenty_sealed_cases_of_foreign_worlds() {
    let scores: Vec<_> = World::ALL
        .into_iter()
        .flat_map(|world| {
            let cases = if world == World::Own { 1 } else { 5 };
            let request = BlindRequest {
                cases,
                seed: 20_261,
                world,
                strength: None,
                family: None,
                look_alikes: 0,
                threads: std::thread::available_parallelism().map_or(1, usize::from),
            };
            run(
                &request,
                &mut |labels| assert_eq!(labels.len() as u64, cases),
                &|_| {},
            )
            .expect("labels match")
        })
        .collect();
    let mut refused = scores.iter().filter(|s| s.refused.is_some());
    assert!(refused.all(|s| s.label.family == Family::Nuisance));
    let rows = by_world::rows(&scores);
    let whole: Vec<_> = rows.iter().filter(|r| r.family.is_none()).collect();
    let worlds: Vec<World> = whole.iter().map(|r| r.world).collect();
    assert_eq!(worlds, World::ALL);
    let sure: u64 = whole.iter().map(|r| r.wrong_and_sure.yes as u64).sum();
    assert!(sure <= 1, "{}", by_world::text(&rows));
    for score in &scores {
        let json = serde_json::to_value(score).expect("plain data");
        assert_eq!(json["world"], serde_json::to_value(score.world).expect("a name"));
        assert_eq!(json["label"]["world"].is_null(), score.world == World::Own);
    }
}
