//! Commands around virtual devices in real time: `simulate` and `doctor`.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};

use posed_stage::Stage;
use serde_json::Value;

use crate::cli::{json, posed};

/// A running `posed simulate`.
pub(crate) struct Simulation {
    child: Child,
    devices: Value,
}

impl Simulation {
    pub(crate) fn start(stage: &Path, more: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_posed"))
            .arg("simulate")
            .arg(stage)
            .arg("--json")
            .args(more)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let devices = serde_json::from_str::<Value>(&line).unwrap()["devices"].clone();
        Self { child, devices }
    }

    pub(crate) fn port(&self) -> String {
        self.devices[0]["port"].as_str().unwrap().to_owned()
    }

    pub(crate) fn interrupt(mut self) -> ExitStatus {
        let killed = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap();
        assert!(killed.success());
        self.child.wait().unwrap()
    }
}

impl Drop for Simulation {
    fn drop(&mut self) {
        // Only of use where a test has failed: `interrupt` has waited otherwise.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A stage with two birds in group mode that are awake at once.
fn stage(folder: &Path, baud: u32) -> PathBuf {
    let path = folder.join("stage.toml");
    let text = format!(
        "name = \"test\"\n\
         [[device]]\nname = \"flock\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\nbaud = {baud}\n\
         [[sensor]]\nname = \"a\"\ndevice = \"flock\"\naddress = 1\n\
         [[sensor]]\nname = \"b\"\ndevice = \"flock\"\naddress = 2\n\
         [[simulation.device]]\nname = \"flock\"\nboot_ms = 0.0\n"
    );
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_simulation_ends_at_an_interrupt_with_the_truth_complete() {
    let folder = tempfile::tempdir().unwrap();
    let truth = folder.path().join("truth.csv");
    let stage = stage(folder.path(), 115_200);
    let simulation = Simulation::start(&stage, &["--truth", truth.to_str().unwrap()]);
    assert_eq!(simulation.devices[0]["name"], "flock");
    assert_eq!(simulation.devices[0]["driver"], "flock-of-birds");
    let port = simulation.port();
    assert!(Path::new(&port).exists());
    // The device answers, so it has measured something by the time it is interrupted.
    assert!(posed(["doctor", &port, "--json"]).status.success());
    assert_eq!(simulation.interrupt().code(), Some(0));
    assert!(fs::symlink_metadata(&port).is_err(), "the link to the port is left behind");

    let text = fs::read_to_string(&truth).unwrap();
    let mut lines = text.lines();
    assert!(lines.next().unwrap().starts_with("# epoch_utc = "));
    assert_eq!(lines.next(), Some("t,sensor,x,y,z,qw,qx,qy,qz,class,distortion_x,distortion_y,distortion_z"));
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    assert!(text.ends_with('\n') && rows.len() >= 2);
    // Each cycle has a row for each sensor, the last one too.
    for cycle in rows.chunks(2) {
        assert_eq!((cycle[0].len(), cycle[1].len()), (13, 13));
        assert_eq!((cycle[0][0], cycle[0][1], cycle[1][1]), (cycle[1][0], "a", "b"));
    }
}

/// A port number that nobody listens at just now.
fn free_port() -> u16 {
    std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

#[test]
fn many_devices_are_served_each_at_its_port_with_one_truth() {
    let folder = tempfile::tempdir().unwrap();
    let truth = folder.path().join("truth.csv");
    let path = folder.path().join("stage.toml");
    // SlimeVR trackers call here.
    let server = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let calls = format!("udp://127.0.0.1:{}", server.local_addr().unwrap().port());
    let (star, unit) =
        (format!("tcp://127.0.0.1:{}", free_port()), format!("udp://127.0.0.1:{}", free_port()));
    let mocap = format!("tcp://127.0.0.1:{}", free_port());
    let devices = [
        ("flock", "flock-of-birds", "auto", 1),
        ("chain", "xbus", "auto", 1),
        ("fast", "fastrak", "/dev/ttyUSB9", 1),
        ("liberty", "polhemus", "/dev/ttyUSB8", 1),
        ("wit", "witmotion", "/dev/ttyUSB7", 0),
        ("unit", "x-imu3", unit.as_str(), 0),
        ("slimes", "slimevr", calls.as_str(), 1),
        ("star", "motionstar", star.as_str(), 2),
        ("mocap", "vrpn", mocap.as_str(), 1),
    ];
    let mut text = String::from("name = \"many\"\n");
    for (name, driver, port, address) in devices {
        let settings = if driver == "vrpn" { "trackers = [\"Head\"]\n" } else { "" };
        text += &format!(
            "[[device]]\nname = \"{name}\"\ndriver = \"{driver}\"\nport = \"{port}\"\n{settings}\
             [[sensor]]\nname = \"on {name}\"\ndevice = \"{name}\"\naddress = {address}\n"
        );
    }
    fs::write(&path, text).unwrap();
    let simulation = Simulation::start(&path, &["--truth", truth.to_str().unwrap()]);
    for (k, (name, driver, port, _)) in devices.into_iter().enumerate() {
        let device = &simulation.devices[k];
        assert_eq!((&device["name"], &device["driver"]), (&name.into(), &driver.into()));
        let served = device["port"].as_str().unwrap();
        if port.contains("://") { assert_eq!(served, port) } else { assert!(Path::new(served).exists()) }
    }
    // The trackers call, and the star can be reached.
    let mut call = [0; 128];
    let (len, _) = server.recv_from(&mut call).unwrap();
    assert_eq!(call[..len].first_chunk(), Some(&[0, 0, 0, 3]));
    std::net::TcpStream::connect(star.strip_prefix("tcp://").unwrap()).unwrap();
    assert_eq!(simulation.interrupt().code(), Some(0));
    let text = fs::read_to_string(&truth).unwrap();
    for (name, ..) in devices {
        assert!(text.contains(&format!(",on {name},")), "no truth of {name}");
    }
}

#[test]
fn a_simulation_ends_after_its_duration() {
    let folder = tempfile::tempdir().unwrap();
    let stage = stage(folder.path(), 115_200);
    let output = posed(["simulate".as_ref(), stage.as_os_str(), "--duration-s".as_ref(), "0.2".as_ref()]);
    assert_eq!(output.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&output.stdout).contains("flock: flock-of-birds at /"));
    let none = posed(["simulate", "/no/such/stage.toml"]);
    assert_eq!(none.status.code(), Some(1));
}

#[test]
fn doctor_finds_a_flock_at_its_rate_and_writes_a_stage_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let simulation = Simulation::start(&stage(folder.path(), 38_400), &[]);
    let port = simulation.port();
    let written = folder.path().join("written.toml");
    let output = posed(["doctor", &port, "--json", "--write-stage", written.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let found = json(&output)["ports"][0].clone();
    assert_eq!((&found["port"], &found["driver"]), (&port.as_str().into(), &"flock-of-birds".into()));
    assert_eq!((&found["revision"], &found["baud"]), (&"3.67".into(), &38_400.into()));
    assert_eq!(found["sensors"], serde_json::json!([{ "address": 1 }, { "address": 2 }]));
    assert!(found["problem"].is_null() && found["fix"].is_null());

    assert!(posed(["check".as_ref(), written.as_os_str()]).status.success());
    let loaded = Stage::load(&written).unwrap();
    assert_eq!((loaded.devices[0].baud, loaded.sensors.len()), (38_400, 2));
    // A file that is there is not touched, and nobody is asked.
    fs::write(&written, "mine").unwrap();
    let refused = posed(["doctor", &port, "--write-stage", written.to_str().unwrap()]);
    assert_eq!((refused.status.code(), refused.stdout.len()), (Some(1), 0));
    assert_eq!(fs::read_to_string(&written).unwrap(), "mine");
    assert_eq!(simulation.interrupt().code(), Some(0));
}

#[test]
fn doctor_lists_the_trackers_of_a_vrpn_server_and_writes_a_stage_for_them() {
    let folder = tempfile::tempdir().unwrap();
    let (path, written) = (folder.path().join("stage.toml"), folder.path().join("written.toml"));
    let port = format!("tcp://127.0.0.1:{}", free_port());
    let text = format!(
        "name = \"test\"\n\
         [[device]]\nname = \"cameras\"\ndriver = \"vrpn\"\nport = \"{port}\"\ntrackers = [\"Head\", \"Wand\"]\n\
         [[sensor]]\nname = \"a\"\ndevice = \"cameras\"\naddress = 1\n\
         [[sensor]]\nname = \"b\"\ndevice = \"cameras\"\naddress = 258\n\
         [[simulation.device]]\nname = \"cameras\"\nboot_ms = 0.0\n"
    );
    fs::write(&path, text).unwrap();
    let simulation = Simulation::start(&path, &[]);
    let args = ["doctor", &port, "--driver", "vrpn", "--json", "--write-stage", written.to_str().unwrap()];
    let output = posed(args);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let found = json(&output)["ports"][0].clone();
    assert_eq!((&found["driver"], &found["revision"]), (&"vrpn".into(), &"07.38".into()));
    let sensors =
        serde_json::json!([{ "address": 1, "serial": "Head" }, { "address": 258, "serial": "Wand" }]);
    assert_eq!(found["sensors"], sensors);
    assert!(found["problem"].is_null(), "{found}");
    let of = |path: &Path| Stage::load(path).unwrap().devices[0].driver.clone();
    assert_eq!(of(&written), of(&path));
    assert_eq!(simulation.interrupt().code(), Some(0));
}

#[test]
fn doctor_finds_a_liberty_a_witmotion_sensor_and_a_3d_guidance_unit_and_writes_stages_for_them() {
    let folder = tempfile::tempdir().unwrap();
    let guidance = "family = \"3d-guidance\"\n";
    for (driver, settings, addresses) in
        [("polhemus", "", &[1, 3][..]), ("witmotion", "", &[0]), ("flock-of-birds", guidance, &[1, 3])]
    {
        let (path, written) =
            (folder.path().join("stage.toml"), folder.path().join(format!("{driver}.toml")));
        let mut text = format!(
            "name = \"test\"\n[[device]]\nname = \"d\"\ndriver = \"{driver}\"\nport = \"/dev/none\"\n{settings}"
        );
        for address in addresses {
            text += &format!("[[sensor]]\nname = \"s{address}\"\ndevice = \"d\"\naddress = {address}\n");
        }
        text += "[[simulation.device]]\nname = \"d\"\nboot_ms = 0.0\n";
        fs::write(&path, text).unwrap();
        let simulation = Simulation::start(&path, &[]);
        // Among all kinds and rates: it is taken for nothing else.
        let output = posed([
            "doctor",
            &simulation.port(),
            "--baud",
            "115200",
            "--json",
            "--write-stage",
            written.to_str().unwrap(),
        ]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let found = json(&output)["ports"][0].clone();
        assert_eq!((&found["driver"], &found["baud"]), (&driver.into(), &115_200.into()), "{found}");
        let sensors: Vec<_> =
            addresses.iter().map(|address| serde_json::json!({ "address": address })).collect();
        assert_eq!(found["sensors"], serde_json::json!(sensors));
        let stage = Stage::load(&written).unwrap();
        assert_eq!((stage.devices[0].driver.word(), stage.sensors.len()), (driver, addresses.len()));
        assert_eq!(fs::read_to_string(&written).unwrap().contains(guidance), !settings.is_empty());
        assert_eq!(simulation.interrupt().code(), Some(0));
    }
}

#[test]
fn doctor_lists_the_trackers_of_a_receiver_and_writes_a_stage_for_them() {
    let folder = tempfile::tempdir().unwrap();
    let (path, written) = (folder.path().join("stage.toml"), folder.path().join("written.toml"));
    let text = "name = \"test\"\n\
        [[device]]\nname = \"hidraw0\"\ndriver = \"slimevr\"\nport = \"/dev/hidraw0\"\ntrackers = [\"C0:FF:EE:12:34:56\"]\n\
        [[sensor]]\nname = \"a\"\ndevice = \"hidraw0\"\naddress = 1\n\
        [[simulation.device]]\nname = \"hidraw0\"\nboot_ms = 0.0\n";
    fs::write(&path, text).unwrap();
    let simulation = Simulation::start(&path, &[]);
    let port = simulation.port();
    assert!(port.ends_with("/hidraw0"), "{port}");
    let output = posed(["doctor", &port, "--json", "--write-stage", written.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let found = json(&output)["ports"][0].clone();
    assert_eq!((&found["driver"], &found["model"]), (&"slimevr".into(), &"receiver".into()), "{found}");
    assert_eq!(found["sensors"], serde_json::json!([{ "address": 1, "serial": "C0:FF:EE:12:34:56" }]));
    let stage = Stage::load(&written).unwrap();
    assert_eq!((stage.devices[0].port.as_str(), stage.devices[0].driver.word()), (port.as_str(), "slimevr"));
    assert_eq!(simulation.interrupt().code(), Some(0));
}

/// A fresh pseudo-terminal whose other end nobody serves: as silent as a cable that leads nowhere.
#[test]
fn doctor_explains_a_silent_port() {
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("stage.toml");
    let args = ["doctor", "/dev/ptmx", "--baud", "9600", "--json", "--write-stage", stage.to_str().unwrap()];
    let output = posed(args);
    assert_eq!(output.status.code(), Some(1));
    let port = json(&output)["ports"][0].clone();
    assert!(port["driver"].is_null(), "{port}");
    assert!(port["problem"].as_str().unwrap().contains("nothing answers at 9600 baud"), "{port}");
    for word in ["power", "FLY", "baud", "RTS", "cable"] {
        assert!(port["fix"].as_str().unwrap().contains(word), "{word}: {port}");
    }
    assert!(!stage.exists(), "a stage without devices was written");
}

#[test]
fn doctor_names_a_port_that_is_missing() {
    let output = posed(["doctor", "/dev/no-such-port", "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let port = json(&output)["ports"][0].clone();
    assert_eq!(port["problem"], "there is no such port");
    assert!(port["fix"].as_str().unwrap().contains("posed doctor"));
    let server = json(&posed(["doctor", "tcp://127.0.0.1:1", "--json"]))["ports"][0].clone();
    assert!(server["problem"].as_str().unwrap().contains("cannot be reached"), "{server}");
}
