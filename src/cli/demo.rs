//! `leafbench demo`.
//!
//! - `played` a run on the mock rig with its twin · `loops` ramp and sine: table, files and sections of the page
//! - `concealed` what is concealed afterwards, and whether the answer is right · `story` how it is found · `fresh` how the twin
//!   follows a new motion then

mod concealed;
mod fresh;
mod loops;
mod played;
mod story;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;

use self::loops::DemoRow;
use self::story::Story;
use super::shared::local;
use super::{CliCommand, CliError, Done, Output};
use crate::config::Bench;
use crate::report::loops::{LoopPage, Section};

/// Static ramp and 6 mm sine on the mock rig in virtual time, then an effect that is concealed in it and diagnosed
#[derive(Debug, Args)]
pub(super) struct DemoArgs {
    /// Folder to write to; earlier results of the demo there are replaced
    #[arg(long, value_name = "DIR", default_value = "leafbench-demo")]
    out: PathBuf,
}

#[derive(serde::Serialize)]
struct Demo {
    folder: PathBuf,
    page: PathBuf,
    rows: Vec<DemoRow>,
    /// Bench time and real time of the rows.
    virtual_s: f64,
    real_s: f64,
    story: Story,
    /// Real time of all, the story included.
    total_s: f64,
}

impl CliCommand for DemoArgs {
    const NAME: &'static str = "demo";
    const EXAMPLES: &'static [&'static str] = &["leafbench demo", "leafbench demo --out loops --json"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let begun = Instant::now();
        let folder = self.out;
        std::fs::create_dir_all(&folder).map_err(CliError::file(&folder, "creating the folder"))?;
        let configs = local::configs()?;
        let bench = Bench::load(&configs.join("benches/mock.toml"))?;
        let loops = loops::record(&bench, &configs, &folder, output)?;
        let real_s = begun.elapsed().as_secs_f64();
        let story = story::tell(&bench, &configs, &folder, output)?;
        let demo = Demo {
            page: write_page(&folder, &bench, loops.sections, &story)?,
            folder,
            rows: loops.rows,
            virtual_s: loops.virtual_s,
            real_s,
            story,
            total_s: begun.elapsed().as_secs_f64(),
        };
        output.result(&demo, || text(&demo))?;
        Ok(Done::success_if(demo.rows.iter().all(DemoRow::is_complete)))
    }
}

/// Writes the page with the loops and the story; its path.
fn write_page(
    folder: &Path,
    bench: &Bench,
    sections: Vec<Section>,
    story: &Story,
) -> Result<PathBuf, CliError> {
    let page = folder.join("index.html");
    let html = LoopPage {
        title: "leafbench demo: measured loops and twin",
        lead: &lead(bench),
        sections,
        story: &story.part,
    }
    .render();
    std::fs::write(&page, html).map_err(CliError::file(&page, "writing"))?;
    Ok(page)
}

fn lead(bench: &Bench) -> String {
    format!(
        "Measured on the mock rig in virtual time, specimen {}, twin: model {}. No real rig was involved.",
        bench.specimen.name, bench.model.name
    )
}

fn text(demo: &Demo) -> String {
    let mut lines = loops::table(&demo.rows);
    lines.push(String::new());
    lines.push(format!(
        "{:.0} s of bench time in {:.1} s; CSV, data packages and run files in {}, loops in {}",
        demo.virtual_s,
        demo.real_s,
        demo.folder.display(),
        demo.page.display()
    ));
    lines.push(String::new());
    lines.extend(demo.story.lines());
    lines.push(String::new());
    lines.push(format!(
        "the whole demo took {:.1} s; pictures of each step in {}",
        demo.total_s,
        demo.page.display()
    ));
    lines.join("\n")
}
