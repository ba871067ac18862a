//! What a running daemon shows in the terminal: one clear line with the address, then one that lives.

use std::io::{self, IsTerminal};
use std::net::SocketAddr;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use posed_daemon::PartEnded;
use posed_protocol::{LinkState, Status};
use tokio::sync::watch;

use super::end::End;
use super::service::Manager;
use super::{Error, print};

/// Prints the address, then keeps a status line up to date until the end. The line goes to stderr, and only where
/// a person looks at it.
pub(crate) async fn until_end(
    url: &str,
    status: watch::Receiver<Status>,
    part_ended: watch::Receiver<Option<PartEnded>>,
    duration_s: Option<f64>,
) -> Result<(), Error> {
    until_end_with(url, status, part_ended, duration_s, in_words).await
}

/// The same for anything that can be put into one line.
pub(crate) async fn until_end_with<T>(
    url: &str,
    mut status: watch::Receiver<T>,
    mut part_ended: watch::Receiver<Option<PartEnded>>,
    duration_s: Option<f64>,
    in_words: impl Fn(&T) -> String,
) -> Result<(), Error> {
    let mut end = End::new(duration_s)?;
    print(&format!("posed is running: open {url} (Ctrl-C ends it)\n"))?;
    let line = io::stderr().is_terminal().then(spinner).transpose()?;
    let mut manager = Manager::ready();
    let ended = loop {
        tokio::select! {
            () = end.wait() => break Ok(()),
            // Somebody starts it again who sees that it has failed.
            Ok(part) = part_ended.wait_for(Option::is_some) => {
                break part.as_ref().map_or(Ok(()), |part| Err(Error::Failed(part.to_string())));
            }
            changed = status.changed() => {
                if changed.is_err() {
                    break Err(Error::Failed("what makes the status ended by itself; the log says why above, please report it".into()));
                }
                let status = status.borrow_and_update();
                manager.alive(|| in_words(&status));
                if let Some(line) = &line {
                    line.set_message(in_words(&status));
                }
            }
        }
    };
    manager.stopping();
    if let Some(line) = line {
        line.finish_and_clear();
    }
    ended
}

/// Says where programs that speak VRPN find the sensors, if the stage serves them.
pub(crate) fn announce(vrpn: Option<SocketAddr>) -> Result<(), Error> {
    vrpn.map_or(Ok(()), |address| print(&format!("VRPN programs find every sensor as NAME@{address}\n")))
}

fn spinner() -> Result<ProgressBar, Error> {
    let line = ProgressBar::new_spinner();
    line.set_style(ProgressStyle::with_template("{spinner} {wide_msg}").map_err(Error::failed)?);
    line.enable_steady_tick(Duration::from_millis(250));
    Ok(line)
}

/// The status in one line.
fn in_words(status: &Status) -> String {
    let mut parts = Vec::new();
    for device in &status.devices {
        parts.push(match (device.state, device.rate_hz, &device.reason) {
            (LinkState::Streaming, Some(rate_hz), _) => format!("{} {rate_hz:.1} Hz", device.name),
            (LinkState::Streaming, None, _) => format!("{} streaming", device.name),
            (_, _, Some(reason)) => format!("{}: {reason}", device.name),
            (_, _, None) => format!("{} connecting", device.name),
        });
    }
    let lost: u64 = status.sensors.iter().map(|sensor| sensor.lost).sum();
    if lost > 0 {
        parts.push(format!("{lost} samples lost"));
    }
    if let Some(recording) = &status.recording {
        parts.push(format!("recording {} ({:.1} MB)", recording.name, recording.bytes as f64 * 1e-6));
    }
    if let Some(replay) = &status.replay {
        parts.push(match &replay.ended {
            Some(reason) => format!("{}: {reason}", replay.name),
            None => format!("{} at {:.1} of {:.1} s", replay.name, replay.t_s, replay.end_s),
        });
    }
    parts.extend(status.problems.iter().map(|problem| problem.message.clone()));
    parts.push(match status.clients {
        1 => "1 client".to_owned(),
        clients => format!("{clients} clients"),
    });
    parts.join(" · ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_protocol::DeviceStatus;

    #[test]
    fn an_ill_device_says_why() {
        let device = |name: &str, state, reason: Option<&str>, rate_hz| DeviceStatus {
            name: name.into(),
            state,
            reason: reason.map(Into::into),
            rate_hz,
            ..DeviceStatus::default()
        };
        let status = Status {
            devices: vec![
                device("flock", LinkState::Streaming, None, Some(103.31)),
                device("star", LinkState::Silent, Some("check the FLY switch"), None),
            ],
            ..Status::default()
        };
        assert_eq!(in_words(&status), "flock 103.3 Hz · star: check the FLY switch · 0 clients");
    }
}
