//! The body as the pipeline reports it: a simulated person who wears virtual devices.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use posed_drivers::xbus::Sampling;
use posed_fusion::ahrs::ImuSample;
use posed_fusion::body::{
    ANGLE_NAMES, BodyFilter, BodyParams, BodySegment, Heading, SEGMENTS, SensorMount, Skeleton, angles,
};
use posed_fusion::faults::Cause;
use posed_pipeline::Pipeline;
use posed_simulator::body::Activity;
use posed_simulator::faults::Fault;
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{Motion, Person};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input, Request};
use posed_stage::output::{Body, Estimate, OutcomeKind, PositionSource, SegmentState, SensorState};
use posed_stage::signals::{self, BodyColumns};

use posed_rig::{Rig, Said, Sleepy, demo, replay};

const HEIGHT_M: f64 = 1.8;

/// How the sensor of a segment sits, w, x, y, z: each another way.
fn mount(segment: BodySegment) -> UnitQuaternion<f64> {
    let k = segment.index() as f64;
    UnitQuaternion::from_scaled_axis(
        Vector3::new(libm::sin(1.3 * k), libm::cos(2.1 * k), libm::sin(0.7 * k)) * 1.5,
    )
}

fn wxyz(q: &UnitQuaternion<f64>) -> [f64; 4] {
    [q.w, q.i, q.j, q.k]
}

/// Somebody who wears a device's sensors on these segments.
struct SimulatedBody {
    stage: Stage,
    scenario: Scenario,
    segments: Vec<BodySegment>,
}

/// All segments but the shoulders.
const FIFTEEN: &[BodySegment] = BodySegment::ALL.split_at(BodySegment::BEFORE_SHOULDERS).0;

fn simulated(
    device: &str,
    segments: &[BodySegment],
    address: impl Fn(u16) -> u16,
    person: Person,
) -> SimulatedBody {
    let mut text = format!(
        "name = \"person\"\n[[device]]\nname = \"worn\"\n{device}\n[body]\nheight_m = {HEIGHT_M}\nmounting = \"given\"\n"
    );
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let mut sensors = Vec::new();
    for (index, segment) in (1..).zip(segments) {
        let offset_m: [f64; 3] = (skeleton.usual_sensor_m(*segment) + Vector3::new(0.02, 0.01, 0.03)).into();
        let mount_quat_wxyz = wxyz(&mount(*segment));
        let name = format!("on_{}", segment.name());
        text += &format!(
            "[[sensor]]\nname = \"{name}\"\ndevice = \"worn\"\naddress = {}\nsegment = \"{}\"\n\
             mount_quat_wxyz = {mount_quat_wxyz:?}\noffset_m = {offset_m:?}\n",
            address(index),
            segment.name(),
        );
        sensors.push(SensorScenario {
            name,
            body: "person".into(),
            segment: Some(segment.name().into()),
            offset_m,
            mount_quat_wxyz,
        });
    }
    let body = BodySpec { name: "person".into(), motion: Motion::Person(person) };
    let devices = vec![DeviceScenario {
        name: "worn".into(),
        boot_ms: 0.0,
        imu: ImuClass::Ideal,
        ..DeviceScenario::default()
    }];
    let stage = Stage::parse(&text).unwrap_or_else(|problems| panic!("{problems}"));
    SimulatedBody {
        stage,
        scenario: Scenario { bodies: vec![body], sensors, devices, ..Scenario::default() },
        segments: segments.to_vec(),
    }
}

const XBUS: &str = "driver = \"xbus\"\nport = \"/dev/none\"\nbaud = 921600\nrate_hz = 100.0";

const SLIMEVR: &str = "driver = \"slimevr\"\nport = \"udp://0.0.0.0:6969\"";

const X_IMU3: &str = "driver = \"x-imu3\"\nport = \"/dev/none\"\nbaud = 2000000";

fn squatting() -> Person {
    Person { activity: Activity::Squats, height_m: HEIGHT_M, heading_deg: 40.0, ..Person::default() }
}

impl SimulatedBody {
    fn run(&self, seconds: f64) -> Rig {
        let mut rig = Rig::new(&self.stage, &self.scenario);
        rig.run_until(seconds);
        rig
    }

