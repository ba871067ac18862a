//! `posed body calibrate`: the guided calibration of a running daemon, in a terminal.
//!
//! In: the daemon's websocket. Out: what to do next, a line each, and in the end how well every sensor's mounting shows. It decides
//! nothing: the daemon notices what was done, and uses what it finds. Ctrl-C cancels.

use futures_util::{SinkExt, StreamExt};
use posed_protocol::{Job, JobState, Jobs};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};
use tungstenite::Message;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;

use super::super::end::End;
use super::super::run::block_on;
use super::{Error, print, print_json};

/// How and where to calibrate.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  posed body calibrate\n  posed body calibrate --how assign --at 192.168.1.7:8787 --token \"$TOKEN\"\n\n\
    It states what to do next, and notices by itself when it was done. Ctrl-C cancels. A daemon with TLS is calibrated on its page."
)]
pub(super) struct Calibrate {
    /// What is done: two poses; also elbows and knees; walking about, without a pose; or every limb, which also finds which sensor sits where.
    #[arg(long, value_parser = ["quick", "full", "movement", "assign"], default_value = "full")]
    how: String,
    /// Whom, by the name of the body, where the stage has several.
    #[arg(long, value_name = "NAME")]
    body: Option<String>,
    /// Where the daemon serves its page.
    #[arg(long, default_value = "127.0.0.1:8787", value_name = "HOST:PORT")]
    at: String,
    /// Secret of an operator, where the daemon asks for one.
    #[arg(long, value_name = "SECRET")]
    token: Option<String>,
    /// Print one JSON object in the end: `quality_deg` and `sensors` by segment.
    #[arg(long)]
    json: bool,
}

const SUBSCRIBE: u64 = 1;
const BEGIN: u64 = 2;
const CANCEL: u64 = 3;

pub(super) fn run(args: &Calibrate) -> Result<(), Error> {
    block_on(async {
        let mut daemon = Daemon::connect(args).await?;
        daemon.send(&json!({"type": "subscribe", "id": SUBSCRIBE, "topics": ["jobs"]})).await?;
        daemon
            .send(&json!({"type": "body.calibrate", "id": BEGIN, "how": args.how, "body": args.body}))
            .await?;
        let mut end = End::new(None)?;
        let (mut number, mut reported) = (None, String::new());
        loop {
            let message = tokio::select! {
                message = daemon.next() => message?,
                () = end.wait() => {
                    let Some(job) = number else { return Err(Error::failed("cancelled")) };
                    daemon.send(&json!({"type": "job.cancel", "id": CANCEL, "job": job})).await?;
                    continue;
                }
            };
            match (message["type"].as_str(), message["id"].as_u64()) {
                (Some("ok"), Some(BEGIN)) => number = message["result"]["job"].as_u64(),
                (Some("error"), _) => {
                    return Err(Error::failed(message["message"].as_str().unwrap_or("the daemon refused")));
                }
                (Some("jobs"), _) => {
                    let jobs: Jobs = serde_json::from_value(message).map_err(Error::failed)?;
                    let Some(job) = jobs.jobs.into_iter().find(|job| Some(job.job) == number) else {
                        continue;
                    };
                    if job.state != JobState::Running {
                        return outcome(args, job);
                    }
                    if let Some(sentence) = job.message.filter(|sentence| *sentence != reported) {
                        emit(args, &sentence)?;
                        reported = sentence;
                    }
                }
                _ => {}
            }
        }
    })
}

/// A prompt; beside JSON, where only people look.
fn emit(args: &Calibrate, sentence: &str) -> Result<(), Error> {
    if args.json {
        tracing::info!("{sentence}");
        return Ok(());
    }
    print(&format!("{sentence}\n"))
}

/// How it ended.
fn outcome(args: &Calibrate, job: Job) -> Result<(), Error> {
    let sentence = job.message.unwrap_or_default();
    if job.state != JobState::Done {
        return Err(Error::Failed(sentence));
    }
    let result = job.result.unwrap_or_default();
    if args.json {
        return print_json(&result);
    }
    let mut text = format!("{sentence}\n");
    for (segment, quality_deg) in result["quality_deg"].as_object().into_iter().flatten() {
        let sensor = result["sensors"][segment].as_str().unwrap_or_default();
        text +=
            &format!("{segment:<14} {sensor:<20} {:.1} degrees\n", quality_deg.as_f64().unwrap_or(f64::NAN));
    }
    print(&text)
}

struct Daemon(WebSocketStream<MaybeTlsStream<TcpStream>>);

impl Daemon {
    async fn connect(args: &Calibrate) -> Result<Self, Error> {
        let wrong = |error: &dyn std::fmt::Display| {
            Error::Failed(format!("no daemon can be spoken to at {}: {error}", args.at))
        };
        let mut request =
            format!("ws://{}/ws", args.at).into_client_request().map_err(|error| wrong(&error))?;
        if let Some(token) = &args.token {
            let value = HeaderValue::from_str(&format!("Bearer {token}"))
                .map_err(|_| Error::Usage("--token: a secret has visible characters only".into()))?;
            request.headers_mut().insert("authorization", value);
        }
        let (socket, _) = connect_async(request).await.map_err(|error| wrong(&error))?;
        Ok(Self(socket))
    }

    async fn send(&mut self, request: &Value) -> Result<(), Error> {
        self.0.send(Message::text(request.to_string())).await.map_err(gone)
    }

    async fn next(&mut self) -> Result<Value, Error> {
        loop {
            match self.0.next().await {
                Some(Ok(Message::Text(text))) => return serde_json::from_str(&text).map_err(Error::failed),
                Some(Ok(Message::Close(_))) | None => return Err(Error::failed("the daemon has gone away")),
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(gone(error)),
            }
        }
    }
}

fn gone(error: tungstenite::Error) -> Error {
    Error::Failed(format!("the daemon has gone away: {error}"))
}
