//! The stage file: which devices and sensors there are, who wears them, and who may look.
//!
//! What comes in: TOML text. What goes out: a [`Stage`], or every [`Problem`] of the text with its line, key
//! and fix. What it never does: fill a gap by guessing, accept an unknown key, touch a device.
//!
//! Every key carries its unit. `config/README.md` is the reference, and a test holds it against these types.
//! The shape of the file is checked against the JSON schema of the types (`shape.rs`), so that a range written at
//! a field is both documentation and check; what spans several tables is in `rules/`.

mod attached;
mod body;
mod check;
mod driver;
pub mod edit;
mod field;
mod files;
pub mod input;
mod keyframes;
pub mod layout;
mod limits;
mod models;
pub mod name;
pub mod output;
mod port;
mod problem;
mod rules;
mod secrets;
mod shape;
pub mod signals;
#[cfg(test)]
mod tests;
mod timecode;
mod zenoh;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use posed_motion::fault_map::FaultMap;

pub use attached::AttachedImu;
pub use body::{
    Body, BodyIndex, Calibration, JointKind, Lengths, MOST_BODIES, Mounting, SEGMENTS, SegmentSpec, Skeleton,
    WhichBody, body_counted, body_named,
};
pub use check::{Report, check, check_in, check_table};
pub use driver::{Driver, TimeBase};
pub use field::FieldWatch;
pub use files::{read_field_map, read_intrinsics};
pub use keyframes::{Keyframes, KeyframesMethod};
pub use limits::Limits;
pub use models::LoadedModels;
pub use port::{PortAddress, PortAddressError};
pub use problem::{LoadError, Problem, Problems};
pub use secrets::{Secret, readable_by_others, without_secrets};
pub use timecode::{Timecode, TimecodeSignal};
pub use zenoh::{Zenoh, ZenohTls};

/// A stage file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Stage {
    /// Shown to clients.
    #[schemars(length(min = 1, max = 200))]
    pub name: String,
    /// Ticks of the stage clock per second; absent: the ticks follow the fastest device.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub frame_rate_hz: Option<f64>,
    /// How long a frame waits for its last sensors, ms.
    #[serde(default = "default_frame_wait_ms")]
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub frame_wait_ms: f64,
    /// The magnetic transmitter.
    #[serde(default)]
    pub transmitter: Transmitter,
    /// Devices; everything published keeps their order.
    #[serde(default, rename = "device")]
    pub devices: Vec<Device>,
    /// Sensors; everything published keeps their order.
    #[serde(default, rename = "sensor")]
    pub sensors: Vec<Sensor>,
    /// What watches over the tracker's field; absent: nothing does.
    pub field: Option<FieldWatch>,
    /// The bodies that wear the sensors, each as `[[body]]`, a single one as `[body]`, too; none: nobody does.
    #[serde(default, rename = "body", deserialize_with = "body::one_or_several")]
    #[schemars(extend("x-or-table" = true))]
    pub bodies: Vec<Body>,
    /// Key poses, live; absent: they are not looked for.
    pub keyframes: Option<Keyframes>,
    /// What names the segments of the motion; absent: nothing does.
    pub segments: Option<Segments>,
    /// Websocket, page and metrics.
    #[serde(default)]
    pub server: Server,
    /// Programs that speak VRPN; absent: they are not served.
    pub vrpn: Option<Vrpn>,
    /// Avatars that are sent the skeleton by VMC over OSC; absent: none.
    pub vmc: Option<Vmc>,
    /// Programs that take the body as MVN's network stream; absent: none.
    pub mvn: Option<Mvn>,
    /// Programs that read Lab Streaming Layer; absent: nothing is offered.
    pub lsl: Option<Lsl>,
    /// Hubs and other programs on other machines, by zenoh; absent: the stage stays on this one.
    pub zenoh: Option<Zenoh>,
    /// Programs of ROS 2 that use rmw_zenoh; absent: they get nothing.
    pub ros2: Option<Ros2>,
    /// Time code of cameras and sound recorders; absent: none is read.
    pub timecode: Option<Timecode>,
    /// Models that are loaded at the start.
    #[serde(default)]
    pub models: Models,
    /// What is done about faults.
    #[serde(default)]
    pub faults: Faults,
    /// Where recordings go and come from.
    #[serde(default)]
    pub recording: Recording,
    /// What `posed demo` and `posed simulate` put in the devices' place; checked by the simulator.
    #[serde(default)]
    #[schemars(with = "Option<serde_json::Map<String, serde_json::Value>>")]
    pub simulation: Option<toml::Table>,
}

