//! The page `papers.md` of `leafbench papers --out FOLDER`, and its pictures in `FOLDER/papers/`.

use std::path::Path;

use super::{Papers, text};
use crate::cli::CliError;
use crate::identify::leaf_pack_rows::{AmplitudeReading, RowFit, mount_name};
use crate::identify::loop_points::LoadDeflectionRow;
use crate::model::leaf_pack::Mounting;
use crate::papers::second;
use crate::report::svg::{PlotCurve, titled_plot};

/// Folder of the pictures, beside the page.
const PICTURES: &str = "papers";

/// One picture of the page.
struct Picture {
    /// Name of the file.
    file: String,
    title: String,
    svg: String,
}

/// Writes the page and its pictures into `folder`.
pub(super) fn write(papers: &Papers, folder: &Path) -> Result<(), CliError> {
    let pictures_folder = folder.join(PICTURES);
    std::fs::create_dir_all(&pictures_folder)
        .map_err(CliError::file(&pictures_folder, "making the folder"))?;
    let pictures = pictures(papers);
    for picture in &pictures {
        let path = pictures_folder.join(&picture.file);
        std::fs::write(&path, &picture.svg).map_err(CliError::file(&path, "writing"))?;
    }
    let path = folder.join("papers.md");
    std::fs::write(&path, page(papers, &pictures)).map_err(CliError::file(&path, "writing"))
}

fn page(papers: &Papers, pictures: &[Picture]) -> String {
    let mut page = String::from(
        "# What the papers report, run again\n\nMade by `leafbench papers --out docs`. Measured figures are the papers'; \
         everything under \"ours\" comes from the models of this program.\n\n",
    );
    page += &text::tables(papers);
    page += "## Pictures\n\n";
    for Picture { file, title, .. } in pictures {
        page += &format!("![{title}]({PICTURES}/{file})\n\n{title}\n\n");
    }
    page.truncate(page.trim_end().len());
    page.push('\n');
    page
}

fn pictures(papers: &Papers) -> Vec<Picture> {
    let mut pictures = Vec::new();
    for reading in &papers.first.readings {
        for fit in &reading.fits {
            for (&mounting, points) in fit.case.mounts.iter().zip(&fit.curves) {
                pictures.push(leaf_pack(reading.reading, fit, mounting, points));
            }
        }
    }
    pictures.extend(papers.second.rows().into_iter().map(five_link));
    pictures
}

/// One pass of a mounting through all its tests.
fn leaf_pack(reading: AmplitudeReading, fit: &RowFit, mounting: Mounting, points: &[(f64, f64)]) -> Picture {
    let mount = mount_name(mounting);
    let title = format!(
        "Leaf pack, {mount}: all tests in one pass ({}; fit of {})",
        reading.name(),
        fit.case.name()
    );
    let model = PlotCurve::twin("leaf pack fitted", points.to_vec());
    Picture {
        file: format!("{}.svg", leaf_pack_file(reading, fit, mount)),
        svg: titled_plot(&title, "displacement in mm", "force in N", &[model]),
        title,
    }
}

/// For example `leaf-pack-half-both-no-shackle-thickness-free`.
fn leaf_pack_file(reading: AmplitudeReading, fit: &RowFit, mount: &str) -> String {
    let reading = match reading {
        AmplitudeReading::Whole => "whole",
        AmplitudeReading::Half => "half",
    };
    let both = if fit.case.mounts.len() > 1 { "both " } else { "" };
    let freed = fit
        .case
        .freed
        .map_or(String::new(), |freed| format!(" {} free", freed.words));
    format!("leaf pack {reading} {both}{mount}{freed}").replace(' ', "-")
}

/// Table 5-1 and one model.
fn five_link(row: &LoadDeflectionRow) -> Picture {
    let title = format!("Table 5-1 of the Chula thesis: {}", row.model);
    let measured = PlotCurve::measured("measured, Table 5-1", second::TABLE_5_1.to_vec());
    let points = second::TABLE_5_1.iter().zip(&row.force_n).map(|(p, f)| (p.0, *f));
    let model = PlotCurve::twin(row.model, points.collect());
    Picture {
        file: format!("table-5-1-{}.svg", row.model.replace(' ', "-")),
        svg: titled_plot(&title, "deflection in mm", "force in N", &[measured, model]),
        title,
    }
}
