use leafbench::model::Plant;
use leafbench::model::leaf_pack::*;
use std::time::Instant;
fn values(mu: f64) -> Values {
    Values {
        interleaf_mu: mu,
        ..Values::frictionless()
    }
}
#[test]
fn probe() {
    let t = Instant::now();
    for _ in 0..100 {
        LeafPack::new(&Structure::default(), &values(0.3)).unwrap();
    }
    println!("build {:?}", t.elapsed() / 100);
    run("rail", &Structure::default(), values(0.3));
    run(
        "rail full",
        &Structure {
            mirror: false,
            ..Structure::default()
        },
        values(0.3),
    );
    run(
        "rail all",
        &Structure::default(),
        Values {
            pin_mu: 0.2,
            rail_mu: 0.1,
            rail_constant_n: 10.0,
            pivot_torque_nmm: 2000.0,
            ..values(0.15)
        },
    );
    let s = Structure {
        mounting: Mounting::Shackle,
        ..Structure::default()
    };
    for deg in [20.0f64, 26.0] {
        run(
            "shackle",
            &s,
            Values {
                shackle_angle_rad: deg.to_radians(),
                ..values(0.3)
            },
        );
    }
    run(
        "shackle all",
        &s,
        Values {
            pin_mu: 0.2,
            board_mu: 0.4,
            pivot_torque_nmm: 2000.0,
            ..values(0.15)
        },
    );
    run(
        "rail dyn",
        &Structure {
            dynamics: Dynamics::Full,
            ..Structure::default()
        },
        values(0.3),
    );
    run(
        "shackle dyn",
        &Structure {
            dynamics: Dynamics::Full,
            ..s.clone()
        },
        Values {
            pin_mu: 0.2,
            board_mu: 0.4,
            pivot_torque_nmm: 2000.0,
            ..values(0.15)
        },
    );
    run(
        "rail hertz",
        &Structure {
            contact_law: NormalChoice::Hertz,
            ..Structure::default()
        },
        values(0.3),
    );
    run(
        "rail tanh",
        &Structure {
            friction_law: FrictionChoice::Tanh,
            ..Structure::default()
        },
        values(0.3),
    );
}

fn run(name: &str, s: &Structure, v: Values) {
    let mut p = LeafPack::new(s, &v).unwrap();
    let path = graded_path(&[0.0, 26.0, 0.0], 1.0);
    let t = cpu();
    let out = p.static_path(&path, 120.0);
    let el = (cpu() - t) * 1e3;
    let e: f64 = out
        .windows(2)
        .map(|w| 0.5 * (w[0].force_n + w[1].force_n) * (w[1].displacement_mm - w[0].displacement_mm))
        .sum();
    let fmax = out.iter().map(|p| p.force_n).fold(0.0, f64::max);
    let en = p.energy();
    println!(
        "{name} static {} steps {el:.2} ms Fmax {fmax:.1} E {:.4} effort {:?} unconv {} balance {:.2e} {:?}",
        path.len(),
        e * 1e-3,
        p.effort(),
        p.unconverged(),
        (en.work_nmm - en.stored_nmm - en.lost_nmm()) / en.work_nmm,
        en.dissipated_nmm.map(|x| x.round())
    );
    p.reset();
    let (mut fmax, mut e, mut last) = (0.0f64, 0.0, (0.0, 0.0));
    let mut times = vec![];
    for k in 0..5000 {
        let d = 5.0 - 3.0 * (k as f64 * 1e-3 * std::f64::consts::TAU).cos();
        let t1 = cpu();
        let f = p.step(d, 1e-3);
        times.push((cpu() - t1) * 1e6);
        if k == 2000 {
            e = 0.0;
        }
        if k > 1000 {
            fmax = fmax.max(f);
        }
        if k <= 3000 {
            e += 0.5 * (f + last.1) * (d - last.0);
        }
        last = (d, f);
    }
    let mean = times.iter().sum::<f64>() / 5000.0;
    times.sort_by(f64::total_cmp);
    println!(
        "    sine Fmax {fmax:.1} E {:.4} mean {mean:.2} p50 {:.2} p99 {:.1} p99.9 {:.1} max {:.0} us effort {:?} unconv {}",
        e * 1e-3,
        times[2500],
        times[4950],
        times[4995],
        times[4999],
        p.effort(),
        p.unconverged()
    );
}

fn cpu() -> f64 {
    let t = nix::time::clock_gettime(nix::time::ClockId::CLOCK_THREAD_CPUTIME_ID).unwrap();
    t.tv_sec() as f64 + t.tv_nsec() as f64 * 1e-9
}
