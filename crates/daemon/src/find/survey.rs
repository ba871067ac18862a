//! Asks ports what is there: each at one rate after the other, for one kind of device after the other.

use std::io;
use std::time::Duration;

use tokio::task::JoinSet;

use super::{ANNOUNCED, Answer, Kind, announcements, ask, open_imus, radio_trackers, slimevr_trackers};
use crate::clock::StageClock;
use posed_drivers::flock::Family;
use posed_drivers::flock::examine::Failure;
use posed_drivers::port::{self, Options, PortError, UsbUnit};
use posed_protocol::{FoundPort, FoundSensor};
use posed_stage::PortAddress;

/// How long all questions together may take.
pub const LIMIT: Duration = Duration::from_millis(26_500);
/// Longest that one question to a line takes, a Flock's reset apart.
const QUESTION: Duration = Duration::from_millis(1600);

/// How long a receiver on USB is listened to: it names all that it knows within a second.
const LISTENED: Duration = Duration::from_millis(1000);
/// How long a unit on USB is asked.
const UNIT: Duration = Duration::from_secs(4);

/// What to ask for.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted {
    /// At this line rate only, bit/s.
    pub baud: Option<u32>,
    /// For this kind only.
    pub kind: Option<Kind>,
}

/// Asks all ports side by side, none longer than `limit`; the reports keep the order of the ports. `each` gets the place of every one that
/// has answered, and its report, as it comes.
pub async fn ports(
    ports: Vec<String>,
    wanted: Wanted,
    limit: Duration,
    mut each: impl FnMut(usize, &FoundPort),
) -> Vec<FoundPort> {
    let late = |port: &String| FoundPort {
        port: port.clone(),
        problem: Some("no answer in time".to_owned()),
        fix: Some("ask again at one rate with --baud RATE, or for one device with --driver".to_owned()),
        ..FoundPort::default()
    };
    let mut reports: Vec<FoundPort> = ports.iter().map(late).collect();
    let mut asked = JoinSet::new();
    for (index, port) in ports.into_iter().enumerate() {
        asked.spawn(async move { (index, tokio::time::timeout(limit, one(&port, wanted, limit)).await) });
    }
    while let Some(joined) = asked.join_next().await {
        if let Ok((index, answered)) = joined {
            if let Ok(report) = answered {
                reports[index] = report;
            }
            each(index, &reports[index]);
        }
    }
    reports
}

/// Units that announce themselves on the network, trackers that look for a server, those that receivers on USB know, and units on USB.
pub async fn network() -> Vec<FoundPort> {
    let (units, trackers, open) = tokio::join!(
        announcements(ANNOUNCED),
        slimevr_trackers(ANNOUNCED + ANNOUNCED),
        open_imus(ANNOUNCED + ANNOUNCED)
    );
    let mut reports: Vec<FoundPort> = units
        .unwrap_or_default()
        .into_iter()
        .map(|unit| FoundPort {
            port: unit.port(),
            local_port: Some(unit.sends_to).filter(|port| *port > 0),
            driver: Some("x-imu3".to_owned()),
            model: Some(format!("x-IMU3 {:?}", unit.name)),
            sensors: vec![FoundSensor { address: 0, serial: Some(unit.serial) }],
            ..FoundPort::default()
        })
        .collect();
    // Where the port is taken, a server serves them already.
    let trackers = trackers.unwrap_or_default();
    if !trackers.is_empty() {
        let sensors = (1..).zip(trackers).map(|(n, mac)| FoundSensor { address: n, serial: Some(mac) });
        reports.push(FoundPort {
            port: "udp://0.0.0.0:6969".to_owned(),
            driver: Some("slimevr".to_owned()),
            sensors: sensors.collect(),
            ..FoundPort::default()
        });
    }
    for (port, heard) in open {
        let Some(identity) = heard.identity() else { continue };
        let answer = Answer { identity, addressing: None, family: None };
        reports.push(found(&format!("udp://0.0.0.0:{port}"), Kind::OpenImu, 0, answer));
    }
    for port in port::receivers() {
        reports.push(receiver(&port).await);
    }
    reports.extend(units_on_usb().await);
    reports
}

