//! One connection: opened and greeted, then texts out and messages in.

use futures_util::{SinkExt, StreamExt};
use serde_json::Value;
use tokio::net::TcpStream;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::{HeaderValue, StatusCode};
use tungstenite::protocol::CloseFrame;
use tungstenite::{Error as SocketError, Message};

use super::Error;
use posed_protocol::{Hello, SUBPROTOCOL_JSON};

/// The code with which the daemon closes connections where its stage has changed.
const STAGE_CHANGED: u16 = 1012;

#[derive(Debug)]
pub(super) struct Socket(WebSocketStream<MaybeTlsStream<TcpStream>>);

/// Why a connection is none any more.
#[derive(Debug)]
pub(super) struct Broken {
    pub(super) why: String,
    pub(super) stage_changed: bool,
}

impl Broken {
    pub(super) fn of(why: &str) -> Self {
        Self { why: why.to_owned(), stage_changed: false }
    }

    fn closed(frame: Option<CloseFrame>) -> Self {
        let Some(CloseFrame { code, reason }) = frame else {
            return Self::of("it has closed the connection");
        };
        let code = u16::from(code);
        let why = if reason.is_empty() {
            format!("it has closed the connection ({code})")
        } else {
            reason.to_string()
        };
        Self { why, stage_changed: code == STAGE_CHANGED }
    }
}

impl From<SocketError> for Broken {
    fn from(error: SocketError) -> Self {
        Self::of(&error.to_string())
    }
}

impl Socket {
    /// Connects, and waits for the greeting.
    pub(super) async fn open(url: &str, token: Option<&str>) -> Result<(Self, Hello), Error> {
        let unreachable = |reason: String| Error::Unreachable { address: url.to_owned(), reason };
        let mut request = url.into_client_request().map_err(|error| unreachable(error.to_string()))?;
        request.headers_mut().insert("sec-websocket-protocol", HeaderValue::from_static(SUBPROTOCOL_JSON));
        if let Some(token) = token {
            let value = HeaderValue::from_str(&format!("Bearer {token}")).map_err(|_| Error::Token)?;
            request.headers_mut().insert("authorization", value);
        }
        let mut socket = match connect_async(request).await {
            Ok((socket, _)) => Self(socket),
            Err(SocketError::Http(answer)) if answer.status() == StatusCode::UNAUTHORIZED => {
                return Err(Error::Unauthorised { address: url.to_owned() });
            }
            Err(error) => return Err(unreachable(error.to_string())),
        };
        let greeting = socket.receive().await.map_err(|broken| unreachable(broken.why))?;
        if greeting["type"] != "hello" {
            return Err(unreachable("it does not say who it is".to_owned()));
        }
        let hello = serde_json::from_value(greeting).map_err(|error| unreachable(error.to_string()))?;
        Ok((socket, hello))
    }

    pub(super) async fn send(&mut self, text: &str) -> Result<(), Broken> {
        Ok(self.0.send(Message::text(text)).await?)
    }

    pub(super) async fn receive(&mut self) -> Result<Value, Broken> {
        loop {
            match self.0.next().await {
                Some(Ok(Message::Text(text))) => {
                    return serde_json::from_str(&text)
                        .map_err(|error| Broken::of(&format!("a message is no JSON: {error}")));
                }
                Some(Ok(Message::Close(frame))) => return Err(Broken::closed(frame)),
                None => return Err(Broken::closed(None)),
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(error.into()),
            }
        }
    }

    pub(super) async fn close(mut self) {
        // Who is gone already needs no good-bye.
        let _ = self.0.close(None).await;
    }
}
