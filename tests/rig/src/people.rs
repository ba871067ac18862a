//! Several people who wear IMUs.

use posed_fusion::body::{BodySegment, Skeleton};
use posed_simulator::body::Activity;
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{Motion, Person};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::Stage;

/// Who (the name of the body), how tall, m, and what they do.
pub type Member = (&'static str, f64, Activity);

/// A stage with these people on it, each with an Xbus chain of ideal IMUs on every segment at 100 Hz, whose mounting is known and which have no compass, and the
/// scenario that stands in for them. Sensors are called `NAME-SEGMENT`, devices `chain-NAME`.
///
/// # Panics
/// A name is none for a body.
#[must_use]
pub fn people(cast: &[Member]) -> (Stage, Scenario) {
    let (text, scenario) = people_toml(cast);
    (Stage::parse(&text).unwrap_or_else(|problems| panic!("{problems}")), scenario)
}

/// The same with the stage as its file has it.
#[must_use]
pub fn people_toml(cast: &[Member]) -> (String, Scenario) {
    let mut text = String::from("name = \"clinic\"\n");
    let mut scenario = Scenario::default();
    for (name, height_m, activity) in cast {
        text += &format!(
            "[[device]]\nname = \"chain-{name}\"\ndriver = \"xbus\"\nport = \"/dev/{name}\"\nbaud = 921600\nrate_hz = 100.0\n\
             [[body]]\nname = \"{name}\"\nheight_m = {height_m}\nmounting = \"given\"\n"
        );
        let skeleton = Skeleton::from_height(*height_m);
        for (address, segment) in (1..).zip(BodySegment::ALL).take(BodySegment::BEFORE_SHOULDERS) {
            let offset_m: [f64; 3] = skeleton.usual_sensor_m(segment).into();
            let sensor = format!("{name}-{}", segment.name());
            text += &format!(
                "[[sensor]]\nname = \"{sensor}\"\ndevice = \"chain-{name}\"\naddress = {address}\nbody = \"{name}\"\nsegment = \"{}\"\n\
                 mount_quat_wxyz = [1.0, 0.0, 0.0, 0.0]\noffset_m = {offset_m:?}\nmagnetometer = false\n",
                segment.name()
            );
            scenario.sensors.push(SensorScenario {
                name: sensor,
                body: (*name).into(),
                segment: Some(segment.name().into()),
                offset_m,
                mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
            });
        }
        let person = Person { activity: *activity, height_m: *height_m, ..Person::default() };
        scenario.bodies.push(BodySpec { name: (*name).into(), motion: Motion::Person(person) });
        scenario.devices.push(DeviceScenario {
            name: format!("chain-{name}"),
            boot_ms: 0.0,
            imu: ImuClass::Ideal,
            ..DeviceScenario::default()
        });
    }
    (text, scenario)
}
