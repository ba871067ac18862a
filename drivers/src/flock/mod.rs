//! Ascension Flock of Birds over RS-232, and 3D Guidance units (trakSTAR, driveBAY) as far as they are known to speak like one
//! ([`family`]); their USB port is not served.
//!
//! ```text
//! bytes ─> Session: Examination (what is there?) ─> plan (make it so) ─> Splitter ─> Sample
//!          Probe: the same Examination, for `doctor`
//! file  ─> capture: the host's commands and the unit's bytes of a session recorded elsewhere ─> records
//! ```
//! [`wire`] knows the bytes, both ways, and nothing else.

mod asker;
pub mod capture;
pub mod examine;
pub mod family;
pub mod parser;
mod plan;
pub mod probe;
pub mod session;
pub mod settings;
pub mod wire;

pub use examine::{Findings, Unit};
pub use family::Family;
pub use probe::Probe;
pub use session::FlockSession;
pub use settings::{Filters, Mode, Settings, SettingsError};