    /// True segments at a time: from the truth of the sensors on them.
    fn truth(&self, rig: &Rig, t_s: f64) -> [Option<Isometry3<f64>>; SEGMENTS] {
        // The cycles before and after it, of each sensor.
        type Seen = Option<(f64, Isometry3<f64>)>;
        let mut around: [[Seen; 2]; SEGMENTS] = [[None; 2]; SEGMENTS];
        for cycle in &rig.host.truth {
            let off_s = cycle.t.as_secs_f64() - t_s;
            for row in &cycle.sensors {
                let nearest = &mut around[self.segments[row.sensor].index()][usize::from(off_s > 0.0)];
                if nearest.is_none_or(|(nearest_s, _)| off_s.abs() < nearest_s) {
                    *nearest = Some((off_s.abs(), row.pose));
                }
            }
        }
        let mut found = [None; SEGMENTS];
        for (segment, sensor) in self.segments.iter().zip(&self.scenario.sensors) {
            let offset: Translation3<f64> = Vector3::from(sensor.offset_m).into();
            let segment_from_sensor = Isometry3::from_parts(offset, mount(*segment));
            let pose = match around[segment.index()] {
                [Some((before_s, before)), Some((after_s, after))] => {
                    before.lerp_slerp(&after, before_s / (before_s + after_s))
                }
                [one, other] => match one.or(other) {
                    Some((_, pose)) => pose,
                    None => continue,
                },
            };
            found[segment.index()] = Some(pose * segment_from_sensor.inverse());
        }
        found
    }
}

fn bodies(rig: &Rig) -> Vec<&Body> {
    rig.emitted
        .iter()
        .filter_map(|emitted| match emitted {
            Said::Body(body) => Some(&**body),
            _ => None,
        })
        .collect()
}

fn q(body: &Body, segment: BodySegment) -> UnitQuaternion<f64> {
    let [w, i, j, k] = body.segments[segment.index()].orientation_wxyz.unwrap();
    UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k))
}

/// The largest root mean square error of an angle of elbows, knees, hips and shoulders, and of a segment, degrees.
fn errors(simulated: &SimulatedBody, rig: &Rig, from_s: f64) -> (f64, f64) {
    let names = ["elbow_r_flexion", "elbow_l_flexion", "knee_r_flexion", "knee_l_flexion", "hip_r_flexion"];
    let mut sums = [0.0; 5];
    let mut rotations = [0.0; SEGMENTS];
    let mut count = 0.0;
    for body in bodies(rig).iter().filter(|body| body.t_valid.as_secs_f64() > from_s).step_by(20) {
        let truth = simulated.truth(rig, body.t_valid.as_secs_f64());
        let expected = angles(&truth.map(|pose| pose.map(|pose| pose.rotation)));
        for (sum, name) in sums.iter_mut().zip(names) {
            let index = ANGLE_NAMES.iter().position(|known| *known == name).unwrap();
            let (Some(got), Some(expected)) = (body.angles_rad[index], expected[index]) else { continue };
            *sum += (got - expected).powi(2);
        }
        for (segment, truth) in BodySegment::ALL.into_iter().zip(&truth) {
            let Some(truth) = truth else { continue };
            rotations[segment.index()] += q(body, segment).angle_to(&truth.rotation).powi(2);
        }
        count += 1.0;
    }
    assert!(count > 5.0, "{count} bodies");
    let worst = |sums: &[f64]| f64::sqrt(sums.iter().copied().fold(0.0, f64::max) / count).to_degrees();
    (worst(&sums), worst(&rotations))
}

#[test]
fn who_strolls_gets_as_far_as_the_feet_bring_him() {
    let strolling = Person { activity: Activity::Strolling, ..squatting() };
    let simulated = simulated(XBUS, FIFTEEN, |n| n, strolling);
    let rig = simulated.run(16.0);
    let pelvis = BodySegment::Pelvis.index();
    let all: Vec<&Body> = bodies(&rig).into_iter().filter(|body| body.contacts.is_some()).collect();
    let places_m = |body: &Body| {
        let truth = simulated.truth(&rig, body.t_valid.as_secs_f64())[pelvis].unwrap().translation.vector;
        (Vector3::from(body.segments[pelvis].position_m.unwrap()), truth)
    };
    let (begun_m, begun_truth_m) = places_m(all[0]);
    let mut way_m = 0.0;
    let mut last_m = begun_truth_m;
    let (mut nees, mut count) = (0.0, 0.0);
    for body in all.iter().step_by(20) {
        assert_eq!(body.position_source, PositionSource::Feet);
        let (found_m, truth_m) = places_m(body);
        way_m += (truth_m - last_m).norm();
        last_m = truth_m;
        let off_m = (found_m - begun_m) - (truth_m - begun_truth_m);
        assert!(off_m.norm() < 0.25, "{off_m} of {way_m} m");
        nees += off_m.xy().norm_squared() / (2.0 * body.position_sigma_m.unwrap().powi(2));
        count += 1.0;
    }
    let last_sigma_m = all.last().unwrap().position_sigma_m.unwrap();
    println!(
        "normalised error squared of the place {:.2}, stated at the end {last_sigma_m:.3} m",
        nees / count
    );
    assert!((0.05..2.0).contains(&(nees / count)) && last_sigma_m > 0.08, "{nees} {count} {last_sigma_m}");
    assert!(way_m > 8.0, "{way_m}");
    for foot in 0..2 {
        let contacts = || all.iter().filter_map(|body| Some(body.contacts?[foot].foot));
        assert!(contacts().any(|stands| stands > 0.9) && contacts().any(|stands| stands < 0.1));
    }
}