impl Stage {
    /// Reads a stage from the text of its file.
    ///
    /// Paths stay as they stand in the text; files they name are not looked at ([`Stage::load`] does both).
    ///
    /// # Errors
    /// Every problem of the text, not only the first.
    pub fn parse(text: &str) -> Result<Self, Problems> {
        check::parse(text, None)
    }

    /// Reads a stage from its file, and looks at the files that it names.
    ///
    /// Relative paths begin at the file's folder and are joined with it in the result: those of `server.tls`, `models`,
    /// `segments`, `timecode.path`, `zenoh.users`, `zenoh.tls` and `recording`. Files of secrets (`secret_file`, `password_file`, `server.tls.key`,
    /// `zenoh.users`, `zenoh.tls.key`) are looked for in the folder that the environment names as `CREDENTIALS_DIRECTORY` first; what the first
    /// two hold is read. `lsl.library` and what is in `simulation` stay as they are written. Warnings are left out: [`check_in`]
    /// gives them.
    ///
    /// # Errors
    /// [`LoadError::Read`] where the file cannot be read as UTF-8; [`LoadError::Wrong`] with every problem that it has;
    /// [`LoadError::Secret`] where the file of a secret has gone meanwhile.
    pub fn load(path: &Path) -> Result<Self, LoadError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| LoadError::Read { path: path.to_owned(), error })?;
        Self::load_text(&text, path)
    }

    /// As [`Stage::load`], from a text that is to become the file at `path`.
    ///
    /// # Errors
    /// As for [`Stage::load`], but for [`LoadError::Read`].
    pub fn load_text(text: &str, path: &Path) -> Result<Self, LoadError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut stage = check::parse(text, Some(folder))
            .map_err(|problems| LoadError::Wrong { path: path.to_owned(), problems })?;
        stage.read_secrets(folder).map_err(LoadError::Secret)?;
        if let Some(tls) = &mut stage.server.tls {
            tls.certificate = folder.join(&tls.certificate);
            tls.key = secrets::secret_path(folder, &tls.key);
        }
        if let Some(map) = &mut stage.models.field {
            *map = folder.join(&*map);
        }
        for exercise in &mut stage.models.exercises {
            *exercise = folder.join(&*exercise);
        }
        if let Some(faults) = &mut stage.models.faults {
            *faults = folder.join(&*faults);
        }
        if let Some(segments) = &mut stage.segments {
            segments.model = folder.join(&segments.model);
        }
        if let Some(users) = stage.zenoh.as_mut().and_then(|zenoh| zenoh.users.as_mut()) {
            *users = secrets::secret_path(folder, users);
        }
        if let Some(tls) = stage.zenoh.as_mut().and_then(|zenoh| zenoh.tls.as_mut()) {
            tls.authority = folder.join(&tls.authority);
            tls.certificate = folder.join(&tls.certificate);
            tls.key = secrets::secret_path(folder, &tls.key);
        }
        if let Some(path) = stage.timecode.as_mut().and_then(|timecode| timecode.path.as_mut()) {
            *path = folder.join(&*path);
        }
        let Self { models, recording, .. } = &mut stage;
        let Models { faults_folder, exercise_folder, imu_folder, segments_folder, .. } = models;
        let kept = [faults_folder, exercise_folder, imu_folder, segments_folder, &mut recording.folder];
        for kept in kept.into_iter().flatten() {
            *kept = folder.join(&*kept);
        }
        Ok(stage)
    }

    /// The stage's name as part of the name of a file: ASCII letters in lower case, ASCII digits, and a hyphen for every other
    /// character. Stages of different names may have the same.
    pub fn file_name(&self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
        self.name.chars().map(plain).collect()
    }

    /// The driver of a sensor's device; `None` where the stage has no device of that name, which [`Stage::parse`] refuses.
    pub fn driver_of(&self, sensor: &Sensor) -> Option<&Driver> {
        self.devices.iter().find(|device| device.name == sensor.device).map(|device| &device.driver)
    }

    /// Whether a sensor is an IMU (it measures no position) rather than one of a magnetic tracker; false where its device is not
    /// known.
    pub fn is_imu(&self, sensor: &Sensor) -> bool {
        self.driver_of(sensor).is_some_and(Driver::is_inertial)
    }

    /// Indices in [`Stage::sensors`] of the sensors of magnetic trackers, rising; empty where all are IMUs.
    pub fn magnetic_indices(&self) -> Vec<usize> {
        let sensors = self.sensors.iter().enumerate();
        sensors.filter(|(_, sensor)| !self.is_imu(sensor)).map(|(index, _)| index).collect()
    }

    /// Which body wears a sensor, by its index in [`Stage::bodies`]: the one that its `body` names, or the only one there is. `None` where nobody does, as far as
    /// that tells: it may sit on no segment.
    pub fn wearer_of(&self, sensor: &Sensor) -> Option<BodyIndex> {
        let at = match (&sensor.body, &*self.bodies) {
            (Some(name), bodies) => bodies.iter().position(|body| body.name == *name)?,
            (None, [_]) => 0,
            (None, _) => return None,
        };
        BodyIndex::try_from(at).ok()
    }

    /// This stage with one of its bodies alone, and all of its sensors, for what works on one person: by its name, or the only one.
    ///
    /// # Errors
    /// One sentence: there is no such body, or there are several and none was named.
    pub fn of_body(mut self, name: Option<&str>) -> Result<Self, String> {
        let at = body_named(self.body_names(), name).map_err(|which| {
            let names: Vec<String> = self.body_names().map(|name| format!("`{name}`")).collect();
            match (which, names.is_empty()) {
                (WhichBody::Unknown(name), true) => format!("the stage has no body `{name}`: it has none"),
                (WhichBody::Unknown(name), false) => {
                    format!("the stage has no body `{name}`: it has {}", names.join(", "))
                }
                (WhichBody::Several, _) => {
                    format!("the stage has several bodies: name one of {}", names.join(", "))
                }
            }
        })?;
        if self.bodies.len() > 1 {
            // Beside several bodies nobody wears what says no body.
            self.sensors.iter_mut().for_each(|sensor| _ = sensor.body.get_or_insert_default());
            self.bodies = vec![self.bodies.swap_remove(usize::from(at))];
        }
        Ok(self)
    }

    /// The bodies' names, in their order.
    pub fn body_names(&self) -> impl ExactSizeIterator<Item = &str> + Clone {
        self.bodies.iter().map(|body| &*body.name)
    }

    /// Names of the sensors of magnetic trackers, in the order of [`Stage::sensors`].
    pub fn magnetic_sensors(&self) -> Vec<&str> {
        self.magnetic_indices().into_iter().map(|index| self.sensors[index].name.as_str()).collect()
    }

    /// Reads the fault map in the file at `path`, which is taken as it stands, and holds its sensors against the stage's magnetic
    /// ones: the same names, in any order.
    ///
    /// # Errors
    /// One sentence: it cannot be read, is none, or knows other sensors than the stage's magnetic ones.
    pub fn read_faults(&self, path: &Path) -> Result<FaultMap, String> {
        rules::models::read_faults(path, self)
    }
}