/// Units that have a USB port of their own.
async fn units_on_usb() -> Vec<FoundPort> {
    let wanted = Wanted { baud: None, kind: Some(Kind::Polhemus) };
    let fix = "install the maker's driver for Linux, whose udev rule loads it, and plug the unit in again; or use its serial port";
    let mut reports = Vec::new();
    for UsbUnit { port, needs_firmware } in port::usb_units().await {
        reports.push(if needs_firmware {
            let problem = Some("the unit waits for its firmware".to_owned());
            FoundPort { port, problem, fix: Some(fix.to_owned()), ..FoundPort::default() }
        } else {
            one(&port, wanted, UNIT).await
        });
    }
    reports
}

/// What a receiver on USB knows.
async fn receiver(port: &str) -> FoundPort {
    let trackers = match radio_trackers(port, LISTENED).await {
        Ok(trackers) => trackers,
        Err(error) => return refused(port, &error),
    };
    let problem = trackers.is_empty().then(|| "the receiver says nothing".to_owned());
    let fix = "pair a tracker with it (`pair` on its serial console), and end other programs that read it";
    let sensors = (1..).zip(trackers).map(|(n, mac)| FoundSensor { address: n, serial: Some(mac) });
    FoundPort {
        port: port.to_owned(),
        driver: Some("slimevr".to_owned()),
        model: Some("receiver".to_owned()),
        sensors: sensors.collect(),
        fix: problem.is_some().then(|| fix.to_owned()),
        problem,
        ..FoundPort::default()
    }
}

/// The questions to a port, in their order: the likeliest rates of every kind first.
fn questions(port: &str, wanted: Wanted) -> Vec<(Kind, u32)> {
    let network = port.contains("://");
    let kinds: Vec<Kind> = match wanted.kind {
        Some(kind) => vec![kind],
        None if port.starts_with("udp://") && port.ends_with(":5000") => vec![Kind::MotionStar],
        None if port.starts_with("udp://") || port.ends_with(":7000") => vec![Kind::XImu3],
        None if network && port.ends_with(":6000") => vec![Kind::MotionStar],
        None if network && port.ends_with(":3883") => vec![Kind::Vrpn],
        None => Kind::SERIAL.to_vec(),
    };
    let rates = |kind: Kind| match wanted.baud {
        Some(baud) => vec![baud],
        // A device on the network has one rate, set where the line is.
        None if network => vec![115_200],
        None => kind.bauds().to_vec(),
    };
    let most = kinds.iter().map(|kind| rates(*kind).len()).max().unwrap_or(0);
    let mut questions: Vec<(Kind, u32)> = (0..most)
        .flat_map(|n| kinds.iter().filter_map(move |kind| Some((*kind, *rates(*kind).get(n)?))))
        .collect();
    // A Flock's questions take longest: its rarest rates come last.
    questions.sort_by_key(|(kind, baud)| *kind == Kind::Flock && *baud < 9600);
    questions
}

/// Asks one port until something answers.
async fn one(port: &str, wanted: Wanted, limit: Duration) -> FoundPort {
    if port.parse::<PortAddress>().is_ok_and(|address| address.is_receiver()) {
        return receiver(port).await;
    }
    let questions = questions(port, wanted);
    let first = questions.first().map_or(115_200, |(_, baud)| *baud);
    let mut line = match port::open(port, Options::baud(first)).await {
        Ok(line) => line,
        Err(error) => return refused(port, &error),
    };
    let clock = StageClock::start();
    let mut failure = Failure::Silent;
    let mut tried: Vec<(Kind, u32)> = Vec::new();
    for (kind, baud) in questions {
        if Duration::from_secs_f64(clock.now().as_secs_f64().max(0.0)) + QUESTION > limit {
            break;
        }
        let answer = match line.set_baud(baud) {
            Ok(()) => ask(&mut line, kind, tried.is_empty()).await,
            Err(error) => Err(error),
        };
        match answer {
            Ok(Ok(answer)) => return found(port, kind, baud, answer),
            // Bytes at one rate say more than silence at the others.
            Ok(Err(Failure::Silent)) => {}
            Ok(Err(other)) => failure = other,
            Err(error) => return lost(port, &error),
        }
        tried.push((kind, baud));
    }
    nothing(port, &tried, failure)
}

fn found(port: &str, kind: Kind, baud: u32, answer: Answer) -> FoundPort {
    let identity = answer.identity;
    let sensors = identity.sensors.into_iter();
    let (problem, fix) = identity.problem.unzip();
    FoundPort {
        port: port.to_owned(),
        driver: Some(kind.word().to_owned()),
        revision: identity.revision,
        model: identity.model,
        baud: (!port.contains("://")).then_some(baud),
        addressing: answer.addressing,
        family: answer.family.filter(|family| *family != Family::Flock),
        rate_hz: identity.rate_hz,
        sensors: sensors.map(|info| FoundSensor { address: info.address, serial: info.serial }).collect(),
        problem,
        fix,
        ..FoundPort::default()
    }
}

