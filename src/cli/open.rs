//! `leafbench open`: prints a link that signs a browser in.

use clap::Args;

use super::shared::client::DataArg;
use super::{CliCommand, CliError, Done, Output};
use crate::daemon::client_types::{Nothing, SignInLink};

/// Print a link that opens the technician's page and signs the browser in; it works once
#[derive(Debug, Args)]
pub(super) struct OpenArgs {
    #[command(flatten)]
    data: DataArg,
}

impl CliCommand for OpenArgs {
    const NAME: &'static str = "open";
    const EXAMPLES: &'static [&'static str] = &["leafbench open", "leafbench open --data leafbench-data"];

    fn run(self, output: &Output) -> Result<Done, CliError> {
        let client = self.data.client()?;
        let link: SignInLink = client.post("/api/link", &Nothing {})?;
        output.result(&link, || {
            format!(
                "{}\nOpen this link in a browser within {} minutes. It works once; after that, {} is enough in this browser.",
                link.url,
                link.works_s / 60,
                client.page()
            )
        })?;
        Ok(Done::Success)
    }
}