/// Shoulders that rise and come forward with arms are seen where they wear sensors, and bodies of messages have them then.
#[test]
fn seventeen_sensors_show_shoulders_that_move() {
    let reaching = Person { activity: Activity::Reaching, girdle: true, ..squatting() };
    let simulated = simulated(XBUS, &BodySegment::ALL, |n| n, reaching);
    let rig = simulated.run(12.0);
    let (_, worst_deg) = errors(&simulated, &rig, 6.0);
    assert!(worst_deg < 3.0, "{worst_deg}");
    let elevation = ANGLE_NAMES.iter().position(|name| *name == "sternoclavicular_r_elevation").unwrap();
    let (mut highest_rad, mut off_rad) = (0.0_f64, 0.0_f64);
    for body in bodies(&rig).iter().filter(|body| body.t_valid.as_secs_f64() > 6.0).step_by(20) {
        assert!(
            body.segments.len() == SEGMENTS && body.segments.iter().all(|of| of.state == SegmentState::Ok)
        );
        let truth = simulated.truth(&rig, body.t_valid.as_secs_f64());
        let expected_rad = angles(&truth.map(|pose| pose.map(|pose| pose.rotation)))[elevation].unwrap();
        highest_rad = highest_rad.max(expected_rad);
        off_rad = off_rad.max((body.angles_rad[elevation].unwrap() - expected_rad).abs());
        // The arm begins where the shoulder takes it.
        let [torso, arm] = [BodySegment::Torso, BodySegment::UpperArmR].map(|of| {
            let found_m = Vector3::from(body.segments[of.index()].position_m.unwrap());
            (found_m, truth[of.index()].unwrap().translation.vector)
        });
        let off_m = ((arm.0 - torso.0) - (arm.1 - torso.1)).norm();
        assert!(off_m < 0.03, "{off_m} m");
    }
    assert!(highest_rad > 0.1 && off_rad < 0.05, "{highest_rad} {off_rad} rad");
}

/// Taken for the other kind, samples are half a period late or early, which fast limbs show.
#[test]
fn samples_that_are_means_are_true_half_a_period_before_their_end() {
    let reaching = || Person { activity: Activity::Reaching, ..squatting() };
    let error_deg = |stated: &str, sampling: Sampling| {
        let device =
            format!("{} sampling = \"{stated}\"", XBUS.replace("rate_hz = 100.0", "rate_hz = 30.0\n"));
        let mut simulated = simulated(&device, FIFTEEN, |n| n, reaching());
        simulated.scenario.devices[0].sampling = sampling;
        errors(&simulated, &simulated.run(12.0), 4.0)
    };
    let [instants, means, late, early] = [
        error_deg("instantaneous", Sampling::Instantaneous),
        error_deg("mean", Sampling::Mean),
        error_deg("instantaneous", Sampling::Mean),
        error_deg("mean", Sampling::Instantaneous),
    ];
    println!("right {instants:.2?} {means:.2?}, wrong {late:.2?} {early:.2?} degrees");
    for (right, wrong) in [(means, late), (instants, early)] {
        assert!(right.0 < 0.6 * wrong.0 && right.1 < 0.8 * wrong.1, "{right:?} {wrong:?}");
    }
}

#[test]
fn ten_trackers_of_a_chain_show_a_person_who_squats() {
    let simulated = simulated(XBUS, FIFTEEN, |n| n, squatting());
    let rig = simulated.run(9.0);
    let all = bodies(&rig);
    assert!(all.len() > 700, "{} bodies in 9 s", all.len());
    assert!(all.windows(2).all(|pair| pair[0].t_valid < pair[1].t_valid));
    let (angle_deg, rotation_deg) = errors(&simulated, &rig, 4.0);
    assert!(
        angle_deg < 2.0 && rotation_deg < 4.0,
        "angles {angle_deg:.2}, segments {rotation_deg:.2} degrees"
    );
    let last = all.last().unwrap();
    assert!(last.segments.iter().all(|segment| segment.state == SegmentState::Ok), "{last:?}");
    assert_eq!((last.heading, last.position_source), (Heading::Field, PositionSource::Feet));
    // Feet on the floor, below the origin; the head end up.
    let z = |segment: BodySegment| last.segments[segment.index()].position_m.unwrap()[2];
    assert!(
        z(BodySegment::ShankR) < z(BodySegment::ThighR) && z(BodySegment::Pelvis) < z(BodySegment::Torso),
        "{last:?}"
    );
    assert!((0.3..0.6).contains(&z(BodySegment::ShankR)), "{last:?}");
}

