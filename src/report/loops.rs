//! A page of force-displacement loops, measured and twin: one section for each run, and a story after them.

use maud::{Markup, PreEscaped, html};

use super::html::{document, legend};
use super::story::StoryPart;
use super::svg::Ink;

/// A page of loops.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoopPage<'a> {
    pub title: &'a str,
    /// The paragraph under the title: where the loops come from.
    pub lead: &'a str,
    /// One section for each run.
    pub sections: Vec<Section>,
    /// What comes after the sections.
    pub story: &'a StoryPart,
}

/// One run of a [`LoopPage`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Section {
    pub title: String,
    /// The paragraph under the title: what was run.
    pub text: String,
    /// The plot as `<svg>` text. It goes into the page without escaping.
    pub svg: String,
    /// Name of a figure, and its value with unit.
    pub facts: Vec<(String, String)>,
    /// Names of the files in the page's folder that the section links to.
    pub files: Vec<String>,
}

impl LoopPage<'_> {
    /// The page as HTML text.
    pub(crate) fn render(&self) -> String {
        let body = html! {
            h1 { (self.title) }
            p { (self.lead) }
            (legend(&[("measured", Ink::Measured), ("twin", Ink::Twin)], ""))
            @for section in &self.sections { (section.render()) }
            (self.story.render())
        };
        document(self.title, include_str!("loops.css"), &body)
    }
}

impl Section {
    fn render(&self) -> Markup {
        html! {
            h2 { (self.title) }
            p { (self.text) }
            div.run {
                div { (PreEscaped(&self.svg)) }
                div {
                    dl {
                        @for (name, value) in &self.facts {
                            dt { (name) } dd { (value) }
                        }
                    }
                    p {
                        @for file in &self.files {
                            a href=(file) { (file) } br;
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_escapes_text_keeps_plots_and_loads_nothing_from_elsewhere() {
        let section = Section {
            title: "a <b>".to_owned(),
            text: "x & y".to_owned(),
            svg: "<svg></svg>".to_owned(),
            facts: vec![("Peak".to_owned(), "\"1\" N".to_owned())],
            files: vec!["a.csv".to_owned()],
        };
        let page = LoopPage {
            title: "T",
            lead: "lead",
            sections: vec![section],
            story: &StoryPart {
                title: "after <that>".to_owned(),
                lead: String::new(),
                steps: Vec::new(),
            },
        }
        .render();
        assert!(page.contains("a &lt;b&gt;") && page.contains("x &amp; y") && page.contains("<svg></svg>"));
        assert!(page.contains("&quot;1&quot; N") && page.contains("href=\"a.csv\""));
        assert!(page.contains("after &lt;that&gt;"));
        assert!(!page.contains("http") && !page.contains("<script"));
    }
}
