//! `posed body calibrate`: the guided calibration of a running daemon, in a terminal.
//!
//! In: the daemon's websocket. Out: what to do next, a line each, and in the end how well every sensor's mounting shows. It decides
//! nothing: the daemon notices what was done, and uses what it finds. Ctrl-C cancels.

use clap::builder::{PossibleValuesParser, TypedValueParser as _};
use posed_client::{
    Call, Choice, Client, Error as ClientError, Job, JobState, ServerMessage, Started, Topic,
};
use posed_fusion::body::Thoroughness;

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
    #[arg(long, value_parser = PossibleValuesParser::new(["quick", "full", "movement", "assign"]).try_map(thoroughness), default_value = "full")]
    how: Thoroughness,
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

pub(super) fn run(args: &Calibrate) -> Result<(), Error> {
    block_on(async {
        // A daemon that begins anew knows nothing of the job.
        let mut daemon =
            Client::connect(&args.at, args.token.as_deref()).await.map_err(error)?.without_reconnection();
        daemon.subscribe(Choice::of([Topic::Jobs])).await.map_err(error)?;
        let call = Call::BodyCalibrate { how: Some(args.how), body: args.body.clone() };
        let Started { job: number } = daemon.request(&call).await.map_err(error)?;
        let mut end = End::new(None)?;
        let mut reported = String::new();
        loop {
            let message = tokio::select! {
                message = daemon.next() => message.map_err(error)?,
                () = end.wait() => {
                    daemon.request::<()>(&Call::JobCancel { job: number }).await.map_err(error)?;
                    continue;
                }
            };
            let ServerMessage::Jobs(jobs) = message else { continue };
            let Some(job) = jobs.body.jobs.into_iter().find(|job| job.job == number) else { continue };
            if job.state != JobState::Running {
                return outcome(args, job);
            }
            if let Some(sentence) = job.message.filter(|sentence| *sentence != reported) {
                emit(args, &sentence)?;
                reported = sentence;
            }
        }
    })
}

/// As requests have it.
fn thoroughness(how: String) -> Result<Thoroughness, serde_json::Error> {
    serde_json::from_value(how.into())
}

/// What the daemon refuses or does not answer.
fn error(error: ClientError) -> Error {
    match error {
        ClientError::Token => Error::Usage(format!("--token: {error}")),
        ClientError::Address(_) => Error::Usage(format!("--at: {error}")),
        error => Error::failed(error),
    }
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