/// The filter that `posed body solve` runs over a file, over the records of the same run.
#[test]
fn live_and_offline_say_the_same() {
    let simulated = simulated(XBUS, FIFTEEN, |n| n, squatting());
    let rig = simulated.run(4.0);
    let sits = |segment: BodySegment, offset_m: [f64; 3]| SensorMount {
        q_segment_sensor: mount(segment),
        offset_m: offset_m.into(),
        heading_rad: None,
        sigma_rad: Vector3::zeros(),
    };
    let all: Vec<_> = simulated.segments.iter().zip(&simulated.scenario.sensors).collect();
    let all = BodySegment::ALL.map(|segment| {
        all.iter().find(|(at, _)| **at == segment).map(|(_, sensor)| sits(segment, sensor.offset_m))
    });
    let mut filter = BodyFilter::new(&Skeleton::from_height(HEIGHT_M), &all, &BodyParams::default());
    filter.await_field();
    let mut last_s = None;
    let offline: Vec<_> = rig
        .estimates()
        .filter_map(|estimate| {
            let sample = |segment: BodySegment| {
                let inertial = estimate.sensors.get(segment.index())?.measured?.inertial?;
                Some(ImuSample {
                    gyro_rad_s: inertial.angular_velocity_rad_s?.into(),
                    accel_m_s2: inertial.specific_force_m_s2?.into(),
                    mag: inertial.magnetic_field.map(Vector3::from),
                })
            };
            let samples = BodySegment::ALL.map(sample);
            samples.iter().any(Option::is_some).then_some(())?;
            let t_s = estimate.t_valid.as_secs_f64();
            let dt_s = last_s.map_or(0.01, |last| t_s - last);
            last_s = Some(t_s);
            Some(filter.push(&samples, dt_s).clone())
        })
        .collect();
    let live = bodies(&rig);
    assert_eq!(live.len(), offline.len());
    for (live, offline) in live.iter().zip(&offline) {
        for (got, expected) in live.angles_rad.iter().zip(&offline.angles_rad) {
            let off = got.zip(*expected).map_or(0.0, |(a, b)| (a - b).abs());
            assert!(got.is_some() == expected.is_some() && off < 1e-9, "{off}");
        }
    }
}

#[test]
fn a_replay_that_begins_in_the_middle_says_the_same_body() {
    let simulated = simulated(XBUS, FIFTEEN, |n| n, squatting());
    let rig = simulated.run(4.0);
    let middle = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 2.3);
    let mut pipeline = Pipeline::new(&simulated.stage).unwrap();
    let before = replay(&mut pipeline, &rig.log[..middle]).len();
    let mut restored = Pipeline::restore(&simulated.stage, pipeline.models(), &pipeline.snapshot()).unwrap();
    assert_eq!(replay(&mut restored, &rig.log[middle..]), rig.emitted[before..]);
}

#[test]
fn units_with_clocks_of_their_own_and_units_that_only_tell_their_orientation_show_it_too() {
    let arm = [BodySegment::Torso, BodySegment::UpperArmR, BodySegment::ForearmR];
    let reaching = Person { activity: Activity::Curls, ..squatting() };
    for (device, address, limits) in
        [(X_IMU3, (|n| n + 40) as fn(u16) -> u16, (3.0, 9.0)), (SLIMEVR, |n| n, (6.0, 180.0))]
    {
        let simulated = simulated(device, &arm, address, reaching.clone());
        let rig = simulated.run(8.0);
        let (angle_deg, rotation_deg) = errors(&simulated, &rig, 4.0);
        assert!(
            angle_deg < limits.0 && rotation_deg < limits.1,
            "{device}: {angle_deg:.2}, {rotation_deg:.2} degrees"
        );
    }
}