/// What the fuzz target does with any bytes: a text is right exactly if it parses, and every problem has a line.
///
/// # Panics
/// That does not hold: the fuzz target has found a fault.
#[doc(hidden)]
pub fn fuzz(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let report = check(text);
    assert_eq!(report.ok, Stage::parse(text).is_ok());
    assert_eq!(report.ok, report.problems.is_empty());
    let lines = 1 + text.matches('\n').count();
    for problem in report.problems.iter().chain(&report.warnings) {
        assert!((1..=lines).contains(&problem.line), "{problem:?}");
    }
}

fn default_frame_wait_ms() -> f64 {
    5.0
}

/// The magnetic transmitter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Transmitter {
    /// Transmitter to room; absent: the room's axes are the tracker's own.
    pub pose_in_room: Option<Pose>,
}

/// A pose: the named frame in the room.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Position, m.
    pub position_m: [f64; 3],
    /// Unit quaternion, scalar first.
    pub orientation_wxyz: [f64; 4],
}

impl Pose {
    /// No shift and no rotation: the frame is the room's own.
    pub const IDENTITY: Self = Self { position_m: [0.0; 3], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] };
}

/// One device.
///
/// Its own keys and those of its driver stand in one table. Unknown keys are refused by the driver's settings,
/// which get all keys that are not listed here.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Device {
    /// Unique name.
    #[schemars(length(min = 1, max = 64))]
    pub name: String,
    /// Path of a serial port, `tcp://HOST:PORT`, `udp://HOST:PORT`, `auto`, or `websocket` for devices that connect to `/imu`.
    pub port: String,
    /// UDP port of this computer that the device sends to, for `udp://HOST:PORT`; absent: any.
    #[schemars(range(min = 1))]
    pub local_port: Option<u16>,
    /// Line rate, bit/s.
    #[serde(default = "default_baud")]
    #[schemars(range(min = 1))]
    pub baud: u32,
    /// Constant delay from measurement to the record's first byte, ms.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub measurement_delay_ms: f64,
    /// The driver and its settings.
    #[serde(flatten)]
    pub driver: Driver,
}

