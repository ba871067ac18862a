//! A magnetic sensor with an IMU attached to it: the stage is aligned from its records, and both become one pose.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_fusion::align::Guide;
use posed_fusion::align::{AlignError, AnchorPoint, Found, Recording, align_recording};
use posed_geometry::{isometry, orientation_to_wxyz};
use posed_pipeline::{Pipeline, SupervisedPipeline};
use posed_simulator::faults::Fault;
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{Motion, Orbit};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::input::{Entry, Input, Model};
use posed_stage::output::{Body, Estimate, Output, PositionSource, SensorState};
use posed_stage::{Pose, Stage};

use posed_rig::wand::STAGE;
use posed_rig::{Rig, Said, replay};

const OFFSET_M: [f64; 3] = [0.021, -0.013, 0.034];

/// IMU to sensor.
fn sits() -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(OFFSET_M),
        UnitQuaternion::from_scaled_axis(Vector3::new(0.9, -1.4, 0.3)),
    )
}

/// A transmitter on a table, tilted by ten degrees.
fn transmitter() -> Isometry3<f64> {
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 10_f64.to_radians());
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7);
    Isometry3::from_parts(Translation3::new(0.4, -0.2, 0.9), yaw * tilt)
}

/// The stage as its operator has it at first: nothing is known of the transmitter.
fn unaligned() -> Stage {
    Stage::parse(STAGE).unwrap_or_else(|problems| panic!("{problems}"))
}

fn scenario(seed: u64, faults: Vec<Fault>) -> (Stage, Scenario) {
    let mut stage = unaligned();
    let pose = transmitter();
    let orientation_wxyz = orientation_to_wxyz(&pose.rotation);
    stage.transmitter.pose_in_room =
        Some(Pose { position_m: pose.translation.vector.into(), orientation_wxyz });
    let orbit = Orbit {
        center_m: pose.transform_point(&Vector3::new(0.5, 0.05, 0.0).into()).coords.into(),
        radius_m: [0.12, 0.2, 0.15],
        period_s: 5.0,
        turn_deg: [55.0, 50.0, 60.0],
        turn_period_s: 2.0,
        ..Orbit::default()
    };
    let q = sits().rotation;
    let rider = |name: &str, offset_m, mount_quat_wxyz| SensorScenario {
        name: name.into(),
        body: "wand".into(),
        segment: None,
        offset_m,
        mount_quat_wxyz,
    };
    let scenario = Scenario {
        seed,
        bodies: vec![BodySpec { name: "wand".into(), motion: Motion::Orbit(orbit) }],
        sensors: vec![
            rider("hand", [0.0; 3], [1.0, 0.0, 0.0, 0.0]),
            rider("hand_imu", OFFSET_M, [q.w, q.i, q.j, q.k]),
        ],
        devices: vec![
            DeviceScenario { name: "flock".into(), faults, ..DeviceScenario::default() },
            DeviceScenario {
                name: "imus".into(),
                imu: ImuClass::Mtx,
                drift_ppm: 40.0,
                ..DeviceScenario::default()
            },
        ],
        ..Scenario::default()
    };
    (stage, scenario)
}

/// What the daemon's job sees of a log, and what it makes of it.
fn aligned(log: &[Entry]) -> Found {
    align_recording(&recorded(log), &[], true).unwrap()
}

/// What the guide takes of a log.
fn recorded(log: &[Entry]) -> Recording {
    let mut pipeline = Pipeline::new(&unaligned()).unwrap();
    let mut guide = Guide::new(Vec::new(), true);
    for entry in log {
        pipeline.push(entry, &mut |output| {
            let Output::Estimate(estimate) = output else { return };
            let Some(record) = estimate.sensors[1].measured else { return };
            let sample = record.inertial.unwrap().sample().unwrap();
            guide.imu(record.t_valid.as_secs_f64(), &sample);
        });
        if let Some((t, pose)) = pipeline.estimated_pose(0) {
            guide.magnetic(t.as_secs_f64(), &pose);
        }
    }
    assert_eq!(guide.prompt(), None, "moved enough");
    guide.recorded().0.clone()
}

/// Entries that put an alignment to use.
fn swapped_in(found: &Found, t: Timestamp) -> [Entry; 2] {
    let mut room = found.alignment.room_from_transmitter;
    room.translation = transmitter().translation;
    let alignment = &found.alignment;
    let models = [
        Model::Transmitter {
            position_m: room.translation.vector.into(),
            orientation_wxyz: orientation_to_wxyz(&room.rotation),
        },
        Model::AttachedImu {
            sensor: "hand".into(),
            quat_wxyz: orientation_to_wxyz(&alignment.q_sensor_imu),
            offset_m: alignment.lever_m.into(),
            clock_offset_s: found.clock_offset_s,
        },
    ];
    models.map(|model| Entry { t, input: Input::Model(model) })
}