#[test]
fn trackers_alone_show_the_whole_figure_and_where_it_is() {
    let segments = [
        BodySegment::Torso,
        BodySegment::Pelvis,
        BodySegment::ForearmR,
        BodySegment::ForearmL,
        BodySegment::ShankR,
        BodySegment::ShankL,
    ];
    let device = "driver = \"motionstar\"\nport = \"tcp://127.0.0.1:6000\"";
    let person = Person { position_m: [1.2, 0.0, -0.9], heading_deg: 180.0, ..squatting() };
    let mut simulated = simulated(device, &segments, |n| n, person.clone());
    simulated.scenario.max_range_m = Some(3.0);
    let rig = simulated.run(8.0);
    let (angle_deg, rotation_deg) = errors(&simulated, &rig, 4.0);
    assert!(
        angle_deg < 6.0 && rotation_deg < 6.0,
        "angles {angle_deg:.2}, segments {rotation_deg:.2} degrees"
    );
    let last = *bodies(&rig).last().unwrap();
    assert_eq!(last.position_source, PositionSource::Trackers);
    let state = |segment: BodySegment| last.segments[segment.index()].state;
    assert_eq!(
        [state(BodySegment::ForearmR), state(BodySegment::UpperArmR)],
        [SegmentState::Ok, SegmentState::Inferred]
    );
    let truth = simulated.truth(&rig, last.t_valid.as_secs_f64())[BodySegment::Pelvis.index()].unwrap();
    let position_m = Vector3::from(last.segments[BodySegment::Pelvis.index()].position_m.unwrap());
    assert!((position_m - truth.translation.vector).norm() < 0.03, "{position_m} is not {truth}");
}

#[test]
fn a_tracker_of_a_vrpn_server_on_the_pelvis_says_where_a_body_of_imus_is() {
    let far = Person { position_m: [3.0, 2.0, 0.0], ..squatting() };
    let mut simulated = simulated(XBUS, FIFTEEN, |n| n, far);
    let seen = Stage::parse(
        "name = \"seen\"\n[[device]]\nname = \"cameras\"\ndriver = \"vrpn\"\nport = \"tcp://10.0.0.9:3883\"\n\
         trackers = [\"Hips\"]\n[[sensor]]\nname = \"hips\"\ndevice = \"cameras\"\naddress = 1\n",
    );
    let seen = seen.unwrap_or_else(|problems| panic!("{problems}"));
    // The cameras see a plate on which the IMU of the pelvis sits.
    let pelvis = BodySegment::Pelvis.index();
    let mut hips = simulated.stage.sensors[pelvis].clone();
    (hips.name, hips.device, hips.address) = ("hips".into(), "cameras".into(), 1);
    let mut rides = simulated.scenario.sensors[pelvis].clone();
    rides.name = "hips".into();
    let hidden = Fault::BirdDies { address: 1, at_s: 5.0, duration_s: Some(1.5) };
    simulated.stage.devices.extend(seen.devices);
    simulated.stage.sensors.push(hips);
    simulated.segments.push(BodySegment::Pelvis);
    simulated.scenario.sensors.push(rides);
    simulated.scenario.devices.push(DeviceScenario {
        name: "cameras".into(),
        boot_ms: 0.0,
        faults: vec![hidden],
        ..DeviceScenario::default()
    });
    let rig = simulated.run(9.0);
    let (mut worst_m, mut seen, mut hidden) = (0.0_f64, 0, 0);
    for body in bodies(&rig).into_iter().filter(|body| body.t_valid.as_secs_f64() > 3.0).step_by(10) {
        let t_s = body.t_valid.as_secs_f64();
        if body.position_source != PositionSource::Trackers {
            assert!((5.0..7.0).contains(&t_s), "{t_s}: {:?}", body.position_source);
            hidden += 1;
            continue;
        }
        seen += 1;
        let truth = simulated.truth(&rig, t_s)[pelvis].unwrap();
        let position_m = Vector3::from(body.segments[pelvis].position_m.unwrap());
        worst_m = worst_m.max((position_m - truth.translation.vector).norm());
    }
    println!("{seen} seen, {hidden} hidden, worst {:.1} mm", 1e3 * worst_m);
    assert!(seen > 25 && hidden > 5, "{seen} {hidden}");
    assert!(worst_m < 0.02, "{worst_m}");
}

