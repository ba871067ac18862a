//! Two boards, or two phones, on an arm: calibrated, taught and counted, through the radio and with their own noise.

use nalgebra::{UnitQuaternion, Vector3};
use posed_fusion::body::{Block, BlockKind, BodySegment, Recorded, SEGMENTS, Skeleton, calibrate};
use posed_geometry::orientation_to_wxyz;
use posed_motion::exercise::{Options, Stream, teach};
use posed_simulator::body::{Activity, Script};
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{Motion, Person};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::Stage;
use posed_stage::input::{Input, Model, MountedSensor, Plan, Request};

use crate::exercise::{counts, wearer};
use posed_rig::Rig;

const HEIGHT_M: f64 = 1.8;
const ARM: [BodySegment; 2] = [BodySegment::UpperArmR, BodySegment::ForearmR];

/// How a sensor sits on its segment: askew.
fn mount(segment: BodySegment) -> UnitQuaternion<f64> {
    let k = segment.index() as f64;
    UnitQuaternion::from_scaled_axis(Vector3::new(libm::sin(1.3 * k), libm::cos(2.1 * k), 0.4))
}

/// Somebody who calibrates and then works out, with the two devices at a port, whose radio adds up to 30 ms and loses 2 % of what they send.
fn arm(port: &str, rate_hz: f64) -> (Stage, Scenario) {
    let mut text = format!(
        "name = \"arm\"\n[[device]]\nname = \"worn\"\ndriver = \"open-imu\"\nport = \"{port}\"\ndevices = [\"upper\", \"lower\"]\n\
         [body]\nheight_m = {HEIGHT_M}\n"
    );
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let mut sensors = Vec::new();
    for (address, segment) in (1..).zip(ARM) {
        let name = segment.name();
        text += &format!(
            "[[sensor]]\nname = \"{name}\"\ndevice = \"worn\"\naddress = {address}\nsegment = \"{name}\"\nmagnetometer = false\n"
        );
        sensors.push(SensorScenario {
            name: name.into(),
            body: "person".into(),
            segment: Some(name.into()),
            offset_m: skeleton.usual_sensor_m(segment).into(),
            mount_quat_wxyz: orientation_to_wxyz(&mount(segment)),
        });
    }
    let person =
        Person { activity: Activity::Workout, calibration: true, height_m: HEIGHT_M, ..Person::default() };
    let lost = Bytes { count: (0.02 * 2.0 * rate_hz * 130.0) as u32, start_s: 2.0, end_s: 132.0 };
    let devices = vec![DeviceScenario {
        name: "worn".into(),
        boot_ms: 0.0,
        drift_ppm: 100.0,
        imu: ImuClass::Board,
        radio_jitter_ms: 30.0,
        faults: vec![Fault::LostDatagrams(lost)],
        ..DeviceScenario::default()
    }];
    let bodies = vec![BodySpec { name: "person".into(), motion: Motion::Person(person) }];
    (toml::from_str(&text).unwrap(), Scenario { bodies, sensors, devices, ..Scenario::default() })
}

/// What a calibration sees of the arm.
fn recorded(rig: &Rig) -> Vec<Recorded> {
    rig.estimates()
        .map(|estimate| {
            let mut samples = [None; SEGMENTS];
            for (sensor, segment) in estimate.sensors.iter().zip(ARM) {
                let measured = sensor.measured.and_then(|measured| measured.inertial);
                samples[segment.index()] = measured.and_then(|inertial| inertial.sample());
            }
            (estimate.t_valid.as_secs_f64(), samples)
        })
        .collect()
}

/// The poses and movements that an arm takes part in.
fn blocks(script: &Script) -> Vec<Block> {
    let of_arm = |block: &Block| match block.kind {
        BlockKind::NPose | BlockKind::TPose => true,
        BlockKind::Move(segment, _) => ARM.contains(&segment),
        BlockKind::Bow | BlockKind::TrunkRotation | BlockKind::Walk => false,
    };
    let span = |span: posed_simulator::body::BlockSpan| Block {
        kind: BlockKind::named(span.kind).unwrap(),
        start_s: span.start_s,
        end_s: span.end_s,
    };
    script.blocks().into_iter().map(span).filter(of_arm).collect()
}

fn goes_through_all(port: &str, rate_hz: f64) {
    let (stage, scenario) = arm(port, rate_hz);
    let script = Script { activity: Activity::Workout, calibration: true, facing: 0.0, mistake: None };
    let begins_s = script.activity_s();
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(begins_s - 0.5);

    let found =
        calibrate(&recorded(&rig), &blocks(&script), &Skeleton::from_height(HEIGHT_M), &[None; SEGMENTS]);
    let found = found.unwrap_or_else(|error| panic!("{port}: {error}"));
    let mut mounted = Vec::new();
    for segment in ARM {
        let sits = found.mounts[segment.index()].expect("a mounting");
        let off_deg = sits.q_segment_sensor.angle_to(&mount(segment)).to_degrees();
        println!("{port} {}: {off_deg:.1} degrees off", segment.name());
        assert!(off_deg < 8.0, "{port} {}: {off_deg}", segment.name());
        mounted.push(MountedSensor {
            sensor: segment.name().to_owned(),
            segment: Some(segment.name().to_owned()),
            mount_quat_wxyz: orientation_to_wxyz(&sits.q_segment_sensor),
            offset_m: sits.offset_m.into(),
            sigma_deg: Some(sits.sigma_rad.map(f64::to_degrees).into()),
        });
    }
    rig.push(Input::Model(Model::Mounting { body: None, sensors: mounted }));
    rig.forget();

    // Taught by the first set of five curls, between two rests.
    rig.run_until(begins_s + 14.0);
    let (columns, t_s, values) = wearer(&rig, &stage, begins_s + 0.5..begins_s + 13.5);
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let lesson = teach(&stream, &Options { name: "curl".into(), repetitions: 5, ..Options::default() });
    let lesson = lesson.unwrap_or_else(|refusal| panic!("{port}: {refusal}"));
    rig.push(Input::Model(Model::Exercise { exercise: Box::new(lesson.exercise) }));
    rig.push(Input::Request(Request::ExerciseSelect {
        subject: "patient".to_owned(),
        exercises: vec!["curl".to_owned()],
        plan: Plan::default(),
        sensors: Default::default(),
        body: None,
    }));
    rig.run_until(begins_s + 43.0);
    assert_eq!(counts(&rig.emitted, "patient"), (1..=10).collect::<Vec<_>>(), "{port}");
    assert!(rig.pipeline.status().sensors.iter().all(|sensor| sensor.lost > 0), "the radio loses nothing");
}

#[test]
fn an_arm_of_two_boards_is_calibrated_taught_and_counted() {
    goes_through_all("udp://0.0.0.0:9301", 100.0);
}

#[test]
fn an_arm_of_two_phones_is_calibrated_taught_and_counted() {
    goes_through_all("websocket", 60.0);
}