/// Largest errors of the hand's pose while it was carried on, m and rad, and for how many frames; and of all its poses.
fn errors(rig: &Rig, from_s: f64) -> ([f64; 2], usize, [f64; 2]) {
    let (mut carried, mut count, mut all) = ([0.0_f64; 2], 0, [0.0_f64; 2]);
    for estimate in rig.estimates().filter(|estimate| estimate.t_valid.as_secs_f64() > from_s) {
        let Some((position_m, rotation_rad)) = error(rig, estimate) else { continue };
        let worst = if estimate.sensors[0].coasted { &mut carried } else { &mut all };
        worst[0] = worst[0].max(position_m);
        worst[1] = worst[1].max(rotation_rad);
        count += usize::from(estimate.sensors[0].coasted);
    }
    (carried, count, all)
}

fn error(rig: &Rig, estimate: &Estimate) -> Option<(f64, f64)> {
    let pose = estimate.sensors[0].pose?;
    let pose = isometry(pose.position_m?, pose.orientation_wxyz)?;
    let t_s = estimate.t_valid.as_secs_f64();
    // The IMU's truth is always there, the sensor's is where it sits on it.
    let mut near: Vec<_> = rig
        .host
        .truth
        .iter()
        .flat_map(|cycle| cycle.sensors.iter().map(move |row| (cycle.t.as_secs_f64(), row)))
        .filter(|(at_s, row)| row.sensor == 1 && (at_s - t_s).abs() < 0.02)
        .map(|(at_s, row)| (at_s, row.pose * sits().inverse()))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    let after = near.iter().position(|(at_s, _)| *at_s >= t_s)?;
    let ((a_s, a), (b_s, b)) = (near[after.checked_sub(1)?], near[after]);
    let truth = a.lerp_slerp(&b, ((t_s - a_s) / (b_s - a_s)).clamp(0.0, 1.0));
    Some((
        (truth.translation.vector - pose.translation.vector).norm(),
        truth.rotation.angle_to(&pose.rotation),
    ))
}

#[test]
fn a_tilted_transmitter_and_its_imu_are_found_to_half_a_degree_and_five_millimetres() {
    for seed in 1..=2 {
        let (stage, scenario) = scenario(seed, Vec::new());
        let mut rig = Rig::new(&stage, &scenario);
        rig.run_until(36.0);
        let found = aligned(&rig.log);
        let alignment = &found.alignment;
        let turned =
            |found: &Found| found.alignment.room_from_transmitter.rotation.angle_to(&transmitter().rotation);
        let up = |q: UnitQuaternion<f64>| q.inverse() * Vector3::z();
        let tilt =
            up(alignment.room_from_transmitter.rotation).angle(&up(transmitter().rotation)).to_degrees();
        let imu = alignment.q_sensor_imu.angle_to(&sits().rotation).to_degrees();
        let lever_mm = 1e3 * (alignment.lever_m - sits().translation.vector).norm();
        assert!(tilt < 0.5 && imu < 0.5, "tilt {tilt}, IMU {imu} degrees");
        assert!(lever_mm < 5.0, "lever {lever_mm} mm");
        // The heading is as good as the unit's magnetometer, whose errors nobody has calibrated, or as the points are measured.
        assert!(found.heading && turned(&found).to_degrees() < 5.0, "{}", turned(&found).to_degrees());
        let anchors = [[0.35, 0.15, 0.1], [0.6, -0.25, -0.1], [0.5, 0.1, 0.25]].map(|point_m| AnchorPoint {
            transmitter_m: Vector3::from(point_m) + Vector3::new(0.001, -0.001, 0.001),
            room_m: transmitter().transform_point(&Vector3::from(point_m).into()).coords,
        });
        let found = align_recording(&recorded(&rig.log), &anchors, false).unwrap();
        let rotation_deg = turned(&found).to_degrees();
        let position_mm = 1e3
            * (found.alignment.room_from_transmitter.translation.vector - transmitter().translation.vector)
                .norm();
        assert!(
            rotation_deg < 0.5 && position_mm < 5.0,
            "transmitter: {rotation_deg} degrees, {position_mm} mm"
        );
    }
}

#[test]
fn a_radio_that_stutters_makes_no_alignment_too_short() {
    let (stage, scenario) = scenario(3, Vec::new());
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(36.0);
    let mut recording = recorded(&rig.log);
    // A quarter of a second out of every one and a half is lost.
    recording.imu.retain(|(t_s, _)| t_s % 1.5 > 0.25);
    let alignment = align_recording(&recording, &[], true).unwrap().alignment;
    let imu = alignment.q_sensor_imu.angle_to(&sits().rotation).to_degrees();
    let lever_mm = 1e3 * (alignment.lever_m - sits().translation.vector).norm();
    assert!(imu < 0.5 && lever_mm < 5.0, "IMU {imu} degrees, lever {lever_mm} mm");
    // Nothing is left where no stretch is as long as a second difference.
    recording.imu.retain(|(t_s, _)| t_s % 0.3 > 0.1);
    assert_eq!(align_recording(&recording, &[], true), Err(AlignError::TooShort { found: 0, needed: 200 }));
}