#[test]
fn a_dead_sensor_is_named_within_a_second_and_the_rest_keeps_moving() {
    let mut simulated = simulated(X_IMU3, FIFTEEN, |n| n + 40, squatting());
    let address = 41 + BodySegment::ForearmL.index() as u16;
    simulated.scenario.devices[0].faults = vec![Fault::BirdDies { address, at_s: 4.0, duration_s: None }];
    let rig = simulated.run(7.0);
    let fault = |body: &&&Body| body.segments[BodySegment::ForearmL.index()].fault == Some(Cause::Missing);
    let all = bodies(&rig);
    let named = all.iter().find(fault).expect("it is named");
    let named_s = named.t_valid.as_secs_f64();
    assert!((4.0..6.5).contains(&named_s), "{named_s}");
    assert_eq!(named.segments[BodySegment::ForearmL.index()].state, SegmentState::Suspect);
    let status = rig.pipeline.status().bodies.remove(0).unwrap();
    let reported: Vec<_> = status.faults.iter().map(|(_, segment, fault)| (*segment, *fault)).collect();
    // A neighbour that loses its partner may be named beside it, nobody else.
    assert!(reported.contains(&("forearm_l", Cause::Missing)), "{reported:?}");
    assert!(
        reported.iter().all(|(segment, _)| ["forearm_l", "upper_arm_l"].contains(segment)),
        "{reported:?}"
    );
    let knee = ANGLE_NAMES.iter().position(|name| *name == "knee_r_flexion").unwrap();
    let after: Vec<f64> = all
        .iter()
        .filter(|body| body.t_valid > named.t_valid)
        .filter_map(|body| body.angles_rad[knee])
        .collect();
    assert!(after.len() > 50);
    let moved =
        after.iter().copied().fold(f64::MIN, f64::max) - after.iter().copied().fold(f64::MAX, f64::min);
    assert!(moved > 0.3, "{moved}");
}

#[test]
fn angles_are_columns_of_exercises() {
    let simulated = simulated(XBUS, FIFTEEN, |n| n, squatting());
    let columns = signals::columns_of(&simulated.stage);
    let knee = columns.iter().position(|name| name == "knee_r_flexion_deg").unwrap();
    let rig = simulated.run(3.0);
    let angles = BodyColumns::of(&simulated.stage);
    let mut newest = None;
    let (mut row, mut most) = (Vec::new(), f64::MIN);
    for emitted in &rig.emitted {
        match emitted {
            Said::Body(news) => newest = Some(&**news),
            Said::Estimate(estimate) => {
                signals::write(estimate, &mut row);
                angles.append(|_| newest, estimate, &mut row);
                assert_eq!(row.len(), columns.len());
                most = most.max(row[knee].unwrap_or(f64::MIN));
            }
            _ => {}
        }
    }
    assert!((30.0..110.0).contains(&most), "{most} degrees");
}

#[test]
fn nobody_is_shown_before_the_mounting_is_known() {
    let mut simulated = simulated(XBUS, FIFTEEN, |n| n, squatting());
    simulated.stage.bodies[0].mounting = posed_stage::Mounting::Calibrate;
    let rig = simulated.run(2.0);
    assert!(rig.estimates().count() > 50 && bodies(&rig).is_empty());
    assert!(!rig.pipeline.status().bodies[0].as_ref().unwrap().mounted);
    // Two sensors on one segment are refused.
    simulated.stage.sensors[0].segment = Some("pelvis".into());
    let refused = Pipeline::new(&simulated.stage).unwrap_err().to_string();
    assert!(refused.contains("\"on_torso\" and \"on_pelvis\" sit on the same segment"), "{refused}");
}

/// Somebody without a compass says which way is ahead; where the field says it, that is refused.
#[test]
fn who_looks_ahead_resets_the_heading() {
    let posing =
        Person { activity: Activity::Poses, height_m: HEIGHT_M, heading_deg: 40.0, ..Person::default() };
    let mut simulated = simulated(XBUS, FIFTEEN, |n| n, posing);
    let request = |sensor: Option<&str>, degrees: f64| Request::HeadingReset {
        body: None,
        sensor: sensor.map(str::to_owned),
        heading_rad: degrees.to_radians(),
    };
    let refused = |rig: &Rig, request: &Request| rig.pipeline.check_request(request).unwrap_err().to_string();
    let rig = simulated.run(1.0);
    let sentence = refused(&rig, &request(None, 0.0));
    assert!(sentence.contains("where the field tells it, nobody has to"), "{sentence}");

    simulated.stage.sensors.iter_mut().for_each(|sensor| sensor.magnetometer = false);
    let mut rig = simulated.run(1.0);
    let ahead_deg = |rig: &Rig| {
        let forward = q(bodies(rig).last().unwrap(), BodySegment::Pelvis) * Vector3::x();
        libm::atan2(forward.y, forward.x).to_degrees()
    };
    assert!(ahead_deg(&rig).abs() < 3.0, "{}", ahead_deg(&rig));
    let sentence = refused(&rig, &request(Some("nobody"), 0.0));
    assert!(sentence.contains("no sensor \"nobody\""), "{sentence}");
    assert!(refused(&rig, &request(None, f64::NAN)).contains("heading_deg"));
    rig.pipeline.check_request(&request(Some("on_head"), 0.0)).unwrap();
    let entry = Entry { t: rig.host.now, input: Input::Request(request(None, 40.0)) };
    rig.pipeline.push(&entry, &mut |_| {});
    rig.run_until(1.5);
    assert!((ahead_deg(&rig) - 40.0).abs() < 3.0, "{}", ahead_deg(&rig));
    // Nobody looks better ahead than that.
    let sigma_deg = bodies(&rig).last().unwrap().heading_sigma_rad.unwrap().to_degrees();
    assert!((2.5..3.5).contains(&sigma_deg), "{sigma_deg}");
    assert_eq!(rig.pipeline.status().requests_refused, 0);
}

