//! `posed replay --pty`: the recorded bytes on pseudo-terminals, for other programs to read.
//!
//! Every device of the recording gets a port that speaks when the device spoke. It does not listen: what a driver
//! sends is read and thrown away, the recorded answers come when they came.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use posed_daemon::StageClock;
use posed_recording::{Item, Reader};
use posed_simulator::pty::Speaker;
use posed_stage::input::Input;
use serde::Serialize;

use super::end::End;
use super::run::block_on;
use super::{Error, print, print_json};

/// A port to open.
#[derive(Serialize)]
struct Port {
    name: String,
    port: String,
}

/// All ports.
#[derive(Serialize)]
struct Answer {
    devices: Vec<Port>,
}

pub(crate) fn run(recording: &Path, speed: f64, json: bool) -> Result<(), Error> {
    let reader = Reader::open(recording).map_err(Error::failed)?;
    let folder = tempfile::Builder::new()
        .prefix("posed-")
        .tempdir()
        .map_err(|error| Error::Failed(format!("cannot make a folder for the ports: {error}")))?;
    block_on(async {
        let mut end = End::new(None)?;
        tokio::select! {
            () = end.wait() => Ok(()),
            served = serve(reader, folder.path(), speed, json) => served,
        }
    })
}

async fn serve(
    mut reader: Reader<std::io::BufReader<std::fs::File>>,
    folder: &Path,
    speed: f64,
    json: bool,
) -> Result<(), Error> {
    let failed = |error: std::io::Error| Error::Failed(format!("cannot make a pseudo-terminal: {error}"));
    let mut ptys = BTreeMap::new();
    let mut answer = Answer { devices: Vec::new() };
    for (index, name) in (0u16..).zip(&reader.header().devices) {
        let link = folder.join(format!("{index}"));
        ptys.insert(index, Speaker::open(&link).map_err(failed)?);
        answer.devices.push(Port { name: name.clone(), port: link.to_string_lossy().into_owned() });
    }
    if json {
        print_json(&answer)?;
    } else {
        for device in &answer.devices {
            print(&format!("{}: {}\n", device.name, device.port))?;
        }
    }
    let clock = StageClock::start();
    let begun = reader.header().begun;
    for item in &mut reader {
        let Item::Entry(entry) = item.map_err(Error::failed)? else { continue };
        let Input::Bytes { device, bytes } = entry.input else { continue };
        let due_s = entry.t.seconds_since(begun) / speed;
        let wait_s = due_s - clock.now().as_secs_f64();
        if wait_s > 0.0 {
            pause(wait_s).await;
        }
        if let Some(pty) = ptys.get_mut(&device) {
            // Nobody has opened the port, or reads too slowly: a serial line loses bytes then, too.
            let _ = pty.write(&bytes);
        }
    }
    if !json {
        print("the recording ends here\n")?;
    }
    Ok(())
}

#[expect(clippy::disallowed_methods, reason = "bytes are written when they were read")]
async fn pause(seconds: f64) {
    tokio::time::sleep(Duration::from_secs_f64(seconds)).await;
}
