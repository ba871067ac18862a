//! `posed demo` with 37 birds more.

use std::ffi::OsStr;
use std::fmt::Write;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

const DEMO: &str = include_str!("../../config/demo.toml");
const BIRDS: u32 = 37;

/// A daemon that serves; killed when dropped.
pub(crate) struct Served {
    child: Child,
    pub(crate) url: String,
    _folder: tempfile::TempDir,
}

impl Served {
    /// `posed demo` as it is.
    pub(crate) fn demo() -> Self {
        Self::spawn(tempfile::tempdir().unwrap(), &["demo".as_ref()])
    }

    pub(crate) fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        posed_rig::copy_demo(folder.path());
        let path = folder.path().join("stage.toml");
        std::fs::write(&path, text()).unwrap();
        Self::spawn(folder, &["demo".as_ref(), "--stage".as_ref(), path.as_os_str()])
    }

    /// `posed replay` of a take.
    pub(crate) fn replay(take: &Path) -> Self {
        let take = std::fs::canonicalize(take).unwrap();
        Self::spawn(tempfile::tempdir().unwrap(), &["replay".as_ref(), take.as_os_str()])
    }

    fn spawn(folder: tempfile::TempDir, command: &[&OsStr]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_posed"))
            .args(command)
            .args(["--listen", "127.0.0.1:0"])
            .current_dir(folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.split_whitespace().find(|word| word.starts_with("http://"));
        Self {
            child,
            url: url.unwrap_or_else(|| panic!("no address in {line:?}")).to_owned(),
            _folder: folder,
        }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The demo's stage file with the birds in it.
fn text() -> String {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut devices = format!(
        "[[device]]\nname = \"star\"\ndriver = \"motionstar\"\nport = \"tcp://127.0.0.1:{port}\"\n\n"
    );
    let mut simulated = String::new();
    for bird in 0..BIRDS {
        let address = bird + 2;
        writeln!(devices, "[[sensor]]\nname = \"bird-{bird}\"\ndevice = \"star\"\naddress = {address}\n")
            .unwrap();
        let place = |step: f64, n: u32| step * f64::from(n);
        let (x, y, z) = (0.4 + place(0.1, bird % 6), place(0.2, bird / 6) - 0.5, 1.2 + place(0.05, bird % 4));
        writeln!(
            simulated,
            "[[simulation.body]]\nname = \"b{bird}\"\n[simulation.body.motion]\nkind = \"orbit\"\n\
             center_m = [{x:.2}, {y:.2}, {z:.2}]\nradius_m = [0.05, 0.05, 0.03]\nperiod_s = {:.1}\n\n\
             [[simulation.sensor]]\nname = \"bird-{bird}\"\nbody = \"b{bird}\"\n",
            3.0 + place(0.3, bird),
        )
        .unwrap();
    }
    // Its fault map knows three trackers.
    let demo: String = DEMO.split_inclusive('\n').filter(|line| !line.starts_with("faults = ")).collect();
    let (stage, simulation) = demo.split_once("[simulation]").unwrap();
    format!("{stage}{devices}[simulation]{simulation}\n{simulated}")
}
