//! The connection against a daemon that the test plays.

use tokio::net::{TcpListener, TcpStream};
use tokio_tungstenite::{WebSocketStream, accept_hdr_async};
use tungstenite::Message;
use tungstenite::handshake::server::{Callback, ErrorResponse, Request, Response};
use tungstenite::protocol::CloseFrame;

use super::*;
use futures_util::{SinkExt, StreamExt};

/// A daemon's end of a connection.
struct Peer(WebSocketStream<TcpStream>);

/// Speaks our protocol, and notes with what the client authorises itself.
struct Handshake<'a>(&'a mut Option<String>);

impl Callback for Handshake<'_> {
    fn on_request(self, request: &Request, mut answer: Response) -> Result<Response, ErrorResponse> {
        *self.0 = request.headers().get("authorization").map(|value| value.to_str().unwrap().to_owned());
        answer.headers_mut().insert("sec-websocket-protocol", "posed.v1".parse().unwrap());
        Ok(answer)
    }
}

impl Peer {
    /// The next connection, greeted; with what it authorised itself.
    async fn greeted(listener: &TcpListener, last_event_id: u64) -> (Self, Option<String>) {
        let (stream, _) = listener.accept().await.unwrap();
        let mut token = None;
        let mut peer = Self(accept_hdr_async(stream, Handshake(&mut token)).await.unwrap());
        peer.say(json!({
            "type": "hello", "version": "0.1.0", "stage": "Played", "epoch_utc": "2026-11-21T10:21:11.425736412Z", "bodies": [], "skeleton": null,
            "height_m": null, "topics": ["marks", "jobs"], "sensors": [], "transmitter": {"position_m": [0, 0, 0], "orientation_wxyz": [1, 0, 0, 0]},
            "role": "operate", "last_event_id": last_event_id,
        }))
        .await;
        (peer, token)
    }

    async fn say(&mut self, message: Value) {
        self.0.send(Message::text(message.to_string())).await.unwrap();
    }

    async fn mark(&mut self, event_id: u64) {
        self.say(json!({"type": "marks", "seq": 0, "dropped": 0, "t_s": 1.0, "event_id": event_id, "t_valid_s": 1.0, "label": ""})).await;
    }

    async fn hear(&mut self) -> Value {
        let Some(Ok(Message::Text(text))) = self.0.next().await else { panic!("a request") };
        serde_json::from_str(&text).unwrap()
    }

    /// The next request, which must be this one, is carried out.
    async fn ok(&mut self, kind: &str) -> Value {
        let request = self.hear().await;
        assert_eq!(request["type"], kind, "{request}");
        self.say(json!({"type": "ok", "id": request["id"]})).await;
        request
    }
}

async fn listener() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (listener, address)
}

fn event_id(message: &ServerMessage) -> u64 {
    serde_json::to_value(message).unwrap()["event_id"].as_u64().unwrap()
}

#[tokio::test]
async fn an_answer_is_typed_a_refusal_an_error_and_what_comes_meanwhile_is_kept() {
    let (listener, address) = listener().await;
    let daemon = async {
        let (mut peer, token) = Peer::greeted(&listener, 4).await;
        assert_eq!(token.as_deref(), Some("Bearer secret"));
        let subscribed = peer.ok("subscribe").await;
        // What the stage does not publish is not asked for.
        assert_eq!(subscribed["topics"], json!(["marks"]));
        let request = peer.hear().await;
        assert_eq!((&request["type"], &request["name"]), (&json!("record.start"), &json!("a.mcap")));
        peer.mark(5).await;
        peer.say(json!({"type": "ok", "id": request["id"], "result": {"name": "a.mcap", "job": 3}})).await;
        let request = peer.hear().await;
        peer.say(json!({"type": "error", "id": request["id"], "code": "busy", "message": "a recording runs already"})).await;
        let request = peer.hear().await;
        peer.say(json!({"type": "ok", "id": request["id"], "result": 7})).await;
        peer.ok("record.stop").await;
    };
    let client = async {
        let mut stage = Client::connect(&address, Some("secret")).await.unwrap();
        assert_eq!(stage.hello().stage, "Played");
        stage.subscribe(Choice::of([Topic::Marks, Topic::Body])).await.unwrap();
        let start = Call::RecordStart { name: Some("a.mcap".to_owned()) };
        assert_eq!(stage.request::<Started>(&start).await.unwrap(), Started { job: 3 });
        let Err(Error::Refused { code, message }) = stage.request::<Started>(&start).await else { panic!() };
        assert_eq!((code.as_str(), message.as_str()), ("busy", "a recording runs already"));
        assert!(matches!(stage.request::<Started>(&start).await, Err(Error::Answer(_))));
        stage.request::<()>(&Call::RecordStop {}).await.unwrap();
        assert_eq!(event_id(&stage.next().await.unwrap()), 5);
        stage.close().await;
    };
    tokio::join!(daemon, client);
}