fn default_baud() -> u32 {
    115_200
}

/// One sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Unique name; a segment's name gives it a role.
    #[schemars(length(min = 1, max = 64))]
    pub name: String,
    /// Name of its device.
    pub device: String,
    /// Address on the device; 0 is a stand-alone unit.
    pub address: u16,
    /// Serial number as the device reports it: the sensor is the unit with this number, at whatever address it answers.
    #[schemars(length(min = 1, max = 64))]
    pub serial: Option<String>,
    /// Whether the heading of an inertial sensor follows its magnetometer; without, it starts at 0 and drifts.
    #[serde(default = "default_magnetometer", skip_serializing_if = "is_default_magnetometer")]
    pub magnetometer: bool,
    /// How far an inertial sensor's rate gyro lags behind its time stamps, ms.
    #[serde(default, skip_serializing_if = "is_zero")]
    #[schemars(range(min = 0.0, max = 100.0))]
    pub gyro_delay_ms: f64,
    /// The body that wears it, by name; absent: the only one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body: Option<String>,
    /// The body segment it sits on; absent: its name, if that is a segment's.
    pub segment: Option<String>,
    /// Unit quaternion that turns sensor coordinates into segment coordinates, scalar first.
    pub mount_quat_wxyz: Option<[f64; 4]>,
    /// Position on the segment, in the segment's frame with its origin at the proximal joint, m.
    pub offset_m: Option<[f64; 3]>,
    /// The IMU that is attached to this magnetic sensor: both become one pose, which goes on where the tracker fails.
    pub imu: Option<AttachedImu>,
}

impl Sensor {
    /// Name of the segment it would sit on: its `segment` in the stage file, else its own name, which need not be a segment's.
    pub fn sits_on(&self) -> &str {
        self.segment.as_ref().unwrap_or(&self.name)
    }
}

/// A key that was not written is not written back: not every driver's sensors may have it.
fn is_default_magnetometer(value: &bool) -> bool {
    *value == default_magnetometer()
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn default_magnetometer() -> bool {
    true
}

/// Segments of the motion, named by a trained network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Segments {
    /// The model that `posed segments train` wrote; its joints are sensors, by name.
    pub model: PathBuf,
}

