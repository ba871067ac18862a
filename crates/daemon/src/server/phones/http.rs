//! What phones can ask for: their page, the certificate to trust, and the websocket.

use std::sync::Arc;

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::super::access::Access;
use super::super::http::{SlotOf, bounded, refuse};
use super::super::listen::{ConnectionContext, Peer};
use super::super::viewer::{self, Coding};
use super::Phones;
use super::socket::{MESSAGE_BYTES, Phone};

/// The sub-protocol of the open format.
const SUBPROTOCOL: &str = "imu.v1";

/// Whether who sends must have a token where the stage file has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::server) enum TokenIs {
    /// On this computer: everybody may.
    AsInTheStage,
    Needed,
}

#[derive(Clone)]
struct Served {
    phones: Phones,
    context: Arc<ConnectionContext>,
    token: TokenIs,
}

/// The page at `/phone`, the certificate below it, and `/imu`.
pub(in crate::server) fn routes(phones: Phones, context: &Arc<ConnectionContext>, token: TokenIs) -> Router {
    Router::new()
        .route("/phone", get(async |coding: Coding| viewer::file("phone.html", coding)))
        .route("/phone/authority.crt", get(authority))
        .route("/imu", get(websocket))
        .with_state(Served { phones, context: Arc::clone(context), token })
}

async fn authority(State(served): State<Served>) -> Response {
    match served.phones.authority() {
        Some(der) => {
            let kind = HeaderValue::from_static("application/x-x509-ca-cert");
            ([(header::CONTENT_TYPE, kind)], der).into_response()
        }
        None => (StatusCode::NOT_FOUND, "this daemon has made no certificate\n").into_response(),
    }
}

async fn websocket(
    State(served): State<Served>,
    Extension(Peer(peer)): Extension<Peer>,
    SlotOf(slot): SlotOf,
    headers: HeaderMap,
    uri: Uri,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let Served { phones, context, token } = served;
    let is_needed = token == TokenIs::Needed || !context.access.tokens.is_empty();
    let own = phones.token();
    let admitted =
        context.access.check_origin_of_sensor(&headers, is_needed).map_err(|refusal| ("origin", refusal));
    let admitted = admitted.and_then(|()| {
        let may = !is_needed || own.is_some_and(|own| Access::is_given(&headers, &uri, &own));
        if may {
            Ok(())
        } else {
            context.access.may_send(&headers, &uri).map_err(|refusal| ("token", refusal))
        }
    });
    if let Err((reason, refusal)) = admitted {
        return refuse(&context, reason, refusal);
    }
    // Only now: a page that was refused asks over HTTP why.
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(rejection) => return rejection.into_response(),
    };
    let upgrade = bounded(upgrade, &context).max_message_size(MESSAGE_BYTES).max_frame_size(MESSAGE_BYTES);
    let upgrade = upgrade.protocols([SUBPROTOCOL]);
    let full = |sentence: String| refuse(&context, "limit", (StatusCode::SERVICE_UNAVAILABLE, sentence));
    if let Some(Err(error)) = slot.as_ref().map(|slot| slot.enter()) {
        return full(error.to_string());
    }
    let gate = phones.gate();
    let Some(entered) = gate.enter(peer) else {
        return full("this daemon takes 64 devices at most; try again when one has left".to_owned());
    };
    let (placing, status) = (phones.placing(), phones.status());
    upgrade.on_upgrade(move |socket| Phone { socket, entered, placing, status, context, slot }.serve())
}
