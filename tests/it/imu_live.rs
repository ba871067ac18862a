//! An IMU whose intrinsics are found live: from what the pipeline reports to a model of its log.

use nalgebra::{UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_fusion::intrinsics::Guide;
use posed_pipeline::Pipeline;
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{ImuCalibration, Motion};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input, Model};
use posed_stage::output::SensorState;

use posed_rig::{Rig, Said, replay};

const STAGE: &str = "name = \"table\"\n[[device]]\nname = \"unit\"\ndriver = \"x-imu3\"\nport = \"/dev/none\"\nbaud = 2000000\n\
    [[sensor]]\nname = \"watch\"\ndevice = \"unit\"\naddress = 0\n";

fn calibration_rig(seed: u64) -> Rig {
    let stage = Stage::parse(STAGE).unwrap_or_else(|problems| panic!("{problems}"));
    let motion =
        Motion::ImuCalibration(ImuCalibration { rest_s: 1.5, turn_s: 0.7, ..ImuCalibration::default() });
    let sensor = SensorScenario {
        name: "watch".into(),
        body: "hand".into(),
        segment: None,
        offset_m: [0.0; 3],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    let unit = DeviceScenario { name: "unit".into(), imu: ImuClass::Mpu, ..DeviceScenario::default() };
    let scenario = Scenario {
        seed,
        bodies: vec![BodySpec { name: "hand".into(), motion }],
        sensors: vec![sensor],
        devices: vec![unit],
        ..Scenario::default()
    };
    Rig::new(&stage, &scenario)
}

/// What the daemon's job makes of it.
fn guided(rig: &Rig) -> Guide {
    let mut guide = Guide::new(true);
    for estimate in rig.estimates() {
        let Some(record) = estimate.sensors[0].measured else { continue };
        guide.push(record.t_valid.as_secs_f64(), &record.inertial.unwrap().uncorrected().unwrap());
    }
    guide
}

/// True orientation at a time that lies within the run.
fn truth(rig: &Rig, t_s: f64) -> Option<UnitQuaternion<f64>> {
    let after = rig.host.truth.partition_point(|cycle| cycle.t.as_secs_f64() < t_s);
    let at = |at: usize| rig.host.truth.get(at).map(|cycle| (cycle.t.as_secs_f64(), cycle.sensors[0].pose));
    let ((a_s, a), (b_s, b)) = (at(after.checked_sub(1)?)?, at(after)?);
    Some(a.rotation.slerp(&b.rotation, ((t_s - a_s) / (b_s - a_s)).clamp(0.0, 1.0)))
}

/// Root mean square at rest, of how far the specific force that filters take points from straight up, degrees, and of the
/// angular velocity, deg/s.
fn at_rest(rig: &Rig, emitted: &[Said]) -> [f64; 2] {
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    for emitted in emitted {
        let Said::Estimate(estimate) = emitted else { continue };
        let t_s = estimate.t_valid.as_secs_f64();
        if !(0.2..1.3).contains(&(t_s % 2.2)) {
            continue;
        }
        let (Some(record), Some(truth)) = (estimate.sensors[0].measured, truth(rig, t_s)) else { continue };
        let sample = record.inertial.unwrap().sample().unwrap();
        let up = truth.inverse() * Vector3::z();
        sums[0] += sample.accel_m_s2.angle(&up).to_degrees().powi(2);
        sums[1] += sample.gyro_rad_s.norm().to_degrees().powi(2);
        count += 1.0;
    }
    assert!(count > 200.0, "{count} records");
    sums.map(|sum| f64::sqrt(sum / count))
}

#[test]
fn a_unit_that_was_placed_in_all_directions_is_corrected_from_then_on() {
    for seed in 1..=3 {
        let mut rig = calibration_rig(seed);
        rig.run_until(34.0);
        let guide = guided(&rig);
        assert_eq!(guide.prompt(), None, "{:?}", guide.progress());
        let found = guide.solve().unwrap();
        let unit = rig.pipeline.unit(0).unwrap().to_owned();
        assert!(unit.len() >= 8, "a serial number, not the sensor's name: {unit}");

        // The same log, with the intrinsics from its first entry on, and with none.
        let stage = Stage::parse(STAGE).unwrap();
        let with = |unit: &str| {
            let model = Model::Imu { unit: unit.into(), intrinsics: Box::new(found.clone()) };
            let mut log = rig.log.clone();
            log.insert(0, Entry { t: log[0].t, input: Input::Model(model) });
            log
        };
        let run = |log: &[Entry]| {
            let mut pipeline = Pipeline::new(&stage).unwrap();
            let emitted = replay(&mut pipeline, log);
            assert_eq!(pipeline.status().models_refused, 0);
            emitted
        };
        let [raw, corrected] = [run(&rig.log), run(&with(&unit))].map(|emitted| at_rest(&rig, &emitted));
        println!("unit {seed}: {raw:.2?} degrees and deg/s uncorrected, {corrected:.2?} corrected");
        // That all axes are turned together, no length shows.
        assert!(corrected[0] < 1.5 && corrected[0] < 0.5 * raw[0], "{raw:?} before, {corrected:?} after");
        assert!(raw[1] > 1.0 && corrected[1] < 0.5, "{raw:?} before, {corrected:?} after");
        // Another unit's do nothing.
        let estimates = |emitted: Vec<Said>| -> Vec<Said> {
            emitted.into_iter().filter(|emitted| matches!(emitted, Said::Estimate(_))).collect()
        };
        assert!(estimates(run(&with("0BADCAFE"))) == estimates(run(&rig.log)));
    }
}

#[test]
fn a_calibration_in_the_middle_begins_anew_at_once_and_a_replay_says_the_same() {
    let mut rig = calibration_rig(4);
    rig.run_until(34.0);
    let found = guided(&rig).solve().unwrap();
    let unit = rig.pipeline.unit(0).unwrap().to_owned();
    rig.push(Input::Model(Model::Imu { unit, intrinsics: Box::new(found.clone()) }));
    let swapped = rig.host.now;
    rig.run_until(44.0);
    let after = |emitted: &&posed_stage::output::Estimate| emitted.t_valid > swapped;
    // What the unit tells stays as it is; only the filters take the corrected numbers.
    let record = rig.estimates().filter(after).last().unwrap().sensors[0].measured.unwrap().inertial.unwrap();
    assert_eq!(record.corrected, record.uncorrected().map(|reported| found.apply(&reported)));
    assert!(record.corrected != record.uncorrected());
    // It is not trusted before it has settled.
    assert!(
        rig.estimates()
            .filter(after)
            .take(10)
            .any(|estimate| estimate.sensors[0].state == SensorState::Suspect)
    );

    let stage = Stage::parse(STAGE).unwrap();
    let middle =
        rig.log.partition_point(|entry| entry.t < Timestamp::from_secs_f64(swapped.as_secs_f64() + 1.0));
    let mut pipeline = Pipeline::new(&stage).unwrap();
    let before = replay(&mut pipeline, &rig.log[..middle]).len();
    let mut restored = Pipeline::restore(&stage, pipeline.models(), &pipeline.snapshot()).unwrap();
    assert!(replay(&mut restored, &rig.log[middle..]) == rig.emitted[before..]);
}

#[test]
fn intrinsics_of_another_unit_of_measure_are_refused() {
    let mut rig = calibration_rig(5);
    rig.run_until(34.0);
    let mut found = guided(&rig).solve().unwrap();
    found.mag.as_mut().unwrap().norm = 48.0;
    let model = Model::Imu { unit: "watch".into(), intrinsics: Box::new(found) };
    assert!(model.check().unwrap_err().contains("about 1, not 48"), "{:?}", model.check());
    rig.push(Input::Model(model));
    assert_eq!(rig.pipeline.status().models_refused, 1);
}
