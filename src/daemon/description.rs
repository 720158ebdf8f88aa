//! Completes the OpenAPI description: what every answer is, the answers that guard, gate and server give on every route, the
//! role of each route, and the messages of the WebSocket.

use serde_json::{Value, json};

use super::access::role::Needs;

/// What a status of the interface means.
const STATUSES: [(&str, &str); 16] = [
    ("101", "The connection is now a WebSocket."),
    ("200", "Done."),
    ("202", "The run starts."),
    (
        "400",
        "The request cannot be read: its query, its JSON or the header `leafbench-caller`.",
    ),
    (
        "401",
        "No valid token, or a session that has ended; or a cookie alone where a key is needed.",
    ),
    (
        "403",
        "The role is not enough, or the request comes from another web page or asks for another host.",
    ),
    ("404", "There is nothing with this name or id."),
    ("408", "The body did not arrive within 10 s."),
    (
        "409",
        "The state of the bench does not allow it now, another client commands, or the name is taken.",
    ),
    ("413", "The body is too large."),
    (
        "415",
        "The body is of another type: send `Content-Type: application/json`.",
    ),
    ("422", "The content cannot be used; `error` says what and where."),
    ("429", "Too many wrong tokens came from this address; wait 10 s."),
    (
        "500",
        "A defect of the daemon, or a file that cannot be read or written.",
    ),
    (
        "503",
        "Too many connections, or control has too much to do: try again. A stop always has a place.",
    ),
    ("507", "The disk is full."),
];

/// One route: method in capitals, path, need.
pub(super) type DescribedRoute = (&'static str, &'static str, Needs);

/// Completes the description that the handlers have.
pub(super) fn complete(document: &mut Value, routes: &[DescribedRoute]) {
    document["components"]["securitySchemes"] = json!({
        "token": {
            "type": "http",
            "scheme": "bearer",
            "description": "The owner's token (file `token` in the data folder, from this computer only), a token of \
                            `leafbench token add`, or the key of a page's session."
        },
        "session": {
            "type": "apiKey",
            "in": "cookie",
            "name": "leafbench-PORT",
            "description": "The cookie of a page's session. It watches and stops only."
        }
    });
    let schemas = document["components"]["schemas"].clone();
    for (method, path, needs) in routes {
        let operation = &mut document["paths"][*path][method.to_lowercase()];
        if operation.is_object() {
            operation["operationId"] = id_of(method, path).into();
            add_need(operation, *needs);
            add_answers(operation, method, path, *needs);
            describe_answers(operation, &schemas);
        }
    }
    document["paths"]["/api/live"]["get"]["responses"]["101"]["description"] = json!(
        "The connection is now a WebSocket. Each message is text: JSON of the schema `LiveMessage`. Clients send nothing."
    );
    document["paths"]["/api/live"]["get"]["x-messages"] =
        json!({ "$ref": "#/components/schemas/LiveMessage" });
}

/// A name that no other request has: handlers of two subjects may have the same one.
fn id_of(method: &str, path: &str) -> String {
    let words = path
        .split(|c: char| !c.is_alphanumeric() && c != '_')
        .filter(|word| !word.is_empty() && *word != "api");
    let words: Vec<String> = words.map(str::to_lowercase).collect();
    format!("{}_{}", method.to_lowercase(), words.join("_"))
}

/// Who may send the request.
fn add_need(operation: &mut Value, needs: Needs) {
    let (words, security) = match (needs.role, needs.by_cookie) {
        (None, _) => ("Open to everybody.".to_owned(), json!([])),
        (Some(role), true) => (
            format!("Needs the role {role}."),
            json!([{ "token": [] }, { "session": [] }]),
        ),
        (Some(role), false) => (
            format!("Needs the role {role}, with a token or key."),
            json!([{ "token": [] }]),
        ),
    };
    let own = operation["description"].as_str().unwrap_or_default();
    let text = if own.is_empty() {
        words
    } else {
        format!("{own}\n\n{words}")
    };
    operation["description"] = text.into();
    operation["security"] = security;
}

/// The answers that do not come from the handler.
fn add_answers(operation: &mut Value, method: &str, path: &str, needs: Needs) {
    let mut statuses = vec!["403", "500", "503"];
    if needs.role.is_some() {
        statuses.extend(["401", "429"]);
    }
    if method == "POST" {
        statuses.extend(["400", "408", "413", "415", "422"]);
    }
    if method != "GET" && needs == Needs::OPERATE {
        statuses.extend(["400", "409"]);
    }
    if path == "/api/login" {
        statuses.extend(["401", "429"]);
    }
    if path.contains('{') {
        statuses.push("404");
    }
    if operation["parameters"].is_array() {
        statuses.push("400");
    }
    for status in statuses {
        let answer = &mut operation["responses"][status];
        if answer.is_null() {
            *answer = json!({
                "content": { "application/json": { "schema": { "$ref": "#/components/schemas/Failure" } } }
            });
        }
    }
}

/// Gives every answer a description: that of its schema, or what its status means.
fn describe_answers(operation: &mut Value, schemas: &Value) {
    let Some(answers) = operation["responses"].as_object_mut() else {
        return;
    };
    for (status, answer) in answers {
        if answer["description"].as_str().is_some_and(|own| !own.is_empty()) {
            continue;
        }
        let (kind, schema) = content(answer);
        let of_schema = schema
            .rsplit('/')
            .next()
            .and_then(|name| schemas[name]["description"].as_str())
            .filter(|_| status.starts_with('2'));
        let meaning = STATUSES.iter().find(|(known, _)| known == status);
        let text = match (of_schema, meaning) {
            (Some(text), _) => text.to_owned(),
            (None, Some((_, meaning))) if !status.starts_with('2') => (*meaning).to_owned(),
            _ if !kind.is_empty() => format!("The answer, as {kind}."),
            (None, Some((_, meaning))) => (*meaning).to_owned(),
            (None, None) => format!("HTTP status {status}."),
        };
        answer["description"] = text.into();
    }
}

/// Type and schema of an answer; the schema of the items of a list.
fn content(answer: &Value) -> (String, String) {
    let first = answer["content"]
        .as_object()
        .and_then(|content| content.iter().next());
    let Some((kind, content)) = first else {
        return Default::default();
    };
    let schema = &content["schema"];
    let named = schema["$ref"]
        .as_str()
        .or_else(|| schema["items"]["$ref"].as_str());
    (kind.clone(), named.unwrap_or_default().to_owned())
}
