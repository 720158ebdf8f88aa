//! All routes of the HTTP interface with the role that each one needs, the router that is built from them alone, and what OpenAPI
//! says of them.

use std::sync::Arc;

use axum::extract::DefaultBodyLimit;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodFilter, MethodRouter, any, on};
use axum::{Json, Router};
use utoipa::OpenApi;

use super::access::role::Needs;
use super::client_types::Caller;
use super::error::ApiError;
use super::gate::{self, Gate};
use super::guard::{self, RequestGuard};
use super::server::STOP_PATH;
use super::state::DaemonState;
use super::{
    api, compare, description, diagnosis_api, editor, imports, page, result, run_list, sign_in, socket,
};

/// Largest body of a request in bytes: more than any profile file.
const BODY_LIMIT: usize = 1 << 20;

/// One route of the interface. A test compares the list of routes with the OpenAPI description.
struct Route {
    method: MethodFilter,
    path: &'static str,
    /// Who may use it.
    needs: Needs,
    /// Makes the handler for `method`.
    handler: fn(MethodFilter) -> MethodRouter<Arc<DaemonState>>,
}

type MakeHandler = fn(MethodFilter) -> MethodRouter<Arc<DaemonState>>;

impl Route {
    fn get(path: &'static str, needs: Needs, handler: MakeHandler) -> Route {
        Route::new(MethodFilter::GET, path, needs, handler)
    }

    fn post(path: &'static str, needs: Needs, handler: MakeHandler) -> Route {
        Route::new(MethodFilter::POST, path, needs, handler)
    }

    fn delete(path: &'static str, needs: Needs, handler: MakeHandler) -> Route {
        Route::new(MethodFilter::DELETE, path, needs, handler)
    }

    fn new(method: MethodFilter, path: &'static str, needs: Needs, handler: MakeHandler) -> Route {
        Route {
            method,
            path,
            needs,
            handler,
        }
    }

    /// The method in capitals.
    fn method_name(&self) -> &'static str {
        match self.method {
            MethodFilter::GET => "GET",
            MethodFilter::DELETE => "DELETE",
            _ => "POST",
        }
    }
}

/// All routes with what they need. There is no other way into the router: see [`router`].
fn routes() -> Vec<Route> {
    [orders(), views(), diagnoses_and_imports(), doors()]
        .into_iter()
        .flatten()
        .collect()
}

/// Orders to the bench. A stop is taken from everybody who belongs here, whatever their role.
fn orders() -> Vec<Route> {
    let post = |path, handler: MakeHandler| Route::post(path, Needs::OPERATE, handler);
    vec![
        Route::post(STOP_PATH, Needs::WATCH, |m| on(m, api::stop)),
        post("/api/command", |m| on(m, api::command)),
        post("/api/run", |m| on(m, api::run)),
        post("/api/hold", |m| on(m, api::hold)),
        post("/api/resume", |m| on(m, api::resume)),
        post("/api/reset", |m| on(m, api::reset)),
        post("/api/tare", |m| on(m, api::tare)),
        post("/api/zero", |m| on(m, api::zero)),
        post("/api/jog", |m| on(m, api::jog)),
        post("/api/profiles", |m| on(m, editor::save)),
        Route::delete("/api/profiles/{name}", Needs::OPERATE, |m| on(m, editor::delete)),
    ]
}

/// What changes nothing.
fn views() -> Vec<Route> {
    let get = |path, handler: MakeHandler| Route::get(path, Needs::WATCH, handler);
    let post = |path, handler: MakeHandler| Route::post(path, Needs::WATCH, handler);
    vec![
        get("/api/status", |m| on(m, api::status)),
        get("/api/reading", |m| on(m, api::reading)),
        get("/api/runs", |m| on(m, run_list::runs)),
        get("/api/runs/{run_id}", |m| on(m, api::run_detail)),
        get("/api/runs/{run_id}/result", |m| on(m, result::run_result)),
        get("/api/runs/{run_id}/certificate", |m| {
            on(m, result::run_certificate)
        }),
        get("/api/runs/{run_id}/csv", |m| on(m, api::run_csv)),
        get("/api/runs/{run_id}/mf4", |m| on(m, api::run_mf4)),
        get("/api/runs/{run_id}/parquet", |m| on(m, api::run_parquet)),
        get("/api/profiles", |m| on(m, api::profiles)),
        get("/api/profiles/{name}", |m| on(m, editor::text)),
        post("/api/outline", |m| on(m, editor::outline)),
        post("/api/plan", |m| on(m, api::plan_profile)),
        get("/api/compare", |m| on(m, compare::compare)),
        get("/api/openapi.json", |m| on(m, openapi)),
        get("/api/live", |m| on(m, socket::live)),
        get("/metrics", |m| on(m, api::metrics_text)),
    ]
}

