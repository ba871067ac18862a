//! What can be asked over HTTP: the page, `/ws`, `/metrics`, `/health`; and who is refused before that.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Extension, Path, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Router, extract::rejection::ExtensionRejection};

use super::access::Refusal;
use super::listen::Slot;
use super::{Shared, client, viewer};
use crate::protocol::{Encoding, SUBPROTOCOL_JSON, SUBPROTOCOL_MSGPACK};

/// The page loads its own files and speaks to its own server; nothing else, from nowhere else.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

pub(super) fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/", get(|| async { viewer::file("index.html") }))
        .route(
            "/assets/{name}",
            get(|Path(name): Path<String>| async move { viewer::file(&format!("assets/{name}")) }),
        )
        .route("/health", get(|| async { "ok\n" }))
        .route("/metrics", get(metrics))
        .route("/ws", get(websocket))
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), guard))
        .with_state(shared)
}

/// Checks the Host of every request, and puts the protective headers on every answer.
async fn guard(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let mut response = match shared.access.check_host(request.headers(), request.uri()) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refuse(&shared, "host", refusal),
    };
    let status = response.status();
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    if status != StatusCode::SWITCHING_PROTOCOLS {
        // Connections that wait for a next request would hold places for nothing.
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    headers.insert("cross-origin-opener-policy", HeaderValue::from_static("same-origin"));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    response
}

async fn metrics(State(shared): State<Arc<Shared>>, headers: HeaderMap, uri: Uri) -> Response {
    match shared.access.role(&headers, &uri) {
        Ok(_) => {
            let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
            ([(header::CONTENT_TYPE, kind)], shared.metrics.text()).into_response()
        }
        Err(refusal) => refuse(&shared, "token", refusal),
    }
}

async fn websocket(
    State(shared): State<Arc<Shared>>,
    slot: Result<Extension<Arc<Slot>>, ExtensionRejection>,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(refusal) = shared.access.check_origin(&headers) {
        return refuse(&shared, "origin", refusal);
    }
    let role = match shared.access.role(&headers, &uri) {
        Ok(role) => role,
        Err(refusal) => return refuse(&shared, "token", refusal),
    };
    let slot = slot.ok().map(|Extension(slot)| slot);
    let upgrade = upgrade
        .protocols([SUBPROTOCOL_MSGPACK, SUBPROTOCOL_JSON])
        // Small reads, so that a flooding client gives the others their turn.
        .read_buffer_size(4 * 1024)
        .write_buffer_size(64 * 1024)
        .max_write_buffer_size(64 * 1024 * 1024)
        .max_message_size(shared.limits.message_bytes)
        .max_frame_size(shared.limits.message_bytes);
    let encoding = match upgrade.selected_protocol().and_then(|protocol| protocol.to_str().ok()) {
        Some(SUBPROTOCOL_MSGPACK) => Encoding::MessagePack,
        _ => Encoding::Json,
    };
    let client = shared.next_client.fetch_add(1, Ordering::Relaxed);
    upgrade.on_upgrade(move |socket| async move {
        client::serve(socket, client, encoding, role, shared).await;
        drop(slot);
    })
}

fn refuse(shared: &Shared, reason: &'static str, (status, sentence): Refusal) -> Response {
    shared.metrics.refuse(reason);
    let mut response = (status, sentence + "\n").into_response();
    if status == StatusCode::UNAUTHORIZED {
        response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    }
    response
}
