use leafbench::model::Plant;
use leafbench::model::leaf_pack::*;
use std::time::Instant;

fn values(mu: f64) -> Values { Values { interleaf_mu: mu, ..Values::frictionless() } }

#[test]
fn probe() {
    for clamp in [0.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 150.0] {
        let mut p = LeafPack::new(&Structure::default(), &Values { clamp_length_mm: clamp, ..values(0.0) }).unwrap();
        let f: Vec<f64> = [2.0, 5.0, 8.0, 20.0].iter().map(|d| p.step(*d, 1.0)).collect();
        println!("clamp {clamp}: rate {:.2} {:.2} unconv {} tips {:?}", (f[2]-f[0])/6.0, (f[3]-f[2])/12.0, p.unconverged(), p.effort());
    }
    let t = Instant::now();
    let mut p = LeafPack::new(&Structure::default(), &values(0.3)).unwrap();
    println!("build {:?} segments {}", t.elapsed(), p.segments());
    for c in p.shape().contacts.iter().filter(|c| c.normal_n > 0.0 && c.x_mm > 0.0) {
        println!("  nip x {:.1} leaf {} N {:.1}", c.x_mm, c.upper_leaf, c.normal_n);
    }
    run("rail", &Structure::default(), 0.3, 0.3491);
    let s = Structure { mounting: Mounting::Shackle, ..Structure::default() };
    for deg in [20.0f64, 26.0, -20.0] { run("shackle", &s, 0.3, deg.to_radians()); }
}

fn run(name: &str, s: &Structure, mu: f64, angle: f64) {
    let mut p = LeafPack::new(s, &Values { shackle_angle_rad: angle, ..values(mu) }).unwrap();
    let path = graded_path(&[0.0, 26.0, 0.0], 1.0);
    let t = Instant::now();
    let out = p.static_path(&path, 120.0);
    let el = t.elapsed();
    let e: f64 = out.windows(2).map(|w| 0.5*(w[0].force_n+w[1].force_n)*(w[1].displacement_mm-w[0].displacement_mm)).sum();
    let fmax = out.iter().map(|p| p.force_n).fold(0.0, f64::max);
    println!("{name} {:.0} deg static {} steps {el:?} Fmax {fmax:.1} E {:.4} effort {:?} unconv {} energy {:?}", angle.to_degrees(), path.len(), e*1e-3, p.effort(), p.unconverged(), p.energy());
    p.reset();
    let (mut fmax, mut e, mut last) = (0.0f64, 0.0, (0.0, 0.0));
    let t = Instant::now();
    let mut worst = 0.0f64;
    for k in 0..3000 {
        let d = 5.0 - 3.0 * (k as f64 * 1e-3 * std::f64::consts::TAU).cos();
        let t1 = Instant::now();
        let f = p.step(d, 1e-3);
        worst = worst.max(t1.elapsed().as_secs_f64());
        if k == 2000 { e = 0.0; }
        if k > 1000 { fmax = fmax.max(f); }
        e += 0.5*(f+last.1)*(d-last.0);
        last = (d, f);
    }
    println!("{name} sine Fmax {fmax:.1} E {:.4} {:.2} us/step worst {:.0} us effort {:?} unconv {}", e*1e-3, t.elapsed().as_secs_f64()/3000.0*1e6, worst*1e6, p.effort(), p.unconverged());
}