fn diagnoses_and_imports() -> Vec<Route> {
    let get = |path, handler: MakeHandler| Route::get(path, Needs::WATCH, handler);
    let post = |path, handler: MakeHandler| Route::post(path, Needs::OPERATE, handler);
    vec![
        get("/api/diagnoses", |m| on(m, diagnosis_api::list)),
        post("/api/diagnoses", |m| on(m, diagnosis_api::ask)),
        get("/api/diagnoses/{id}", |m| on(m, diagnosis_api::one)),
        Route::delete("/api/diagnoses/{id}", Needs::OPERATE, |m| {
            on(m, diagnosis_api::end)
        }),
        get("/api/diagnoses/{id}/{file}", |m| on(m, diagnosis_api::file)),
        post("/api/twin", |m| on(m, diagnosis_api::choose_twin)),
        get("/api/imports", |m| on(m, imports::list)),
        post("/api/imports", |m| large(on(m, imports::take))),
        Route::post("/api/imports/preview", Needs::WATCH, |m| {
            large(on(m, imports::preview))
        }),
        get("/api/imports/{name}", |m| on(m, imports::csv)),
    ]
}

/// How people get in, and what they did.
fn doors() -> Vec<Route> {
    vec![
        Route::post("/api/login", Needs::NOTHING, |m| on(m, sign_in::login)),
        Route::post("/api/link", Needs::OWN_KEY, |m| on(m, sign_in::link)),
        Route::get("/api/audit", Needs::ADMINISTER, |m| on(m, sign_in::audit_log)),
    ]
}

/// Method and path of every route, and of every file of the page, with what it needs.
#[cfg(test)]
pub(crate) fn every_route() -> Vec<(&'static str, &'static str, Needs)> {
    let api = routes().into_iter().map(|r| (r.method_name(), r.path, r.needs));
    let page = page::routes().map(|(path, needs, _)| ("GET", path, needs));
    let login = ("GET", sign_in::LOGIN_PATH, Needs::NOTHING);
    api.chain(page).chain([login]).collect()
}

/// A route that takes a table of another program.
fn large(route: MethodRouter<Arc<DaemonState>>) -> MethodRouter<Arc<DaemonState>> {
    route.layer(DefaultBodyLimit::max(imports::TABLE_LIMIT))
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "leafbench",
        description = "Controls a leaf-spring test bench. A failed request is answered with `{error, what_to_do}`."
    ),
    paths(
        api::status,
        api::command,
        api::run,
        api::stop,
        api::hold,
        api::resume,
        api::reset,
        api::tare,
        api::zero,
        api::jog,
        api::reading,
        run_list::runs,
        api::run_detail,
        result::run_result,
        result::run_certificate,
        api::run_csv,
        api::run_mf4,
        api::run_parquet,
        api::profiles,
        editor::save,
        editor::text,
        editor::delete,
        editor::outline,
        api::plan_profile,
        compare::compare,
        diagnosis_api::list,
        diagnosis_api::ask,
        diagnosis_api::one,
        diagnosis_api::end,
        diagnosis_api::file,
        diagnosis_api::choose_twin,
        imports::list,
        imports::take,
        imports::preview,
        imports::csv,
        openapi,
        socket::live,
        api::metrics_text,
        sign_in::login,
        sign_in::link,
        sign_in::audit_log
    ),
    components(schemas(Caller, socket::LiveMessage))
)]
struct Description;

