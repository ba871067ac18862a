//! What can be asked over HTTP: the page, `/phone` and `/imu`, `/ws` (and Foxglove's websocket at `/` too), `/metrics`, `/health`, `/takes`, `/recordings`, `/exports`; and who is refused before that.

use std::convert::Infallible;
use std::sync::Arc;

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{FromRequestParts, Path, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;

use super::access::Refusal;
use super::files::Files;
use super::foxglove::Viewer;
use super::listen::ConnectionContext;
use super::metrics::Metrics;
use super::phones::{self, Phones, TokenIs};
use super::requests::Requests;
use super::slots::{NoSlot, Slot};
use super::takes::Takes;
use super::viewer::{self, Coding};
use super::{Shared, client};
use posed_protocol::foxglove;
use posed_protocol::{Encoding, LinkState, SUBPROTOCOL_JSON, SUBPROTOCOL_MSGPACK};
use posed_stage::Role;

/// The page loads its own files and speaks to its own server; nothing else, from nowhere else. The one style that may stand in a document
/// is that of a report, by its hash.
const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; \
    style-src 'self' 'sha256-vJCJIUwHF6Fgs6eoxQVnJGR4PcyaPSUgJ/2tmH39GeE='; connect-src 'self'; \
    img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// What one stage answers, with `takes` the recordings beside it, with `files` those as files, and with `phones` what phones ask for.
pub(super) fn router(
    shared: Arc<Shared>,
    takes: Option<Takes>,
    files: Option<Files>,
    phones: Option<Phones>,
) -> Router {
    let context = Arc::clone(&shared.context);
    let routes = Router::new()
        .route("/", get(root))
        .route("/assets/{name}", get(asset))
        .route("/health", get(health))
        .route("/metrics", get(metrics))
        .route("/ws", get(websocket))
        .with_state(shared)
        .merge(takes.map(Takes::routes).unwrap_or_default())
        .merge(files.map(Files::routes).unwrap_or_default());
    let of_phones = |phones| phones::routes(phones, &context, TokenIs::AsInTheStage);
    let routes = routes.merge(phones.map(of_phones).unwrap_or_default());
    guarded(routes, context)
}

/// Behind the checks and headers that every answer has.
pub(super) fn guarded(routes: Router, context: Arc<ConnectionContext>) -> Router {
    routes.layer(middleware::from_fn_with_state(context, guard))
}

/// Whether tracking goes on and is passed on, of how many devices records are coming in, and by their codes the problems that `status`
/// names; the sentences, which name files and devices, are there and in the log, for this is answered to anybody.
pub(super) async fn health(State(shared): State<Arc<Shared>>) -> (StatusCode, String) {
    if let Err(silent) = shared.reports.check() {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{silent}\n"));
    }
    // Those of the start, too, before the first status.
    let status = shared.reports.newest();
    let status = status.borrow();
    let mut codes: Vec<&str> =
        shared.problems.iter().chain(&status.problems).map(|problem| problem.code.as_str()).collect();
    codes.sort_unstable();
    codes.dedup();
    let mut says = "ok\n".to_owned();
    if !status.devices.is_empty() {
        let streaming = status.devices.iter().filter(|device| device.state == LinkState::Streaming).count();
        says += &format!("devices: {streaming} of {} streaming\n", status.devices.len());
    }
    says.extend(codes.iter().map(|code| format!("problem: {code}\n")));
    (StatusCode::OK, says)
}

/// Relative addresses on a page begin below its name.
pub(super) async fn with_slash(uri: Uri) -> Redirect {
    let query = uri.query().map(|query| format!("?{query}")).unwrap_or_default();
    // Relative, so that it leads nowhere else, whatever the path looks like.
    let name = uri.path().rsplit('/').next().unwrap_or_default();
    Redirect::temporary(&format!("./{name}/{query}"))
}

/// A file of the page.
pub(super) async fn asset(Path(name): Path<String>, coding: Coding) -> Response {
    viewer::file(&format!("assets/{name}"), coding)
}

/// Checks the Host of every request, and puts the protective headers on every answer.
async fn guard(State(context): State<Arc<ConnectionContext>>, request: Request, next: Next) -> Response {
    let mut response = match context.access.check_host(request.headers(), request.uri()) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refuse(&context, "host", refusal),
    };
    let status = response.status();
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    if status != StatusCode::SWITCHING_PROTOCOLS {
        // Connections that wait for a next request would hold places for nothing.
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    headers.insert("cross-origin-opener-policy", HeaderValue::from_static("same-origin"));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    response
}

pub(super) async fn metrics(State(shared): State<Arc<Shared>>, headers: HeaderMap, uri: Uri) -> Response {
    counts(&shared.context, &shared.metrics, &headers, &uri)
}

/// What `/metrics` says to who may ask.
pub(super) fn counts(
    context: &ConnectionContext,
    metrics: &Metrics,
    headers: &HeaderMap,
    uri: &Uri,
) -> Response {
    match context.access.role(headers, uri) {
        Ok(_) => {
            let kind = "application/openmetrics-text; version=1.0.0; charset=utf-8";
            ([(header::CONTENT_TYPE, kind)], metrics.text()).into_response()
        }
        Err(refusal) => refuse(context, "token", refusal),
    }
}

/// The page; and the websocket of Foxglove viewers, who are given an address without a path.
pub(super) async fn root(
    shared: State<Arc<Shared>>,
    slot: SlotOf,
    coding: Coding,
    headers: HeaderMap,
    uri: Uri,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    match upgrade {
        Ok(upgrade) => {
            let upgrade = upgrade.protocols(foxglove::wire::SUBPROTOCOLS);
            if upgrade.selected_protocol().is_none() {
                let sentence = "a websocket of posed's own protocol is at /ws; Foxglove viewers offer foxglove.sdk.v1 or \
                    foxglove.websocket.v1\n";
                return (StatusCode::BAD_REQUEST, sentence).into_response();
            }
            websocket(shared, slot, headers, uri, upgrade).await
        }
        Err(_) if !headers.contains_key(header::UPGRADE) => viewer::file("index.html", coding),
        Err(rejection) => rejection.into_response(),
    }
}

/// The place of a connection, where there is one.
pub(super) struct SlotOf(pub(super) Option<Arc<Slot>>);

impl<S: Sync> FromRequestParts<S> for SlotOf {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Infallible> {
        Ok(Self(parts.extensions.get().cloned()))
    }
}

pub(super) async fn websocket(
    State(shared): State<Arc<Shared>>,
    SlotOf(slot): SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
) -> Response {
    match admit(&shared.context, &headers, &uri, slot.as_deref()) {
        Ok(role) => admitted(shared, slot, role, upgrade, ()),
        Err((reason, refusal)) => refuse(&shared.context, reason, refusal),
    }
}

/// A websocket for who may have one; `held` is dropped when it ends.
pub(super) fn admitted(
    shared: Arc<Shared>,
    slot: Option<Arc<Slot>>,
    role: Role,
    upgrade: WebSocketUpgrade,
    held: impl Send + 'static,
) -> Response {
    let [sdk, older] = foxglove::wire::SUBPROTOCOLS;
    let upgrade =
        bounded(upgrade, &shared.context).protocols([SUBPROTOCOL_MSGPACK, SUBPROTOCOL_JSON, sdk, older]);
    let protocol = upgrade.selected_protocol().and_then(|protocol| protocol.to_str().ok()).unwrap_or("");
    let speaks = match protocol {
        SUBPROTOCOL_MSGPACK => Speaks::Own(Encoding::MessagePack),
        name if foxglove::wire::SUBPROTOCOLS.contains(&name) => Speaks::Foxglove,
        _ => Speaks::Own(Encoding::Json),
    };
    upgrade.on_upgrade(move |socket| async move {
        let _held = held;
        let burst = shared.context.limits.message_burst;
        match speaks {
            Speaks::Own(encoding) => {
                if let Some(requests) = Requests::begin(encoding, role, &shared).await {
                    client::serve(socket, requests, burst, Arc::clone(&shared.context), slot).await;
                }
            }
            Speaks::Foxglove => {
                if let Some(viewer) = Viewer::begin(&shared).await {
                    // Some subscribe to every channel by a message of its own.
                    let burst = burst + viewer.channels() as f64;
                    client::serve(socket, viewer, burst, Arc::clone(&shared.context), slot).await;
                }
            }
        }
    })
}

/// What a client has chosen by the sub-protocol.
enum Speaks {
    Own(Encoding),
    Foxglove,
}

/// What who asks for a websocket may do, or the refusal and its reason: Origin and token are looked at, and then whether there is
/// a place.
pub(super) fn admit(
    context: &ConnectionContext,
    headers: &HeaderMap,
    uri: &Uri,
    slot: Option<&Slot>,
) -> Result<Role, (&'static str, Refusal)> {
    context.access.check_origin(headers).map_err(|refusal| ("origin", refusal))?;
    let role = context.access.role(headers, uri).map_err(|refusal| ("token", refusal))?;
    let full = |error: NoSlot| ("limit", (StatusCode::SERVICE_UNAVAILABLE, error.to_string()));
    slot.map_or(Ok(()), Slot::enter).map_err(full)?;
    Ok(role)
}

/// The websocket with its limits.
pub(super) fn bounded(upgrade: WebSocketUpgrade, context: &ConnectionContext) -> WebSocketUpgrade {
    upgrade
        // Small reads, so that a flooding client gives the others their turn.
        .read_buffer_size(4 * 1024)
        .write_buffer_size(64 * 1024)
        .max_write_buffer_size(64 * 1024 * 1024)
        .max_message_size(context.limits.message_bytes)
        .max_frame_size(context.limits.message_bytes)
}

pub(super) fn refuse(
    context: &ConnectionContext,
    reason: &'static str,
    (status, sentence): Refusal,
) -> Response {
    context.metrics.refuse(reason);
    let mut response = (status, sentence + "\n").into_response();
    if status == StatusCode::SERVICE_UNAVAILABLE {
        response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("5"));
    }
    if status == StatusCode::UNAUTHORIZED {
        response.headers_mut().insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_style_of_a_report_is_allowed_as_it_is() {
        let digest = ring::digest::digest(&ring::digest::SHA256, posed_sessions::report::STYLE.as_bytes());
        let hash = data_encoding::BASE64.encode(digest.as_ref());
        assert!(CONTENT_SECURITY_POLICY.contains(&format!("style-src 'self' 'sha256-{hash}'")), "{hash}");
    }
}
