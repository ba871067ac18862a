//! All kinds of devices on one stage: each leaves in turn and costs the others nothing, what is lost is counted, times
//! are right where the device counts, and orientations are what they are.

use std::collections::BTreeSet;

use posed_drivers::State;
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::motion::Motion;
use posed_simulator::scenario::{DeviceScenario, Scenario};
use posed_stage::Stage;
use posed_stage::output::SensorState;

use super::judge::{cycles, nearest};
use super::{QUIET, scene};
use posed_rig::{Rig, replay};

/// When the first device leaves, for how long, and how far the next one is behind it, s.
const FIRST_S: f64 = 8.0;
const AWAY_S: f64 = 2.0;
const TURN_S: f64 = 8.0;

fn many() -> Stage {
    let text = include_str!("../../../config/many-devices.toml");
    let mut stage = Stage::parse(text).unwrap_or_else(|problems| panic!("{problems}"));
    // The hands move before a transmitter at the room's origin.
    stage.transmitter.pose_in_room = None;
    stage
}

/// Hands that move, `slower` than elsewhere, and these faults of each device.
fn rig(stage: &Stage, devices: Vec<DeviceScenario>, slower: f64) -> Rig {
    let names: Vec<&str> = stage.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let mut scenario: Scenario = scene(3, QUIET, &names, devices);
    for body in &mut scenario.bodies {
        if let Motion::Orbit(orbit) = &mut body.motion {
            orbit.period_s *= slower;
            orbit.turn_period_s *= slower;
        }
    }
    Rig::new(stage, &scenario)
}

fn sensors_of<'a>(stage: &'a Stage, device: &'a str) -> impl Iterator<Item = usize> + 'a {
    stage.sensors.iter().enumerate().filter(move |(_, sensor)| sensor.device == device).map(|(at, _)| at)
}

/// Rounds of the short run; `POSED_SOAK_S=600` makes it ten minutes.
fn rounds(stage: &Stage) -> u32 {
    let soak_s: f64 = std::env::var("POSED_SOAK_S").ok().and_then(|text| text.parse().ok()).unwrap_or(0.0);
    let round_s = TURN_S * stage.devices.len() as f64;
    ((soak_s - FIRST_S) / round_s).ceil().max(1.0) as u32
}

/// True cycles of a device without a record of this sensor: those inside the gaps of its measured times.
fn cycles_in_gaps(rig: &Rig, device: usize, sensor: usize) -> u64 {
    let cycles = rig.host.truth.iter().filter(|cycle| cycle.device == device);
    let mine = cycles.filter(|cycle| cycle.sensors.iter().any(|row| row.sensor == sensor));
    let cycles: Vec<f64> = mine.map(|cycle| cycle.t.as_secs_f64()).collect();
    let ok = rig.estimates().filter(|e| e.sensors[sensor].state == SensorState::Ok);
    let times: Vec<f64> =
        ok.filter_map(|e| e.sensors[sensor].measured).map(|m| m.t_valid.as_secs_f64()).collect();
    // Two records may share a frame where rates differ, which is no gap.
    let gaps = times.windows(2).filter(|pair| pair[1] - pair[0] > 0.1);
    let inside =
        |pair: &[f64]| cycles.iter().filter(|t| (pair[0] + 0.005..pair[1] - 0.005).contains(*t)).count();
    gaps.map(|pair| inside(pair) as u64).sum()
}

/// True cycles of a device in this time, s, without a record of the sensor.
fn cycles_without_record(rig: &Rig, device: usize, sensor: usize, span_s: std::ops::Range<f64>) -> u64 {
    let records = rig.estimates().filter_map(|e| e.sensors[sensor].measured);
    let times: Vec<f64> = records.map(|measured| measured.t_valid.as_secs_f64()).collect();
    let cycles = rig.host.truth.iter().filter(|cycle| cycle.device == device);
    let lost = cycles.map(|cycle| cycle.t.as_secs_f64()).filter(|t| {
        let after = times.partition_point(|time| *time < t - 0.003);
        span_s.contains(t) && times.get(after).is_none_or(|time| *time > t + 0.003)
    });
    lost.count() as u64
}