fn nothing(port: &str, tried: &[(Kind, u32)], failure: Failure) -> FoundPort {
    let mut bauds: Vec<u32> = Vec::new();
    for (_, baud) in tried {
        if !bauds.contains(baud) {
            bauds.push(*baud);
        }
    }
    let rates = match bauds.as_slice() {
        _ if port.contains("://") => String::new(),
        [] => String::new(),
        [only] => format!(" at {only} baud"),
        [..] => {
            let rates: Vec<String> = bauds.iter().map(ToString::to_string).collect();
            format!(" at any rate ({} baud)", rates.join(", "))
        }
    };
    let (problem, fix) = match failure {
        Failure::Silent => (
            format!("nothing answers{rates}"),
            "check that the device has power and the cable; on a Flock of Birds that its FLY switch (8) is up, that its \
             baud switches (1 to 3) are not all up, and that the cable is a straight one, whose RTS wire must not be held \
             high, for that keeps the unit in reset",
        ),
        Failure::Unintelligible => (
            format!("bytes come in, but no answer that a known device would give{rates}"),
            "check that this is the tracker's port, that no other program uses it, and that the device is at one of the \
             rates asked (a Flock's baud switches 1 to 3); then switch it off and on",
        ),
        Failure::DoesNotStop => (
            format!("bytes keep coming, although the stop command{rates}"),
            "check the line from the computer to the unit (pin 3 of the cable), and switch the unit off and on",
        ),
    };
    FoundPort {
        port: port.to_owned(),
        problem: Some(problem),
        fix: Some(fix.to_owned()),
        ..FoundPort::default()
    }
}

fn refused(port: &str, error: &PortError) -> FoundPort {
    let (problem, fix) = match error {
        PortError::Missing { .. } => (
            "there is no such port".to_owned(),
            "check the cable and the adapter; `posed doctor` without a port lists those there are",
        ),
        PortError::NotAllowed { .. } => (
            "this user may not open the port".to_owned(),
            "join the group dialout (sudo usermod -aG dialout $USER), then log in again",
        ),
        PortError::ReceiverNotAllowed { .. } => (
            "this user may not open the receiver".to_owned(),
            "install packaging/60-posed.rules in /etc/udev/rules.d, join the group dialout, and plug it in again",
        ),
        PortError::Busy { .. } => ("another program has the port open".to_owned(), "end that program"),
        PortError::Unreachable { source, .. } => (
            format!("the device server cannot be reached: {source}"),
            "check the address, and that the server runs",
        ),
        PortError::Other { reason, .. } => (
            format!("the port cannot be opened: {reason}"),
            "there may be no hardware behind it; try another port",
        ),
    };
    FoundPort {
        port: port.to_owned(),
        problem: Some(problem),
        fix: Some(fix.to_owned()),
        ..FoundPort::default()
    }
}

fn lost(port: &str, error: &io::Error) -> FoundPort {
    FoundPort {
        port: port.to_owned(),
        problem: Some(format!("the port failed: {error}")),
        fix: Some("check the adapter and its cable; there may be no hardware behind this port".to_owned()),
        ..FoundPort::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_baud_of_every_kind_is_tried_and_the_likeliest_first() {
        let in_order = questions("/dev/ttyUSB0", Wanted::default());
        assert_eq!(in_order.len(), Kind::SERIAL.iter().map(|kind| kind.bauds().len()).sum::<usize>());
        let first: Vec<Kind> = in_order[..Kind::SERIAL.len()].iter().map(|(kind, _)| *kind).collect();
        assert_eq!(first, Kind::SERIAL);
        assert_eq!(in_order.last(), Some(&(Kind::Flock, 2400)));
        let star = questions("tcp://10.0.0.2:6000", Wanted::default());
        assert_eq!(star, [(Kind::MotionStar, 115_200)]);
        assert_eq!(questions("tcp://mocap:3883", Wanted::default()), [(Kind::Vrpn, 115_200)]);
        let one = Wanted { baud: Some(9600), kind: Some(Kind::Fastrak) };
        assert_eq!(questions("/dev/ttyS0", one), [(Kind::Fastrak, 9600)]);
    }
}