/// And so may whoever wears the trackers: by the button of one, or in the way that a SlimeVR tracker has for it.
#[test]
fn a_press_on_a_tracker_resets_the_heading() {
    let posing =
        || Person { activity: Activity::Poses, height_m: HEIGHT_M, heading_deg: 40.0, ..Person::default() };
    for (device, asks) in [(X_IMU3, true), (X_IMU3, false), (SLIMEVR, true), (XBUS, true), (XBUS, false)] {
        let address = |n: u16| if device == X_IMU3 { n + 20 } else { n };
        let on_torso = address(1 + BodySegment::Torso.index() as u16);
        let mut simulated = simulated(device, FIFTEEN, address, posing());
        simulated.stage.sensors.iter_mut().for_each(|sensor| sensor.magnetometer = false);
        simulated.stage.bodies[0].reset_by_button = asks && device == X_IMU3;
        let asked = match device {
            XBUS => Fault::DoubleTap { address: on_torso, at_s: 3.95 },
            _ => Fault::Button { address: on_torso, at_s: 4.5 },
        };
        simulated.scenario.devices[0].faults.push(asked);
        if asks && device == XBUS {
            simulated.stage.bodies[0].reset_by_double_tap = Some("torso".into());
        }
        let mut rig = simulated.run(3.0);
        let ahead_deg = |rig: &Rig| {
            let forward = q(bodies(rig).last().unwrap(), BodySegment::Pelvis) * Vector3::x();
            libm::atan2(forward.y, forward.x).to_degrees()
        };
        let turned = Request::HeadingReset { body: None, sensor: None, heading_rad: 40_f64.to_radians() };
        rig.pipeline.push(&Entry { t: rig.host.now, input: Input::Request(turned) }, &mut |_| {});
        rig.run_until(3.9);
        assert!((ahead_deg(&rig) - 40.0).abs() < 3.0, "{device}: {}", ahead_deg(&rig));
        rig.run_until(5.2);
        let expected_deg = if asks { 0.0 } else { 40.0 };
        assert!((ahead_deg(&rig) - expected_deg).abs() < 3.0, "{device}: {}", ahead_deg(&rig));
        let said = |emitted: &Said| matches!(emitted, Said::Warning(_, text) if text.contains("asked for on a tracker"));
        assert_eq!(rig.emitted.iter().any(said), asks, "{device}");
    }
}

/// The stage that newcomers see: a body at once, where the trackers on it say.
#[test]
fn the_demo_shows_a_body_that_stands_where_it_stands() {
    let (_, mut rig) = demo();
    rig.run_until(6.0);
    let first_s = bodies(&rig)[0].t_valid.as_secs_f64();
    assert!(first_s < 2.0, "{first_s}");
    let last = *bodies(&rig).last().unwrap();
    assert_eq!(last.position_source, PositionSource::Trackers);
    let [x, y, z] = last.segments[BodySegment::Pelvis.index()].position_m.unwrap();
    assert!(libm::hypot(x - 0.85, y + 0.35) < 0.08 && (0.85..1.0).contains(&z), "{x} {y} {z}");
    let forward = q(last, BodySegment::Pelvis) * Vector3::x();
    assert!((forward + Vector3::x()).norm() < 0.15, "{forward}");
    // Trunk and limbs wear sensors; head, hands and feet hang on them.
    assert_eq!(last.segments.len(), BodySegment::BEFORE_SHOULDERS);
    for segment in FIFTEEN.iter().copied() {
        let hangs = BodySegment::EXTREMITIES.contains(&segment);
        let expected = if hangs { SegmentState::Inferred } else { SegmentState::Ok };
        assert_eq!(last.segments[segment.index()].state, expected, "{last:?}");
    }
    assert_eq!(rig.pipeline.status().bodies[0].as_ref().unwrap().faults, []);
    // A stream of entries without sense does not disturb it.
    let entry = Entry { t: rig.host.now, input: Input::Timer };
    let mut emitted = Vec::new();
    rig.pipeline.push(&entry, &mut |output| emitted.extend(Said::of_tracking(&output)));
    assert!(emitted.iter().all(|emitted| !matches!(emitted, Said::Body(_))));
}

