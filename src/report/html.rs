//! One page that holds everything itself: text, plots, style; readable without a network, printed or in the dark.

use std::fmt::Write;

use super::svg::Ink;

/// A page of loops.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LoopPage<'a> {
    /// Heading.
    pub title: &'a str,
    /// What this is, in a sentence or two.
    pub lead: &'a str,
    /// One a run.
    pub sections: Vec<Section>,
}

/// One run.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Section {
    /// Heading.
    pub title: String,
    /// A sentence.
    pub text: String,
    /// The plot, as `svg` draws it: taken in as it is.
    pub svg: String,
    /// Name and value.
    pub facts: Vec<(String, String)>,
    /// Files beside the page.
    pub files: Vec<String>,
}

const STYLE: &str = "
:root { color-scheme: light dark; }
body { font: 17px/1.5 system-ui, sans-serif; max-width: 1180px; margin: 0 auto; padding: 24px; background: #fff; color: #16191c; }
h1 { font-size: 28px; margin: 0 0 4px; }
h2 { font-size: 21px; margin: 32px 0 2px; }
p { margin: 0 0 10px; }
.run { display: grid; grid-template-columns: minmax(0, 2.4fr) minmax(240px, 1fr); gap: 24px; align-items: start; }
svg { width: 100%; height: auto; }
dl { display: grid; grid-template-columns: auto auto; gap: 6px 18px; margin: 12px 0; }
dt { opacity: .72; }
dd { margin: 0; text-align: right; font-variant-numeric: tabular-nums; font-weight: 600; }
.legend i { display: inline-block; width: 26px; height: 4px; border-radius: 2px; margin: 0 6px 4px 0; }
.legend span { margin-right: 22px; }
@media (prefers-color-scheme: dark) { body { background: #14171a; color: #eef1f2; } a { color: #8cc4ff; } }
@media (max-width: 760px) { .run { grid-template-columns: minmax(0, 1fr); } }
";

impl LoopPage<'_> {
    /// The page's text.
    pub(crate) fn render(&self) -> String {
        let mut page = String::new();
        // Writing into a string cannot fail.
        let _ = self.write(&mut page);
        page
    }

    fn write(&self, page: &mut String) -> std::fmt::Result {
        let title = escape(self.title);
        write!(
            page,
            "<!doctype html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>{STYLE}{}</style></head>\n<body>\n<h1>{title}</h1>\n<p>{}</p>\n\
             <p class=\"legend\"><span><i class=\"measured\"></i>measured</span><span><i class=\"twin\"></i>twin</span></p>\n",
            legend_style(),
            escape(self.lead)
        )?;
        for section in &self.sections {
            section.write(page)?;
        }
        writeln!(page, "</body>\n</html>")
    }
}

fn legend_style() -> String {
    format!(
        ".legend .measured {{ background: {}; }} .legend .twin {{ background: {}; }}",
        Ink::Measured.css(),
        Ink::Twin.css()
    )
}

impl Section {
    fn write(&self, page: &mut String) -> std::fmt::Result {
        writeln!(
            page,
            "<h2>{}</h2>\n<p>{}</p>\n<div class=\"run\">",
            escape(&self.title),
            escape(&self.text)
        )?;
        writeln!(page, "<div>{}</div>\n<div><dl>", self.svg)?;
        for (name, value) in &self.facts {
            writeln!(page, "<dt>{}</dt><dd>{}</dd>", escape(name), escape(value))?;
        }
        writeln!(page, "</dl><p>")?;
        for file in &self.files {
            let file = escape(file);
            writeln!(page, "<a href=\"{file}\">{file}</a><br>")?;
        }
        writeln!(page, "</p></div></div>")
    }
}

/// Text as HTML has it.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_escapes_text_keeps_plots_and_asks_nobody_for_anything() {
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
        }
        .render();
        assert!(page.contains("a &lt;b&gt;") && page.contains("x &amp; y") && page.contains("<svg></svg>"));
        assert!(page.contains("&quot;1&quot; N") && page.contains("href=\"a.csv\""));
        assert!(!page.contains("http") && !page.contains("<script"));
    }
}
