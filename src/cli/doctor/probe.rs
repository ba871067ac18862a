//! Asks ports what is there: the shell of IO and time around the drivers' probes.

use std::io;
use std::time::Duration;

use posed::daemon::clock::StageClock;
use posed_drivers::Output;
use posed_drivers::flock::examine::Failure;
use posed_drivers::flock::{Findings, Probe};
use posed_drivers::port::{self, Port, PortError, Stream};

use super::{PortReport, SensorReport};

/// Asks all ports side by side, none longer than `limit`; the reports keep the order of the ports.
pub(super) async fn all(ports: Vec<String>, bauds: &[u32], limit: Duration) -> Vec<PortReport> {
    let tasks: Vec<_> = ports
        .into_iter()
        .map(|port| {
            let bauds = bauds.to_vec();
            let task = tokio::spawn({
                let port = port.clone();
                async move { tokio::time::timeout(limit, one(&port, &bauds)).await }
            });
            (port, task)
        })
        .collect();
    let mut reports = Vec::new();
    for (port, task) in tasks {
        reports.push(match task.await {
            Ok(Ok(report)) => report,
            Ok(Err(_)) | Err(_) => PortReport {
                port,
                problem: Some("no answer in time".to_owned()),
                mend: Some("ask again at one rate with --baud RATE".to_owned()),
                ..PortReport::default()
            },
        });
    }
    reports
}

/// Asks one port at one rate after the other, until something answers.
async fn one(port: &str, bauds: &[u32]) -> PortReport {
    let first = bauds.first().copied().unwrap_or(115_200);
    let mut line = match port::open(port, first).await {
        Ok(line) => line,
        Err(error) => return refused(port, &error),
    };
    // A device server has one rate, set at the server.
    let bauds = if port.contains("://") { &bauds[..bauds.len().min(1)] } else { bauds };
    let mut failure = Failure::Silent;
    for (n, baud) in bauds.iter().enumerate() {
        let asked = match line.set_baud(*baud) {
            Ok(()) => ask(&mut line, n == 0).await,
            Err(error) => Err(error),
        };
        match asked {
            Ok(Ok(findings)) => return found(port, *baud, &findings),
            // Bytes at one rate say more than silence at the others.
            Ok(Err(Failure::Silent)) => {}
            Ok(Err(other)) => failure = other,
            Err(error) => return lost(port, &error),
        }
    }
    nothing(port, bauds, failure)
}

/// Drives one probe to its end.
async fn ask(line: &mut Port<Stream>, reset: bool) -> io::Result<Result<Findings, Failure>> {
    let clock = StageClock::start();
    let mut probe =
        if reset { Probe::new(clock.now(), line.modem_lines()) } else { Probe::without_reset(clock.now()) };
    let mut buffer = [0; 1024];
    loop {
        while let Some(output) = probe.poll_output() {
            match output {
                Output::Transmit(bytes) => line.write_all(&bytes).await?,
                Output::SetRts(asserted) => line.set_rts(asserted)?,
                Output::Sample(_) | Output::StateChanged | Output::Warning(_) => {}
            }
        }
        if let Some(result) = probe.result() {
            return Ok(result.cloned());
        }
        let deadline = clock.instant(probe.poll_timeout().unwrap_or(clock.now()));
        match tokio::time::timeout_at(deadline.into(), line.read(&mut buffer)).await {
            Ok(read) => probe.handle_bytes(clock.now(), &buffer[..read?]),
            Err(_) => probe.handle_timeout(clock.now()),
        }
    }
}

fn found(port: &str, baud: u32, findings: &Findings) -> PortReport {
    let (whole, fraction) = findings.revision;
    let sensors: Vec<SensorReport> =
        findings.sensors().into_iter().map(|address| SensorReport { address }).collect();
    let (problem, mend) = if sensors.is_empty() {
        let problem = "the units answer, but none of them has a sensor";
        let mend = "plug in the sensors, set the FLY switch (8) of each unit, and switch them off and on";
        (Some(problem.to_owned()), Some(mend.to_owned()))
    } else {
        (None, None)
    };
    PortReport {
        port: port.to_owned(),
        driver: Some("flock-of-birds"),
        revision: Some(format!("{whole}.{fraction:02}")),
        model: (!findings.model.is_empty()).then(|| findings.model.clone()),
        baud: (!port.contains("://")).then_some(baud),
        addressing: Some(findings.addressing),
        rate_hz: Some(findings.rate_hz),
        sensors,
        problem,
        mend,
    }
}

fn nothing(port: &str, bauds: &[u32], failure: Failure) -> PortReport {
    let rates = match bauds {
        [] => String::new(),
        [only] => format!(" at {only} baud"),
        [..] => {
            let rates: Vec<String> = bauds.iter().map(ToString::to_string).collect();
            format!(" at any rate ({} baud)", rates.join(", "))
        }
    };
    let (problem, mend) = match failure {
        Failure::Silent => (
            format!("nothing answers{rates}"),
            "check that the unit has power and its lamp is on, that its FLY switch (8) is up, that its baud switches \
             (1 to 3) are not all up, and the cable: a straight one, whose RTS wire must not be held high, for that \
             keeps the unit in reset",
        ),
        Failure::Unintelligible => (
            format!("bytes come in, but no answer that a Flock of Birds would give{rates}"),
            "check that this is the tracker's port, that no other program uses it, and that the unit's baud switches (1 to \
             3) are at one of the rates asked; then switch the unit off and on",
        ),
        Failure::DoesNotStop => (
            format!("bytes keep coming, although the stream was told to stop{rates}"),
            "check the line from the computer to the unit (pin 3 of the cable), and switch the unit off and on",
        ),
    };
    PortReport {
        port: port.to_owned(),
        problem: Some(problem),
        mend: Some(mend.to_owned()),
        ..PortReport::default()
    }
}

fn refused(port: &str, error: &PortError) -> PortReport {
    let (problem, mend) = match error {
        PortError::Missing { .. } => (
            "there is no such port".to_owned(),
            "check the cable and the adapter; `posed doctor` without a port lists those there are",
        ),
        PortError::NotAllowed { .. } => (
            "this user may not open the port".to_owned(),
            "join the group dialout (sudo usermod -aG dialout $USER), then log in again",
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
    PortReport {
        port: port.to_owned(),
        problem: Some(problem),
        mend: Some(mend.to_owned()),
        ..PortReport::default()
    }
}

fn lost(port: &str, error: &io::Error) -> PortReport {
    PortReport {
        port: port.to_owned(),
        problem: Some(format!("the port failed: {error}")),
        mend: Some("check the adapter and its cable; there may be no hardware behind this port".to_owned()),
        ..PortReport::default()
    }
}
