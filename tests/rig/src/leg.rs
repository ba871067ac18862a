//! A chain of hinges on a stage: thigh and shank of a simulated person who stands for a moment and then walks, without magnetometers.

use posed_fusion::chain::Epoch;
use posed_simulator::body::Activity;
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{Motion, Person};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::Stage;

use crate::Rig;

/// Sensor to segment, w, x, y, z.
pub const MOUNTS: [[f64; 4]; 2] = [[0.6, 0.0, 0.8, 0.0], [0.48, 0.64, 0.0, 0.6]];

/// Two IMUs on a leg, without a compass.
pub const STAGE: &str = r#"
name = "leg"
[[device]]
name = "worn"
driver = "xbus"
port = "/dev/none"
baud = 921600
rate_hz = 100.0
[[sensor]]
name = "upper"
device = "worn"
address = 1
segment = "thigh"
[[sensor]]
name = "lower"
device = "worn"
address = 2
segment = "shank"
[body]
skeleton = "custom"
[[body.segments]]
name = "thigh"
[[body.segments]]
name = "shank"
parent = "thigh"
joint = "knee"
kind = "hinge"
"#;

/// A person who stands for a moment and then walks; sensors askew.
pub fn leg(seed: u64) -> Rig {
    let stage = Stage::parse(STAGE).unwrap_or_else(|problems| panic!("{problems}"));
    let sensor = |name: &str, segment: &str, offset_m, mount_quat_wxyz| SensorScenario {
        name: name.into(),
        body: "person".into(),
        segment: Some(segment.into()),
        offset_m,
        mount_quat_wxyz,
    };
    let person = Person { activity: Activity::Walking, height_m: 1.8, ..Person::default() };
    let scenario = Scenario {
        seed,
        bodies: vec![BodySpec { name: "person".into(), motion: Motion::Person(person) }],
        sensors: vec![
            sensor("upper", "thigh_r", [0.05, -0.2, 0.02], MOUNTS[0]),
            sensor("lower", "shank_r", [0.04, -0.2, 0.01], MOUNTS[1]),
        ],
        devices: vec![DeviceScenario {
            name: "worn".into(),
            boot_ms: 0.0,
            imu: ImuClass::Mtx,
            ..DeviceScenario::default()
        }],
        ..Scenario::default()
    };
    Rig::new(&stage, &scenario)
}

/// What the daemon's job is sent.
pub fn epochs(rig: &Rig) -> Vec<Epoch> {
    rig.estimates()
        .map(|estimate| Epoch {
            t_s: estimate.t_valid.as_secs_f64(),
            samples: estimate.sensors.iter().map(|s| s.measured?.inertial?.sample()).collect(),
        })
        .collect()
}
