//! What all pages of the reports share: the HTML document around a page and the legend of a plot.
//!
//! A page holds its plots and its style itself, so that it can be read without a network, and printed.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::svg::Ink;

/// The whole document: `body` under the heading data that a browser needs.
pub(super) fn document(title: &str, style: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(style)) }
            }
            body { (body) }
        }
    }
    .into_string()
}

/// The paragraph below or above a plot that names its colours. `remark` follows the entries in weak print; empty for none.
pub(super) fn legend(entries: &[(&str, Ink)], remark: &str) -> Markup {
    html! {
        p.legend {
            @for (name, ink) in entries {
                span { i style={ "background:" (ink.css()) } {} (name) }
            }
            @if !remark.is_empty() {
                " " span.quiet { (remark) }
            }
        }
    }
}