/// What begins and has not settled is no fault and no loss: to an operator who did everything right none is reported.
#[test]
fn the_demo_begins_without_a_fault_or_a_loss() {
    let (_, mut rig) = demo();
    rig.run_until(6.0);
    let faults: Vec<_> = rig
        .emitted
        .iter()
        .filter(|said| matches!(said, Said::Outcome(outcome) if matches!(outcome.what, OutcomeKind::Fault { .. })))
        .collect();
    assert!(faults.is_empty(), "{faults:?}");
    let status = rig.pipeline.status();
    for device in &status.devices {
        assert_eq!((device.counters.rejected, device.counters.bytes_skipped), (0, 0), "{device:?}");
    }
    for sensor in &status.sensors {
        assert!(sensor.samples > 300 && sensor.lost == 0, "{sensor:?}");
    }
    let last = rig.estimates().last().unwrap();
    assert!(last.sensors.iter().all(|sensor| sensor.state == SensorState::Ok), "{last:?}");
}

/// A record that a busy host reads too late for its frame is missing there; a fault is what lasts.
#[test]
fn a_busy_host_makes_gaps_and_no_sensor_is_missing() {
    let (_, mut rig) = demo();
    rig.host.sleepy = Some(Sleepy::new(3, 0.02, 40.0, 5.0));
    rig.run_until(20.0);
    let is_gap = |estimate: &&Estimate| estimate.sensors[..3].iter().any(|s| s.state == SensorState::Missing);
    assert!(rig.estimates().filter(is_gap).count() > 3);
    let is_missing = |said: &&Said| {
        let missing = |what: &OutcomeKind| matches!(what, OutcomeKind::Fault { cause: Cause::Missing, .. });
        matches!(said, Said::Outcome(outcome) if missing(&outcome.what))
    };
    let missing: Vec<_> = rig.emitted.iter().filter(is_missing).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

/// After its sets the demo's person walks behind the transmitter and out of its reach, where its words are mirrored and then stand still, and comes back.
#[test]
fn the_demos_person_walks_about_the_room_on_its_feet() {
    let (stage, mut rig) = demo();
    // The walk lasts from 120.4 to 134 s; the feet know the place from before.
    rig.run_until(118.0);
    rig.forget();
    rig.run_until(136.0);
    let index = stage.sensors.iter().position(|sensor| sensor.name == "imu_pelvis").unwrap();
    let worn = &stage.sensors[index];
    let sits = posed_geometry::isometry(worn.offset_m.unwrap(), worn.mount_quat_wxyz.unwrap()).unwrap();
    let truth: Vec<(f64, Vector3<f64>)> = (rig.host.truth.iter())
        .flat_map(|cycle| cycle.sensors.iter().map(|row| (cycle.t.as_secs_f64(), row)))
        .filter(|(_, row)| row.sensor == index)
        .map(|(t_s, row)| (t_s, (row.pose * sits.inverse()).translation.vector))
        .collect();
    let (mut by_feet_s, mut stands) = (0.0, [[false; 2]; 2]);
    let (mut furthest_m, mut worst_m): (f64, f64) = (0.0, 0.0);
    for body in bodies(&rig) {
        let t_s = body.t_valid.as_secs_f64();
        let at = truth.partition_point(|(true_s, _)| *true_s < t_s).min(truth.len() - 1);
        let pelvis_m = Vector3::from(body.segments[BodySegment::Pelvis.index()].position_m.unwrap());
        let off_m = (pelvis_m - truth[at].1).norm();
        assert!(off_m < 0.08, "{off_m:.2} m away at {t_s:.2} s, by {:?}", body.position_source);
        worst_m = worst_m.max(off_m);
        furthest_m = furthest_m.max((truth[at].1 - truth[0].1).norm());
        if body.position_source == PositionSource::Feet {
            by_feet_s += 0.01;
            assert!(off_m < 3.0 * body.position_sigma_m.unwrap() + 0.01, "{off_m:.3} m at {t_s:.2} s");
            for (seen, contact) in stands.iter_mut().zip(body.contacts.unwrap()) {
                seen[usize::from(contact.foot > 0.5)] = true;
            }
        }
    }
    println!("off by up to {worst_m:.3} m, {by_feet_s:.1} s by the feet");
    assert!(by_feet_s > 4.0 && furthest_m > 1.5, "{by_feet_s} s by the feet, {furthest_m} m away");
    assert_eq!(stands, [[true; 2]; 2], "each foot stands, and leaves the floor");
    assert_eq!(bodies(&rig).last().unwrap().position_source, PositionSource::Trackers);
}
