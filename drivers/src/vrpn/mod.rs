//! VRPN 7 over TCP: trackers of any kind behind a server, which is how motion capture cameras hand out the pose of a rigid body.
//!
//! ```text
//! bytes ─> Reader (greeting, messages, steps over damage) ─> VrpnSession (names to numbers, pings) ─> Sample
//! ```
//! It connects by TCP alone (`tcp://` of VRPN's own programs) and asks for nothing but signs of life. Velocities, accelerations,
//! buttons and texts are passed over. [`wire`] is that of posed's own server, too.

pub mod probe;
pub mod reader;
pub mod session;
pub mod wire;

pub use session::{Settings, VrpnSession};