/// Websocket, page and metrics.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Server {
    /// Address to listen on; absent: 127.0.0.1:8787. Anything but loopback needs a token.
    pub listen: Option<String>,
    /// Who may do what.
    #[serde(default, rename = "token")]
    pub tokens: Vec<Token>,
    /// Origins of browser pages that may connect, beside the daemon's own.
    #[serde(default)]
    pub allowed_origins: Vec<String>,
    /// Certificate and key for TLS.
    pub tls: Option<Tls>,
    /// Address at which phones and other devices send to the websocket `/imu` over TLS, and find nothing else; absent: 0.0.0.0:8788,
    /// or another port where that one is taken. It is listened on where a device has the port `websocket`, or once somebody presses
    /// *Add a phone*; only with a token for sensors.
    pub phones: Option<String>,
    /// What clients may take of the daemon; absent keys: as they are.
    #[serde(default)]
    pub limits: Limits,
}

impl Server {
    /// The port at which others on the network reach the daemon's websocket; 0 where it listens to this computer alone.
    pub fn port_for_others(&self) -> u16 {
        let address = self.listen.as_ref().and_then(|listen| listen.parse::<std::net::SocketAddr>().ok());
        address
            .filter(|address| !address.ip().to_canonical().is_loopback())
            .map_or(0, |address| address.port())
    }
}

/// An access token.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Token {
    /// The secret, at least 16 characters; or `secret_file`.
    #[schemars(with = "Option<String>", length(min = 16, max = 512))]
    pub secret: Option<Secret>,
    /// File that holds the secret and nothing else. A relative path is looked for among the service's credentials first.
    pub secret_file: Option<PathBuf>,
    /// What its bearer may do.
    pub role: Role,
}

/// What a client may do.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Send a sensor's measurements, and nothing else.
    Sensor,
    /// Subscribe.
    Watch,
    /// Subscribe and request.
    Operate,
}

/// TLS by files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tls {
    /// PEM file with the certificate chain.
    pub certificate: PathBuf,
    /// PEM file with the private key. A relative path is looked for among the service's credentials first.
    pub key: PathBuf,
}

/// Programs that speak VRPN: every sensor is a tracker of its own name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Vrpn {
    /// Address to listen on, TCP and UDP; absent: 127.0.0.1:3883. VRPN knows no tokens: who reaches the address sees all poses.
    pub listen: Option<String>,
    /// Whether other computers may ask to be called back, as most VRPN programs do; without, they need `tcp://` in the name of the tracker.
    #[serde(default)]
    pub call_back: bool,
}

/// Avatars that are sent the skeleton by VMC (Virtual Motion Capture) over OSC.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Vmc {
    /// Addresses that datagrams are sent to, HOST:PORT; absent: 127.0.0.1:39539.
    pub targets: Option<Vec<String>>,
    /// Frames per second, Hz; absent: 60.
    #[schemars(range(min = 1.0, max = 200.0))]
    pub rate_hz: Option<f64>,
    /// Turn of the room about its vertical before it is sent, counter-clockwise from above, degrees. With 0, who looks along the room's y looks forward.
    #[serde(default)]
    #[schemars(range(min = -360.0, max = 360.0))]
    pub heading_deg: f64,
    /// Height of the avatar, m: positions are scaled to it; absent: the person's.
    #[schemars(range(min = 0.1, max = 10.0))]
    pub height_m: Option<f64>,
    /// Whether magnetic sensors are sent too, as trackers of their names.
    #[serde(default)]
    pub trackers: bool,
    /// Which bones are sent.
    #[serde(default)]
    pub bones: VmcBones,
}

/// Bones of a Unity humanoid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum VmcBones {
    /// Those that every humanoid has, the spine as one.
    #[default]
    Required,
    /// Chest, upper chest, neck, shoulders and toes beside them, for an avatar that has them all: a bend of the spine is shared out.
    All,
}