#[test]
fn each_device_leaves_in_turn_and_the_others_lose_nothing() {
    let stage = many();
    let (rounds, count) = (rounds(&stage), stage.devices.len());
    let leaves_s =
        |round: u32, device: usize| FIRST_S + TURN_S * (f64::from(round) * count as f64 + device as f64);
    let devices = stage.devices.iter().enumerate().map(|(index, device)| DeviceScenario {
        name: device.name.clone(),
        rate_hz: 100.0,
        drift_ppm: 20.0 * index as f64 - 50.0,
        faults: (0..rounds)
            .map(|round| Fault::Unplug {
                at_s: leaves_s(round, index),
                duration_s: Some(AWAY_S),
                power: false,
            })
            .collect(),
        ..DeviceScenario::default()
    });
    let mut rig = rig(&stage, devices.collect(), 1.0);
    rig.run_until(FIRST_S - 0.5);
    for (device, status) in stage.devices.iter().zip(rig.pipeline.status().devices) {
        assert_eq!(status.state, State::Streaming, "{}: {:?}", device.name, rig.emitted.last());
    }
    for round in 0..rounds {
        for (index, device) in stage.devices.iter().enumerate() {
            let from_s = leaves_s(round, index) - 0.5;
            rig.run_until(from_s);
            rig.forget();
            let before = rig.pipeline.status();
            rig.run_until(from_s + TURN_S - 0.1);
            let after = rig.pipeline.status();
            for (at, sensor) in stage.sensors.iter().enumerate() {
                let lost = after.sensors[at].lost - before.sensors[at].lost;
                if sensor.device != device.name {
                    assert!(lost == 0, "{} lost {lost} while {} was away", sensor.name, device.name);
                    continue;
                }
                let truth = cycles_in_gaps(&rig, index, at);
                println!("{}: {lost} counted as lost, {truth} in truth", sensor.name);
                // Set up anew, a device begins another count: the gap is estimated from time.
                assert!(lost.abs_diff(truth) <= 1, "{}: {lost} of {truth}", sensor.name);
                assert!(after.sensors[at].estimated, "{} says that it is estimated from time", sensor.name);
            }
            assert_eq!(after.devices[index].state, State::Streaming, "{} is back", device.name);
        }
    }
}

#[test]
fn what_a_line_loses_is_counted_as_it_is() {
    let stage = many();
    let span = Bytes { count: 40, start_s: 8.0, end_s: 18.0 };
    let device = |name: &str, fault| DeviceScenario {
        name: name.into(),
        rate_hz: 100.0,
        faults: vec![fault],
        ..DeviceScenario::default()
    };
    let devices = vec![
        device("chain", Fault::LostBytes(span)),
        device("imu-a", Fault::LostBytes(span)),
        device("imu-b", Fault::LostDatagrams(span)),
        device("star", Fault::LostBytes(span)),
    ];
    let mut rig = rig(&stage, devices, 1.0);
    rig.run_until(7.0);
    rig.forget();
    let before = rig.pipeline.status();
    rig.run_until(20.0);
    let after = rig.pipeline.status();
    let mut devices_hit = 0;
    for (index, device) in stage.devices.iter().enumerate() {
        let (mut lost_of_device, mut hit_of_device) = (0, 0);
        for at in sensors_of(&stage, &device.name) {
            let mine = |address: Option<u16>| address.is_none_or(|of| of == stage.sensors[at].address);
            let hit = rig.host.losses.iter().filter(|(of, _, loss)| *of == index && mine(loss.address));
            let cycles: BTreeSet<u64> = hit.map(|(_, _, loss)| loss.cycle).collect();
            let (before, after) = (before.sensors[at], after.sensors[at]);
            let lost = after.lost - before.lost;
            // What came and was not good counts too, and is no loss of the line.
            let refused = |e: &&posed_stage::output::Estimate| {
                let sensor = &e.sensors[at];
                sensor.measured.is_some() && sensor.state != SensorState::Ok
            };
            let refused = rig.estimates().filter(refused).count() as u64;
            let hit = cycles.len() as u64;
            let name = &stage.sensors[at].name;
            println!("{name}: {lost} lost, {refused} refused, {hit} cycles hit, {}", after.estimated);
            (lost_of_device, hit_of_device) = (lost_of_device + lost, hit_of_device.max(hit));
            match device.name.as_str() {
                // Its counter tells exactly which cycles have no record.
                "chain" => {
                    let missing = cycles_without_record(&rig, index, at, 7.5..19.5);
                    assert!(lost == missing && !after.estimated, "{name}: {lost} of {missing}");
                    assert!((hit..=hit + 2).contains(&lost), "{name}: {lost} of {hit} hit");
                }
                _ if hit == 0 => assert_eq!(lost, refused, "{name}"),
                // A byte lost in one record of a packet costs the others nothing.
                "star" => {
                    let cycles = rig.host.truth.iter().filter(|cycle| cycle.device == index);
                    let measured = cycles.filter(|cycle| cycle.t.as_secs_f64() > 7.0).count() as u64;
                    let ok =
                        rig.estimates().filter(|e| e.sensors[at].state == SensorState::Ok).count() as u64;
                    println!("{measured} measured, {ok} ok");
                    assert!(
                        (measured - ok).abs_diff(lost) <= 2 && !after.estimated,
                        "{name}: {lost} of {}",
                        measured - ok
                    );
                    assert!(lost <= hit + 2, "{name}: {lost} of {hit}");
                }
                // By time stamps, and by numbers of packets that may hold something else.
                _ => assert!(
                    (lost - refused).abs_diff(hit) <= 2 && after.estimated,
                    "{name}: {lost} less {refused} of {hit}"
                ),
            }
        }
        // A packet that is hit costs one of its sensors a record at least.
        assert!(lost_of_device >= hit_of_device.saturating_sub(2), "{}: {lost_of_device}", device.name);
        // Forty bytes or datagrams in as many cycles, but for the few that fall together.
        assert!(hit_of_device == 0 || (36..=40).contains(&hit_of_device), "{hit_of_device} cycles hit");
        devices_hit += usize::from(hit_of_device > 0);
    }
    assert_eq!(devices_hit, 4);
}