/// The routes of the interface and of the page, each behind its gate, and all behind the guard. An address that is nowhere says
/// so only to somebody who belongs here.
pub(super) fn router(guard: RequestGuard, state: &Arc<DaemonState>) -> Router {
    let behind = |needs: Needs, route: MethodRouter<Arc<DaemonState>>| {
        let gate = Gate {
            state: Arc::clone(state),
            needs,
        };
        route.layer(axum::middleware::from_fn_with_state(gate, gate::check))
    };
    let api = routes()
        .into_iter()
        .map(|r| (r.path, r.needs, (r.handler)(r.method)));
    let login = (
        sign_in::LOGIN_PATH,
        Needs::NOTHING,
        on(MethodFilter::GET, sign_in::login_page),
    );
    let all = api.chain(page::routes()).chain([login]);
    let router = all.fold(Router::new(), |router, (path, needs, route)| {
        router.route(path, behind(needs, route))
    });
    router
        .fallback_service(behind(Needs::WATCH, any(nowhere)).with_state(Arc::clone(state)))
        .layer(DefaultBodyLimit::max(BODY_LIMIT))
        .layer(axum::middleware::from_fn_with_state(guard, guard::check))
        .with_state(Arc::clone(state))
}

async fn nowhere() -> ApiError {
    ApiError::new(
        StatusCode::NOT_FOUND,
        "there is nothing at this address".to_owned(),
        "GET /api/openapi.json lists all addresses".to_owned(),
    )
}

/// This description of the interface.
#[utoipa::path(get, path = "/api/openapi.json", responses((status = 200, body = Object)))]
async fn openapi() -> Result<Response, ApiError> {
    let document = described().map_err(|e| ApiError::internal(&e.to_string()))?;
    Ok(Json(document).into_response())
}

/// The description of the whole interface.
pub(crate) fn described() -> serde_json::Result<serde_json::Value> {
    let mut document = serde_json::to_value(Description::openapi())?;
    let routes: Vec<_> = routes()
        .iter()
        .map(|route| (route.method_name(), route.path, route.needs))
        .collect();
    description::complete(&mut document, &routes);
    Ok(document)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn the_description_and_the_router_have_the_same_requests() {
        let described = described().expect("written");
        let paths = described["paths"].as_object().expect("paths");
        let described: BTreeSet<(String, String)> = paths
            .iter()
            .flat_map(|(path, item)| {
                let methods = item.as_object().expect("an item").keys();
                methods.map(move |method| (method.clone(), path.clone()))
            })
            .collect();
        let routed: BTreeSet<_> = routes()
            .iter()
            .map(|r| (r.method_name().to_lowercase(), r.path.to_owned()))
            .collect();
        assert_eq!(described, routed);
    }

    #[test]
    fn the_description_has_a_schema_and_words_for_every_answer_and_message() {
        let document = described().expect("written");
        let text = document.to_string();
        for schema in [
            "RigStatus",
            "RunProgress",
            "Failure",
            "Plan",
            "TareReport",
            "LiveMessage",
        ] {
            assert!(text.contains(&format!("\"{schema}\":{{")), "{schema}");
        }
        let paths = document["paths"].as_object().expect("paths");
        let mut ids = BTreeSet::new();
        for (path, item) in paths {
            for (method, operation) in item.as_object().expect("an item") {
                let what = format!("{method} {path}");
                assert!(
                    ids.insert(operation["operationId"].to_string()),
                    "{what}: {ids:?}"
                );
                let told = operation["description"].as_str().unwrap_or_default();
                assert!(
                    told.contains("role") || told.contains("Open to everybody"),
                    "{what}: {told}"
                );
                let answers = operation["responses"].as_object().expect("answers");
                assert!(answers.len() >= 4, "{what}: {answers:?}");
                for (status, answer) in answers {
                    let words = answer["description"].as_str().unwrap_or_default();
                    assert!(words.split_whitespace().count() >= 2, "{what} {status}: {words}");
                }
            }
        }
        for named in text.split("#/components/schemas/").skip(1) {
            let name = named.split('"').next().expect("a name");
            assert!(
                document["components"]["schemas"][name].is_object(),
                "no schema {name}"
            );
        }
        let message = document["components"]["schemas"]["LiveMessage"].to_string();
        for kind in ["samples", "status", "skipped", "LiveBatch"] {
            assert!(message.contains(kind), "{kind}: {message}");
        }
    }
}