/// Programs that are sent the body as MVN's real-time network stream (MXTP) by UDP.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mvn {
    /// Addresses that datagrams are sent to, HOST:PORT; absent: 127.0.0.1:9763.
    pub targets: Option<Vec<String>>,
    /// Samples per second, Hz; absent: 60.
    #[schemars(range(min = 1.0, max = 240.0))]
    pub rate_hz: Option<f64>,
    /// Number of the character, for receivers that look for another than 0.
    #[serde(default)]
    pub character: u8,
    /// Whether Euler angles (type 01, centimetres, y up) are sent beside quaternions, as some plug-ins need.
    #[serde(default)]
    pub euler: bool,
    /// Whether velocities and accelerations of the segments (types 21 and 22) and the centre of mass (24) are sent, too.
    #[serde(default)]
    pub kinematics: bool,
}

/// Streams of Lab Streaming Layer: poses, joint angles, events. liblsl must be installed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Lsl {
    /// The file of liblsl; absent: where the system has it.
    pub library: Option<PathBuf>,
}

/// Programs of ROS 2 by rmw_zenoh, through its router: poses, joint angles and what IMUs measure, as ROS's own messages.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Ros2 {
    /// Addresses of routers, `tcp/HOST:PORT`, of which the first that answers is taken, and tried again for ever; absent: tcp/localhost:7447.
    pub connect: Option<Vec<String>>,
    /// `ROS_DOMAIN_ID` of the programs.
    #[serde(default)]
    #[schemars(range(max = 232))]
    pub domain_id: u8,
    /// Namespace of node, topics and frames, such as `hall/left`; absent: none.
    #[schemars(length(min = 1, max = 100))]
    pub namespace: Option<String>,
    /// Name of the room's frame, which all others are children of; absent: `map`.
    #[schemars(length(min = 1, max = 100))]
    pub frame: Option<String>,
    /// Messages per second on each topic at most, Hz; absent: one for each frame and body.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub rate_hz: Option<f64>,
}

/// Models that are loaded at the start; relative paths begin at the stage file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Models {
    /// Files of taught exercises; all of them are counted until a client selects others.
    #[serde(default)]
    pub exercises: Vec<PathBuf>,
    /// The one folder that `exercise.teach` writes to and `exercise.select` looks in; absent: `exercises` beside the stage file.
    pub exercise_folder: Option<PathBuf>,
    /// The fault map that `posed faults train` or `faults.train` wrote; it knows the stage's magnetic sensors, by name.
    pub faults: Option<PathBuf>,
    /// The one folder that `faults.train` and `faults.name_cell` write to; absent: `faults` beside the stage file.
    pub faults_folder: Option<PathBuf>,
    /// The one folder that `imu.calibrate` writes to, one file per IMU with its serial number as its name; what `posed imu calibrate`
    /// writes may lie there too. All of them are used from the start on. Absent: `imus` beside the stage file.
    pub imu_folder: Option<PathBuf>,
    /// The one folder that `segments.train` writes to; absent: `segments` beside the stage file.
    pub segments_folder: Option<PathBuf>,
    /// A map of the field, as `posed field solve` writes it; used until `field.accept` has brought a newer one.
    pub field: Option<PathBuf>,
}

/// What is done about faults of magnetic sensors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Faults {
    /// Whether poses are published that were mirrored back or that bridge a short fault; without, there is none then.
    #[serde(default = "default_repair")]
    pub repair: bool,
}

impl Default for Faults {
    fn default() -> Self {
        Self { repair: default_repair() }
    }
}

fn default_repair() -> bool {
    true
}

/// Where recordings live, and what they hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Recording {
    /// The one folder that `record.start` writes to and `replay.list` reads; absent: `recordings` beside the stage file.
    pub folder: Option<PathBuf>,
    /// What recordings hold beside the input log, from which everything else can be made anew.
    pub content: RecordingContent,
    /// Whether they hold poses, angles and events as columns, too, which are data frames at once; two thirds more of the disk. Without them a reader needs the
    /// program, and a replay.
    pub columns: bool,
}

impl Default for Recording {
    fn default() -> Self {
        Self { folder: None, content: RecordingContent::default(), columns: true }
    }
}

/// What a recording holds beside the input log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecordingContent {
    /// For viewers the moving sensors and body at a low rate, and no published message.
    #[default]
    Log,
    /// Every published message and all channels for viewers at the full rate.
    Full,
}
