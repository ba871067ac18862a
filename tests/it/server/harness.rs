//! A running server, and a client of it.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use posed_daemon::Vital;
use posed_daemon::server::{Config, Hub, PendingCall, Server};
use posed_drivers::Timestamp;
use posed_stage::Stage;
use posed_stage::output::{
    Estimate, Measured, Outcome, OutcomeKind, Output, PoseEstimate, SensorEstimate, SensorState,
};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::handshake::client::Request;
use tokio_tungstenite::tungstenite::protocol::CloseFrame;
use tokio_tungstenite::tungstenite::{self, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

pub(crate) const WATCH: &str = "watch-watch-watch-1";
pub(crate) const OPERATE: &str = "operate-operate-1";

/// Nothing here takes long; a test that waits for ever should fail with a line number.
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);

pub(crate) fn stage(extra: &str) -> Stage {
    let text = format!(
        r#"
        name = "Stage A"
        [[device]]
        name = "flock"
        driver = "flock-of-birds"
        port = "auto"
        [[sensor]]
        name = "left"
        device = "flock"
        address = 1
        [[sensor]]
        name = "right"
        device = "flock"
        address = 2
        {extra}
        "#
    );
    Stage::parse(&text).unwrap()
}

pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    pub(crate) url: String,
    pub(crate) vrpn: Option<SocketAddr>,
    pub(crate) hub: Hub,
    pub(crate) calls: mpsc::Receiver<PendingCall>,
    stop: Option<oneshot::Sender<()>>,
    pub(crate) task: JoinHandle<()>,
}

pub(crate) fn config() -> Config {
    Config { listen: Some("127.0.0.1:0".into()), ..Config::new(Path::new("."), 1_700_000_000_000_000_001) }
}

pub(crate) fn start(stage: &Stage, config: Config) -> Running {
    let (server, hub, calls) = Server::bind(stage, config).unwrap();
    let (address, vrpn, url) = (server.address(), server.vrpn_address(), server.url());
    let (stop, stopped) = oneshot::channel();
    let stopped = async {
        let _ = stopped.await;
    };
    let task = tokio::spawn(server.run(stopped, Vital::default()));
    Running { address, url, vrpn, hub, calls, stop: Some(stop), task }
}

impl Running {
    pub(crate) fn plain() -> Self {
        start(&stage(""), config())
    }

    pub(crate) fn stop(&mut self) {
        self.stop.take().unwrap().send(()).unwrap();
    }

    pub(crate) fn request(&self, query: &str) -> Request {
        format!("ws://{}/ws{query}", self.address).into_client_request().unwrap()
    }

    /// A client that has been greeted.
    pub(crate) async fn client(&self) -> Client {
        let mut client = self.connect(self.request("")).await.unwrap();
        assert_eq!(client.next().await["type"], "hello");
        client
    }

    pub(crate) async fn connect(&self, request: Request) -> Result<Client, tungstenite::Error> {
        let (socket, response) = tokio_tungstenite::connect_async(request).await?;
        let protocol =
            response.headers().get("sec-websocket-protocol").map(|p| p.to_str().unwrap().to_owned());
        Ok(Client { socket, protocol })
    }

    /// Status with which the upgrade was refused, and the sentence.
    pub(crate) async fn refusal(&self, request: Request) -> (u16, String) {
        match self.connect(request).await {
            Ok(_) => panic!("it was not refused"),
            Err(tungstenite::Error::Http(response)) => {
                let body = response.body().clone().unwrap_or_default();
                (response.status().as_u16(), String::from_utf8(body).unwrap())
            }
            Err(error) => panic!("{error}"),
        }
    }

    pub(crate) fn frame(&self, frame: u64) {
        self.hub.publish(&Output::Estimate(&estimate(frame)));
    }

    pub(crate) fn fault(&self, at_ms: i64, sensor: u16, active: bool) {
        let t = Timestamp::from_nanos(at_ms * 1_000_000);
        let what = OutcomeKind::Fault { sensor, cause: posed_fusion::faults::Cause::Gate, active };
        self.hub.publish(&Output::Outcome(&Outcome { t_valid: t, t_decided: t, what }));
    }
}

