//! Phones as sensors: how one comes, and which have.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use posed_stage::edit::Change;

/// How a phone comes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Invitation {
    /// The page to open on the phone, with the token for sensors behind `#`.
    pub page: String,
    /// The same page by the other addresses and the name of this computer.
    pub others: Vec<String>,
    /// `page` as a QR code.
    pub qr: QrCode,
    /// What the daemon's own authority is called, which a phone may be set to trust; null where the stage file names a certificate.
    pub authority: Option<String>,
    /// The SHA-256 fingerprint of the authority's certificate; empty where the stage file names a certificate.
    pub fingerprint: String,
}

/// A picture of squares.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct QrCode {
    /// How many squares are side by side, without the margin of four that it needs.
    pub width: usize,
    /// The dark ones, as a path of SVG with squares of one unit.
    pub path: String,
}

/// What is connected to the websocket `/imu`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Phones {
    /// Each by its id, in the order of these.
    pub phones: Vec<Phone>,
}

/// One that is connected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Phone {
    /// What it calls itself for good.
    pub phone_id: String,
    /// Its name, for people; may be empty.
    pub phone_name: String,
    /// Where it is connected from.
    pub peer: String,
    /// How it is held, as it reports that itself: its axes in a world whose z is up; null where it has not.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// The stage's sensor that it is, by name; null: none yet.
    pub sensor: Option<String>,
    /// The changes that make it one, without a segment; none where it is one.
    pub adds: Vec<Change>,
}