/// Errors of the capture times of a device's records against the nearest true cycle, s.
fn time_errors(rig: &Rig, stage: &Stage, device: usize, from_s: f64) -> Vec<f64> {
    let times: Vec<f64> = rig
        .host
        .truth
        .iter()
        .filter(|cycle| cycle.device == device)
        .map(|cycle| cycle.t.as_secs_f64())
        .collect();
    let sensor = sensors_of(stage, &stage.devices[device].name).next().unwrap();
    rig.estimates()
        .filter(|estimate| estimate.t_valid.as_secs_f64() > from_s)
        .filter_map(|estimate| estimate.sensors[sensor].measured)
        .map(|measured| {
            let t_s = measured.t_valid.as_secs_f64();
            let at = times.partition_point(|time| *time < t_s);
            let near = |at: usize| times.get(at).map_or(f64::INFINITY, |time| t_s - time);
            let (earlier, later) = (near(at.saturating_sub(1)), near(at));
            if earlier.abs() < later.abs() { earlier } else { later }
        })
        .collect()
}

#[test]
fn bursts_drift_and_loss_leave_counted_times_within_a_millisecond() {
    let stage = many();
    let spread = Bytes { count: 20, start_s: 4.0, end_s: 24.0 };
    let counted = ["chain", "imu-a", "star"];
    let devices = counted.map(|name| DeviceScenario {
        name: name.into(),
        rate_hz: 100.0,
        drift_ppm: 50.0,
        burst_ms: 16.0,
        faults: vec![Fault::LostBytes(spread)],
        ..DeviceScenario::default()
    });
    let mut rig = rig(&stage, devices.into(), 1.0);
    rig.run_until(24.0);
    for name in counted {
        let device = stage.devices.iter().position(|device| device.name == name).unwrap();
        let errors = time_errors(&rig, &stage, device, 13.0);
        let within = errors.iter().filter(|error| error.abs() <= 1e-3).count() as f64 / errors.len() as f64;
        let mean_ms = errors.iter().sum::<f64>() / errors.len() as f64 * 1e3;
        println!("{name}: {within:.3} of {} within 1 ms, mean {mean_ms:.3} ms", errors.len());
        assert!(errors.len() > 500 && within >= 0.95, "{name}: {within}");
    }
}

#[test]
fn orientations_follow_the_truth_and_replay_to_the_bit() {
    let stage = many();
    let mut rig = rig(&stage, Vec::new(), 3.0);
    rig.run_until(14.0);
    for at in sensors_of(&stage, "chain").chain(sensors_of(&stage, "imu-b")) {
        let cycles: Vec<_> =
            cycles(&rig, stage.devices.iter().position(|d| d.name == stage.sensors[at].device).unwrap());
        let (mut worst_deg, mut compared, mut frames) = (0.0f64, 0, 0);
        for estimate in rig.estimates().filter(|e| e.t_valid.as_secs_f64() > 10.0) {
            frames += 1;
            let Some(pose) = estimate.sensors[at].pose else { continue };
            assert!(pose.position_m.is_none() && pose.sigma_m.is_none());
            let t_s = estimate.t_valid.as_secs_f64();
            let cycle = nearest(&cycles, t_s);
            if (cycle.t.as_secs_f64() - t_s).abs() > 2e-3 {
                continue;
            }
            let Some(row) = cycle.sensors.iter().find(|row| row.sensor == at) else { continue };
            let reported = posed_geometry::orientation_from_wxyz(pose.orientation_wxyz).unwrap();
            worst_deg = worst_deg.max(reported.angle_to(&row.pose.rotation).to_degrees());
            compared += 1;
        }
        let name = &stage.sensors[at].name;
        println!("{name}: at most {worst_deg:.2} degrees off, {compared} of {frames} compared");
        assert!(worst_deg < 5.5, "{name}: {worst_deg}");
        // The frames are of all devices; a good part is near enough to a cycle of this one.
        assert!(compared >= 150, "{name}: {compared} of {frames} frames");
    }
    // A snapshot in the middle, put away and taken up again, changes nothing.
    let middle = rig.log.len() / 2;
    let mut pipeline = posed_pipeline::Pipeline::new(&stage).unwrap();
    let mut emitted = replay(&mut pipeline, &rig.log[..middle]);
    let mut restored =
        posed_pipeline::Pipeline::restore(&stage, pipeline.models(), &pipeline.snapshot()).unwrap();
    emitted.extend(replay(&mut restored, &rig.log[middle..]));
    assert!(emitted == rig.emitted, "a restored pipeline reports something else");
}
