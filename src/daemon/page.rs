//! Serves the technician's page: HTML, scripts and style are part of this binary, and nothing is loaded from elsewhere.

use std::sync::Arc;

use axum::Router;
use axum::http::header;
use axum::routing::get;

use super::state::DaemonState;

/// The routes of the page's files.
pub(super) fn router() -> Router<Arc<DaemonState>> {
    let file = |kind: &'static str, text: &'static str| {
        get(move || async move { ([(header::CONTENT_TYPE, kind)], text) })
    };
    Router::new()
        .route(
            "/",
            file("text/html; charset=utf-8", include_str!("page/index.html")),
        )
        .route(
            "/page.css",
            file("text/css; charset=utf-8", include_str!("page/page.css")),
        )
        .route(
            "/plot.js",
            file("text/javascript; charset=utf-8", include_str!("page/plot.js")),
        )
        .route(
            "/page.js",
            file("text/javascript; charset=utf-8", include_str!("page/page.js")),
        )
        .route("/icon.svg", file("image/svg+xml", include_str!("page/icon.svg")))
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_page_loads_nothing_from_elsewhere() {
        let files = [
            include_str!("page/index.html"),
            include_str!("page/page.css"),
            include_str!("page/page.js"),
            include_str!("page/plot.js"),
        ];
        for text in files {
            let foreign = text.replace("http://www.w3.org/", "");
            assert!(
                !foreign.contains("http://") && !foreign.contains("https://") && !foreign.contains("url(")
            );
        }
    }

    #[test]
    fn the_stop_button_is_enabled_in_every_phase() {
        let script = include_str!("page/page.js");
        assert!(script.contains("$(\"stop\").disabled = !status;"));
        assert_eq!(
            script.matches("\"stop\"").count(),
            2,
            "set in one place, pressed in one"
        );
        assert!(script.contains("press(\"stop\", () => ask(\"api/stop\""));
    }
}
