//! The technician's page: one HTML file with its script and style, all from this binary, nothing from the network.

use std::sync::Arc;

use axum::Router;
use axum::http::header;
use axum::routing::get;

use super::Shared;

/// The page's three files.
pub(super) fn router() -> Router<Arc<Shared>> {
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
    fn the_page_asks_nobody_else_for_anything() {
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
}
