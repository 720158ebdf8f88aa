//! Serves the technician's page: HTML, scripts and style are part of this binary, and nothing is loaded from elsewhere.

use std::sync::Arc;

use axum::http::header;
use axum::routing::{MethodRouter, get};

use super::access::role::Needs;
use super::state::DaemonState;

/// Files that the page without a session needs.
const OPEN: [&str; 3] = ["/login.js", "/login.css", "/icon.svg"];

/// Path, need and handler of each of the page's files.
pub(super) fn routes() -> impl Iterator<Item = (&'static str, Needs, MethodRouter<Arc<DaemonState>>)> {
    FILES.iter().map(|&(path, kind, text)| {
        let needs = if OPEN.contains(&path) {
            Needs::NOTHING
        } else {
            Needs::WATCH
        };
        let handler = get(move || async move { ([(header::CONTENT_TYPE, kind)], text) });
        (path, needs, handler)
    })
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Path, type and text of each file.
const FILES: [(&str, &str, &str); 25] = [
    ("/", "text/html; charset=utf-8", include_str!("page/index.html")),
    (
        "/page.css",
        "text/css; charset=utf-8",
        include_str!("page/page.css"),
    ),
    (
        "/history.css",
        "text/css; charset=utf-8",
        include_str!("page/history.css"),
    ),
    (
        "/editor.css",
        "text/css; charset=utf-8",
        include_str!("page/editor.css"),
    ),
    (
        "/login.css",
        "text/css; charset=utf-8",
        include_str!("page/login.css"),
    ),
    ("/login.js", SCRIPT, include_str!("page/login.js")),
    ("/ask.js", SCRIPT, include_str!("page/ask.js")),
    ("/commander.js", SCRIPT, include_str!("page/commander.js")),
    ("/words.js", SCRIPT, include_str!("page/words.js")),
    ("/plot.js", SCRIPT, include_str!("page/plot.js")),
    ("/scope.js", SCRIPT, include_str!("page/scope.js")),
    ("/jog.js", SCRIPT, include_str!("page/jog.js")),
    (
        "/result.css",
        "text/css; charset=utf-8",
        include_str!("page/result.css"),
    ),
    ("/band.js", SCRIPT, include_str!("page/band.js")),
    ("/result.js", SCRIPT, include_str!("page/result.js")),
    ("/editor_text.js", SCRIPT, include_str!("page/editor_text.js")),
    ("/editor_form.js", SCRIPT, include_str!("page/editor_form.js")),
    ("/editor.js", SCRIPT, include_str!("page/editor.js")),
    ("/import.js", SCRIPT, include_str!("page/import.js")),
    ("/page.js", SCRIPT, include_str!("page/page.js")),
    ("/history.js", SCRIPT, include_str!("page/history.js")),
    ("/compare.js", SCRIPT, include_str!("page/compare.js")),
    ("/diagnose.js", SCRIPT, include_str!("page/diagnose.js")),
    ("/start.js", SCRIPT, include_str!("page/start.js")),
    ("/icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::message::Cause;

    fn text_of(wanted: &str) -> &'static str {
        FILES
            .iter()
            .find_map(|(path, _, text)| (*path == wanted).then_some(*text))
            .expect("a file of the page")
    }

    #[test]
    fn the_page_loads_nothing_from_elsewhere() {
        for (path, _, text) in FILES {
            let foreign = text.replace("http://www.w3.org/", "");
            assert!(
                !foreign.contains("http://") && !foreign.contains("https://") && !foreign.contains("url("),
                "{path}"
            );
        }
        for (path, kind, _) in FILES {
            let name = path.trim_start_matches('/');
            assert!(
                kind != SCRIPT || name == "login.js" || text_of("/").contains(&format!("src=\"{name}\"")),
                "{name} is not loaded"
            );
        }
    }

    #[test]
    fn nothing_disables_the_stop_button() {
        assert!(!text_of("/").contains("id=\"stop\" class=\"stop\" disabled"));
        for (path, _, text) in FILES {
            let disabled = ["$(\"stop\").disabled", "allow(\"stop\""];
            assert!(disabled.iter().all(|way| !text.contains(way)), "{path}");
        }
        assert!(text_of("/page.js").contains("$(\"stop\").addEventListener(\"click\""));
    }

    #[test]
    fn the_page_says_what_happened_and_what_to_do_for_every_cause() {
        let words = text_of("/words.js");
        for code in 1..=19 {
            let cause = Cause::from_wire(code).expect("a cause of the protocol");
            let name = serde_json::to_value(cause).expect("written");
            let name = name.as_str().expect("a word");
            assert!(words.contains(&format!("\n  {name}: [\"")), "{name}");
        }
    }

    /// Relative luminance of `#rrggbb` (WCAG 2.2).
    fn luminance(colour: &str) -> f64 {
        let part = |at: usize| {
            let value = u8::from_str_radix(&colour[at..at + 2], 16).expect("two digits");
            let c = f64::from(value) / 255.0;
            if c <= 0.040_45 {
                c / 12.92
            } else {
                ((c + 0.055) / 1.055).powf(2.4)
            }
        };
        0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5)
    }

    fn contrast(a: &str, b: &str) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    /// Colours by name, of the light page and of the dark one.
    fn colours(theme: &str) -> std::collections::BTreeMap<&str, &str> {
        theme
            .split(';')
            .filter_map(|entry| entry.rsplit_once("--"))
            .filter_map(|(_, entry)| entry.split_once(": "))
            .map(|(name, value)| (name.trim(), value.trim()))
            .filter(|(_, value)| value.starts_with('#'))
            .collect()
    }

    #[test]
    fn the_colours_keep_the_contrast_of_wcag_aa_in_light_and_dark() {
        let style = text_of("/page.css");
        let dark = style
            .find("@media (prefers-color-scheme: dark)")
            .expect("a dark page");
        let end = style.find("* { box-sizing").expect("the end of the colours");
        for theme in [&style[..dark], &style[dark..end]] {
            let of = colours(theme);
            let check = |front: &str, back: &str, least: f64| {
                let seen = contrast(of[front], of[back]);
                assert!(seen >= least, "{front} on {back}: {seen:.2} is less than {least}");
            };
            // Text: 4.5 to 1.
            for back in ["ground", "card"] {
                check("ink", back, 4.5);
                check("quiet", back, 4.5);
            }
            // Lines of a plot and borders of what can be pressed: 3 to 1.
            for line in ["measured", "twin", "command", "older", "limit"] {
                check(line, "card", 3.0);
            }
            check("edge", "ground", 3.0);
            check("edge", "card", 3.0);
            // Text of the head: it is white in both.
            for back in ["ok", "busy", "wait", "bad", "off"] {
                let seen = contrast("#ffffff", of[back]);
                assert!(seen >= 4.5, "white on {back}: {seen:.2}");
            }
        }
    }

    /// All scripts share one scope: a name that two of them declare stops the second one.
    #[test]
    fn no_two_scripts_declare_one_name() {
        let mut names: Vec<&str> = Vec::new();
        for (_, kind, text) in FILES {
            for line in text.lines().filter(|_| kind == SCRIPT) {
                let declared = ["const ", "let ", "function ", "async function "]
                    .iter()
                    .find_map(|word| line.strip_prefix(word));
                let end = |c: char| !(c.is_alphanumeric() || c == '_' || c == '$');
                names.extend(declared.and_then(|rest| rest.split(end).next()));
            }
        }
        let count = names.len();
        assert!(count > 50, "{count} names found");
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count, "rename one of two");
    }
}