/// A wearer of the aligned pair: the stage file gives all of it.
fn stage_of(found: &Found) -> Stage {
    let [x, y, z] = OFFSET_M;
    let q = orientation_to_wxyz(&found.alignment.q_sensor_imu);
    let pose = transmitter();
    let text = STAGE.replace(
        "imu = { sensor = \"hand_imu\" }",
        &format!(
            "segment = \"forearm_r\"\nmount_quat_wxyz = [1.0, 0.0, 0.0, 0.0]\n\
             imu = {{ sensor = \"hand_imu\", quat_wxyz = {q:?}, offset_m = [{x}, {y}, {z}], clock_offset_ms = {} }}",
            1e3 * found.clock_offset_s
        ),
    ) + &format!(
        "[transmitter.pose_in_room]\nposition_m = {:?}\norientation_wxyz = {:?}\n[body]\nheight_m = 1.8\nmounting = \"given\"\n",
        <[f64; 3]>::from(pose.translation.vector),
        orientation_to_wxyz(&pose.rotation)
    );
    Stage::parse(&text).unwrap_or_else(|problems| panic!("{problems}"))
}

#[test]
fn the_imu_carries_the_pose_through_a_dropout_and_a_replay_says_the_same() {
    let (stage, quiet) = scenario(5, Vec::new());
    let mut rig = Rig::new(&stage, &quiet);
    rig.run_until(36.0);
    let found = aligned(&rig.log);

    let silent = vec![Fault::BirdDies { address: 0, at_s: 8.0, duration_s: Some(0.4) }];
    let (stage, scenario) = scenario(6, silent);
    let mut rig = Rig::new(&stage, &scenario);
    rig.pipeline = SupervisedPipeline::new(&stage_of(&found)).unwrap();
    rig.push(Input::Line { device: 0, event: posed_drivers::LineEvent::Opened { modem_lines: false } });
    rig.push(Input::Line { device: 1, event: posed_drivers::LineEvent::Opened { modem_lines: false } });
    rig.run_until(12.0);
    let (carried, count, all) = errors(&rig, 4.0);
    assert!(count > 30, "{count} frames without a record");
    assert!(carried[0] < 0.03 && carried[1] < 0.03, "{carried:?} m and rad");
    assert!(all[0] < 0.01 && all[1] < 0.03, "{all:?} m and rad");
    // The body goes on with it.
    let during = |body: &&Body| (8.1..8.35).contains(&body.t_valid.as_secs_f64());
    let bodies: Vec<&Body> = rig
        .emitted
        .iter()
        .filter_map(|emitted| match emitted {
            Said::Body(body) => Some(&**body),
            _ => None,
        })
        .collect();
    let forearm = posed_fusion::body::BodySegment::ForearmR.index();
    assert!(bodies.iter().copied().filter(during).count() > 10);
    assert!(bodies.iter().copied().filter(during).all(|body| {
        body.position_source == PositionSource::Trackers && body.segments[forearm].fault.is_none()
    }));
    assert!(rig.estimates().any(|e| e.sensors[0].coasted && e.sensors[0].state == SensorState::Missing));

    let middle = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 8.2);
    let mut pipeline = Pipeline::new(&stage_of(&found)).unwrap();
    let log: Vec<Entry> = rig.log.clone();
    let before = replay(&mut pipeline, &log[..middle]).len();
    let mut restored = Pipeline::restore(&stage_of(&found), pipeline.models(), &pipeline.snapshot()).unwrap();
    let whole = replay(&mut Pipeline::new(&stage_of(&found)).unwrap(), &log);
    assert_eq!(replay(&mut restored, &log[middle..]), whole[before..]);
}

#[test]
fn an_alignment_is_a_model_of_the_log() {
    let (stage, scenario) = scenario(5, Vec::new());
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(34.0);
    let found = aligned(&rig.log);
    let mut pipeline = Pipeline::new(&unaligned()).unwrap();
    let middle = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 31.0);
    let before = replay(&mut pipeline, &rig.log[..middle]);
    let mut rest = swapped_in(&found, rig.log[middle].t).to_vec();
    rest.extend_from_slice(&rig.log[middle..]);
    let after = replay(&mut pipeline, &rest);
    assert_eq!(pipeline.status().models_refused, 0);
    // Nobody knew where the transmitter stood, and now it is known.
    let off = |emitted: &[Said]| {
        let errors = emitted.iter().rev().filter_map(|emitted| match emitted {
            Said::Estimate(estimate) => error(&rig, estimate),
            _ => None,
        });
        errors.map(|(position_m, _)| position_m).next().unwrap()
    };
    assert!(off(&before) > 0.3 && off(&after) < 0.03, "{} then {} m", off(&before), off(&after));
}