/// A frame every 10 ms; the left sensor moves, the right one is missing.
pub(crate) fn estimate(frame: u64) -> Estimate {
    let t_valid = Timestamp::from_nanos(frame as i64 * 10_000_000);
    let position_m = [0.1 + frame as f64 * 1e-3, -0.2, 1.0 / 3.0];
    let orientation_wxyz = [0.5f64.sqrt(), 0.0, 0.5f64.sqrt(), 0.0];
    let left = SensorEstimate {
        state: SensorState::Ok,
        pose: Some(PoseEstimate {
            position_m: Some(position_m),
            orientation_wxyz,
            velocity_m_s: Some([0.1, 0.0, 0.0]),
            angular_velocity_rad_s: [0.0; 3],
            covariance: [1.234567e-7; 21],
            sigma_m: Some(0.000_612_3),
        }),
        measured: Some(Measured {
            t_valid,
            position_m: Some(position_m),
            clipped: false,
            orientation_wxyz: Some(orientation_wxyz),
            button: None,
            inertial: None,
        }),
        fault: None,
        ..SensorEstimate::default()
    };
    Estimate {
        fault: None,
        frame,
        t_valid,
        t_closed: t_valid,
        sigma_t_s: 2e-4,
        sensors: vec![left, SensorEstimate::default()],
    }
}

pub(crate) struct Client {
    pub(crate) socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    pub(crate) protocol: Option<String>,
}

impl Client {
    pub(crate) async fn send(&mut self, request: Value) {
        self.socket.send(Message::Text(request.to_string().into())).await.unwrap();
    }

    /// The next message, in either encoding.
    pub(crate) async fn next(&mut self) -> Value {
        match self.next_frame().await {
            Message::Text(text) => serde_json::from_str(&text).unwrap(),
            Message::Binary(bytes) => rmp_serde::from_slice(&bytes).unwrap(),
            other => panic!("expected a message, got {other:?}"),
        }
    }

    /// The next message as it was sent, in JSON.
    pub(crate) async fn next_text(&mut self) -> String {
        match self.next_frame().await {
            Message::Text(text) => text.as_str().to_owned(),
            other => panic!("expected a text, got {other:?}"),
        }
    }

    async fn next_frame(&mut self) -> Message {
        loop {
            match tokio::time::timeout(PATIENCE, self.socket.next()).await.expect("a message") {
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                Some(Ok(frame)) => return frame,
                other => panic!("expected a message, got {other:?}"),
            }
        }
    }

    /// Sends a request and gives its reply, which must be the next message that is one.
    pub(crate) async fn ask(&mut self, mut request: Value) -> Value {
        request["id"] = json!(7);
        self.send(request).await;
        loop {
            let message = self.next().await;
            if message["type"] == "ok" || message["type"] == "error" {
                assert_eq!(message["id"], 7);
                return message;
            }
        }
    }

    pub(crate) async fn subscribe(&mut self, topics: &[&str]) {
        let reply = self.ask(json!({"type": "subscribe", "topics": topics})).await;
        assert_eq!(reply["type"], "ok", "{reply}");
    }

    /// Code and reason with which the server ends this connection.
    pub(crate) async fn closed(&mut self) -> (u16, String) {
        self.ended().await.expect("a close before the end")
    }

    /// Code and reason with which the server ends this connection; `None` where the line is cut before they are read.
    pub(crate) async fn ended(&mut self) -> Option<(u16, String)> {
        loop {
            match tokio::time::timeout(PATIENCE, self.socket.next()).await.expect("an end") {
                Some(Ok(Message::Close(Some(CloseFrame { code, reason })))) => {
                    return Some((code.into(), reason.to_string()));
                }
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return None,
            }
        }
    }
}

/// A plain HTTP exchange: the whole answer.
pub(crate) async fn get(address: SocketAddr, head: &str) -> String {
    String::from_utf8(get_bytes(address, head).await).unwrap()
}

/// The same of an answer that is no text.
pub(crate) async fn get_bytes(address: SocketAddr, head: &str) -> Vec<u8> {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let mut stream = TcpStream::connect(address).await.unwrap();
    stream.write_all(head.as_bytes()).await.unwrap();
    let mut answer = Vec::new();
    tokio::time::timeout(PATIENCE, stream.read_to_end(&mut answer)).await.unwrap().unwrap();
    answer
}
