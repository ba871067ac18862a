//! A tracker and an IMU on one wand; nobody knows how they sit.

/// Both on ports of their own.
pub const STAGE: &str = r#"
name = "both"
[[device]]
name = "flock"
driver = "flock-of-birds"
port = "/dev/none"
[[device]]
name = "imus"
driver = "x-imu3"
port = "/dev/none2"
baud = 2000000
[[sensor]]
name = "hand"
device = "flock"
address = 0
imu = { sensor = "hand_imu" }
[[sensor]]
name = "hand_imu"
device = "imus"
address = 1
"#;
