//! `[zenoh]`: how a stage and a hub find each other.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::{Secret, Stage};

/// Hubs and other programs on other machines, by zenoh over TCP or TLS. Nothing is looked for: one end listens, the other connects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Zenoh {
    /// Addresses to listen on: `tls/ADDRESS:PORT`, encrypted, with `tls`; or `tcp/ADDRESS:PORT`, which is not, for a network that is trusted.
    #[serde(default)]
    pub listen: Vec<String>,
    /// Addresses of hubs, of routers or of stages to connect to, `tls/HOST:PORT` or `tcp/HOST:PORT`; tried again for ever.
    #[serde(default)]
    pub connect: Vec<String>,
    /// Longest time that a packet takes on these connections to the other end and back, ms. An attempt to connect lasts five times as
    /// long, and 500 ms at least: over a slower way none succeeds; the shorter, the sooner poses flow again after a cut.
    #[serde(default = "default_round_trip_ms")]
    #[schemars(range(min = 1, max = 5000))]
    pub round_trip_ms: f64,
    /// Where the stage's messages are in zenoh; absent: `posed/` and the stage's name in small letters, digits and hyphens.
    #[schemars(length(min = 1, max = 200))]
    pub key: Option<String>,
    /// Name to give to an end that listens and asks for one.
    pub user: Option<String>,
    /// The password that goes with it; or `password_file`.
    #[schemars(with = "Option<String>", length(min = 16, max = 512))]
    pub password: Option<Secret>,
    /// File that holds the password and nothing else. A relative path is looked for among the service's credentials first.
    pub password_file: Option<PathBuf>,
    /// File of those whom an end that listens lets in, a line `NAME:PASSWORD` for each; absent: everybody. A relative path is
    /// looked for among the service's credentials first.
    pub users: Option<PathBuf>,
    /// Certificates of links that are encrypted, addresses with `tls/`.
    pub tls: Option<ZenohTls>,
}

/// Certificates of encrypted links: either end shows one, and takes only what the authority has signed. `posed hub --certificates` makes them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ZenohTls {
    /// PEM file with the certificate of the authority, the same on all computers.
    pub authority: PathBuf,
    /// PEM file with this computer's certificate, for the names and addresses that others connect to.
    pub certificate: PathBuf,
    /// PEM file with its private key. A relative path is looked for among the service's credentials first.
    pub key: PathBuf,
}

fn default_round_trip_ms() -> f64 {
    100.0
}

impl Default for Zenoh {
    fn default() -> Self {
        Self {
            listen: Vec::new(),
            connect: Vec::new(),
            round_trip_ms: default_round_trip_ms(),
            key: None,
            user: None,
            password: None,
            password_file: None,
            users: None,
            tls: None,
        }
    }
}

impl Zenoh {
    /// The key expression of zenoh below which everything of `stage` is: `zenoh.key` of the stage file, else `posed/` and
    /// [`Stage::file_name`].
    pub fn key_of(&self, stage: &Stage) -> String {
        self.key.clone().unwrap_or_else(|| format!("posed/{}", stage.file_name()))
    }
}

impl Stage {
    /// The text of a stage file that says the same of devices, sensors and body, for other machines: without the tables `server`,
    /// `vrpn`, `vmc`, `mvn`, `lsl`, `zenoh`, `ros2` and `recording`, and so without tokens and passwords. What `models`, `segments` and
    /// `simulation` name, and the devices' ports, stay in it.
    ///
    /// # Errors
    /// One sentence, where it cannot be written as TOML.
    pub fn shareable_toml(&self) -> Result<String, String> {
        let stage = Self {
            server: super::Server::default(),
            vrpn: None,
            vmc: None,
            mvn: None,
            lsl: None,
            zenoh: None,
            ros2: None,
            recording: super::Recording::default(),
            ..self.clone()
        };
        toml::to_string(&stage).map_err(|error| format!("the stage file cannot be passed on: {error}"))
    }
}