#[tokio::test]
async fn missed_events_come_after_a_reconnection_in_order_and_once() {
    let (listener, address) = listener().await;
    let daemon = async {
        let (mut peer, _) = Peer::greeted(&listener, 4).await;
        peer.ok("subscribe").await;
        peer.mark(5).await;
        // A request that breaks off.
        peer.hear().await;
        let changed = CloseFrame { code: 1012.into(), reason: "the stage has changed".into() };
        peer.0.close(Some(changed)).await.unwrap();
        drop(peer);
        let (mut peer, _) = Peer::greeted(&listener, 8).await;
        peer.ok("subscribe").await;
        let resume = peer.hear().await;
        assert_eq!((&resume["type"], &resume["after"]), (&json!("resume"), &json!(5)));
        for id in [9, 6, 7, 8, 9] {
            peer.mark(id).await;
        }
        peer.say(json!({"type": "ok", "id": resume["id"]})).await;
        peer.ok("unsubscribe").await;
        peer.mark(10).await;
        // Then it is gone, and another one begins anew at its address.
        drop(peer);
        let (mut peer, _) = Peer::greeted(&listener, 1).await;
        peer.ok("subscribe").await;
        assert_eq!(peer.ok("resume").await["after"], 0);
        peer.ok("unsubscribe").await;
        peer.mark(2).await;
        peer.hear().await
    };
    let client = async {
        let mut stage = Client::connect(&format!("http://{address}/"), None).await.unwrap();
        stage.subscribe(Choice::of([Topic::Marks])).await.unwrap();
        let lost = stage.request::<()>(&Call::RecordStop {}).await;
        assert!(matches!(&lost, Err(Error::Lost(why)) if why == "the stage has changed"), "{lost:?}");
        let mut ids = Vec::new();
        for _ in 0..7 {
            // Dropped again and again while it waits.
            let message = loop {
                tokio::select! {
                    biased;
                    message = stage.next() => break message,
                    () = tokio::task::yield_now() => {}
                }
            };
            ids.push(event_id(&message.unwrap()));
        }
        assert_eq!(ids, [5, 6, 7, 8, 9, 10, 2]);
        // The same again, now that it is known by this client.
        let _ =
            tokio::time::timeout(Duration::from_millis(1), stage.request::<()>(&Call::RecordStop {})).await;
    };
    tokio::join!(daemon, client);
}

#[tokio::test]
async fn who_does_not_answer_or_not_so_is_said_in_words() {
    let (listener, address) = listener().await;
    let daemon = async {
        use tokio::io::{AsyncReadExt, AsyncWriteExt};
        let (mut stream, _) = listener.accept().await.unwrap();
        let _ = stream.read(&mut [0; 2000]).await.unwrap();
        stream.write_all(b"HTTP/1.1 401 Unauthorized\r\ncontent-length: 0\r\n\r\n").await.unwrap();
        let (stream, _) = listener.accept().await.unwrap();
        let mut other = tokio_tungstenite::accept_async(stream).await.unwrap();
        let _ = other.send(Message::text("roses are red")).await;
        let (mut peer, _) = Peer::greeted(&listener, 0).await;
        peer.ok("subscribe").await;
        peer.say(json!({"type": "marks", "seq": "none"})).await;
    };
    let client = async {
        assert!(matches!(Client::connect(&address, None).await, Err(Error::Unauthorised { .. })));
        let Err(Error::Unreachable { reason, .. }) = Client::connect(&address, None).await else { panic!() };
        assert!(reason.contains("no JSON") || reason.contains("protocol"), "{reason}");
        let mut stage = Client::connect(&address, None).await.unwrap().without_reconnection();
        stage.subscribe(Choice::of([Topic::Marks])).await.unwrap();
        let Err(Error::Lost(why)) = stage.next().await else { panic!() };
        assert!(why.contains("none that this client knows"), "{why}");
    };
    tokio::join!(daemon, client);
    assert!(matches!(Client::connect(&address, Some("a\nb")).await, Err(Error::Token)));
    drop(listener);
    let Err(Error::Unreachable { address: at, .. }) = Client::connect(&address, None).await else { panic!() };
    assert_eq!(at, format!("ws://{address}/ws"));
}
