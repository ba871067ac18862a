//! Small stages in motion, for what is put into a running pipeline.

use std::sync::LazyLock;

use posed_drivers::Timestamp;
use posed_pipeline::Pipeline;
use posed_rig::{Rig, demo, leg};
use posed_simulator::scenario::Scenario;
use posed_stage::Stage;
use posed_stage::input::Entry;

/// An IMU on a tracker's sensor, and a second sensor.
const ATTACHED: &str = r#"
name = "attached"
[transmitter.pose_in_room]
position_m = [0.0, 0.0, 1.0]
orientation_wxyz = [0.0, 1.0, 0.0, 0.0]
[[device]]
name = "flock"
driver = "flock-of-birds"
port = "/dev/none"
[[device]]
name = "imu"
driver = "xbus"
port = "/dev/zero"
baud = 921600
[[sensor]]
name = "hand"
device = "flock"
address = 1
imu = { sensor = "hand_imu", quat_wxyz = [1.0, 0.0, 0.0, 0.0] }
[[sensor]]
name = "other"
device = "flock"
address = 2
[[sensor]]
name = "hand_imu"
device = "imu"
address = 0
"#;

/// The smallest there is.
pub(crate) const SMALL: &str = r#"
name = "small"
[[device]]
name = "fastrak"
driver = "fastrak"
port = "/dev/none"
[[sensor]]
name = "hand"
device = "fastrak"
address = 1
"#;

/// When each stage has been tracking for a while, s; and how much longer its log goes on.
const BEGUN_S: f64 = 3.5;
const LONGER_S: f64 = 0.25;

/// A stage whose devices stream.
pub(crate) struct Stand {
    pub(crate) stage: Stage,
    pub(crate) pipeline: Pipeline,
    /// Time of its last entry.
    pub(crate) now: Timestamp,
    /// What comes next.
    pub(crate) next: Vec<Entry>,
}

impl Stand {
    fn new(stage: Stage, mut rig: Rig) -> Self {
        rig.run_until(BEGUN_S);
        let (pipeline, now) = ((*rig.pipeline).clone(), rig.host.now);
        rig.forget();
        rig.run_until(BEGUN_S + LONGER_S);
        assert!(rig.estimates().count() > 10, "{} tracks", stage.name);
        Self { stage, pipeline, now, next: rig.log }
    }
}

/// A person with trackers and IMUs, a chain of hinges, a tracker with an IMU on it, and a single sensor.
pub(crate) static STANDS: LazyLock<[Stand; 4]> = LazyLock::new(|| {
    let (person, rig) = demo();
    let still = |text| {
        let stage = Stage::parse(text).unwrap_or_else(|problems| panic!("{problems}"));
        let rig = Rig::new(&stage, &Scenario::default());
        Stand::new(stage, rig)
    };
    [
        Stand::new(person, rig),
        Stand::new(Stage::parse(leg::STAGE).unwrap(), leg::leg(1)),
        still(ATTACHED),
        still(SMALL),
    ]
});
