//! Known parameters come back: from the third paper's curves, and from synthetic recordings within their own intervals.

use leafbench::identify::papers::{second, third};

/// Figure of issue and paper: within 1 %, in fewer than 400 evaluations, f and r_f judged as a product.
#[test]
fn third_paper_identified_back_from_its_start() {
    for row in third::rerun(2).expect("the published values are within bounds") {
        println!(
            "{} by {}: {} evaluations, {:.4} -> {:.2e} mm a point",
            row.spring, row.method, row.evaluations, row.misfit_start_mm, row.misfit_mm
        );
        for f in &row.figures {
            println!(
                "  {:16} {:12.5e} -> {:12.5e}, published {:12.5e}: {:+.4} %",
                f.name,
                f.start,
                f.identified,
                f.published,
                100.0 * f.error
            );
        }
        for warning in &row.fit.warnings {
            println!("  {warning}");
        }
        if row.method == "least squares" {
            assert!(
                row.worst < 0.01,
                "{} misses by {:.3} %",
                row.spring,
                100.0 * row.worst
            );
            assert!(row.evaluations < 400, "{} took {}", row.spring, row.evaluations);
        }
        let product = row
            .fit
            .warnings
            .iter()
            .any(|w| w.to_string().contains("only the product f * r_f_mm"));
        assert!(product, "the product must be named: {:?}", row.fit.warnings);
    }
}

/// Figure: RMS force error at most a third of that of the thesis' own envelope lines.
#[test]
fn second_paper_table_5_1() {
    let rerun = second::rerun(2).expect("the printed values are within bounds");
    for row in &rerun.rows {
        println!(
            "{:30} RMS {:6.1} N, {:.3} of the envelope's",
            row.model, row.rms_n, row.share_of_envelope
        );
    }
    for ((p, value), ci) in rerun
        .fit
        .parameters
        .iter()
        .zip(&rerun.fit.values)
        .zip(&rerun.fit.ci95)
    {
        println!("  {:22} {value:10.3} {} {ci:?}", p.name, p.unit);
    }
    for warning in &rerun.fit.warnings {
        println!("  {warning}");
    }
    assert!(rerun.rows[3].share_of_envelope < 1.0 / 3.0);
}
