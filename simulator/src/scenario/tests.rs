//! Scenarios as they are written, and what is refused.

use std::path::Path;

use nalgebra::Vector3;

use super::build::transmitter_in_room;
use super::*;

fn stage() -> StageSpec {
    let sensor = |name: &str, address| SensorSpec { name: name.into(), device: "flock".into(), address };
    StageSpec {
        transmitter_in_room: Some(([0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0])),
        devices: vec![DeviceSpec {
            name: "flock".into(),
            driver: "flock-of-birds".into(),
            baud: 115_200,
            measurement_delay_ms: 0.0,
            ..DeviceSpec::default()
        }],
        sensors: vec![sensor("upper_arm_r", 1), sensor("forearm_r", 2), sensor("wand", 3)],
    }
}

/// The demo's scenario without its chain of inertial sensors.
fn demo() -> Scenario {
    let mut scenario: Scenario =
        toml::from_str(include_str!("../../resources/demo-simulation.toml")).unwrap();
    scenario.sensors.retain(|sensor| !sensor.name.starts_with("imu_"));
    scenario.devices.retain(|device| device.name == "flock");
    scenario
}

#[test]
fn the_demo_is_understood() {
    let scenario = demo();
    scenario.check(&stage()).unwrap();
    let riders = scenario.riders(&stage(), Path::new(".")).unwrap();
    let (flock, _) = scenario.flock(&stage(), 0, &riders).unwrap();
    assert_eq!(flock.units.len(), 3);
    assert!(!flock.extended_range && !flock.stand_alone);
}

#[test]
fn nothing_in_the_demo_leaves_the_good_part_of_the_field() {
    let scenario = demo();
    let mut host = crate::testing::Host::with(&stage(), &scenario);
    host.stream_group(3, b']');
    host.wait_ms(600.0);
    host.truth.clear();
    host.wait_ms(30_000.0);
    assert!(host.truth.len() > 3000);
    for cycle in &host.truth {
        for row in &cycle.sensors {
            assert_eq!(row.class, crate::truth::Class::Clean, "{row:?}");
            let from_transmitter = row.pose.translation.vector - Vector3::new(0.0, 0.0, 1.0);
            assert!(from_transmitter.amax() < 0.9, "outside the words of 36 inches: {row:?}");
            assert!(from_transmitter.x > 0.2, "too near to the plane of the hemisphere: {row:?}");
        }
    }
    let moved = |sensor: usize| {
        let x = host.truth.iter().map(|cycle| cycle.sensors[sensor].pose.translation.vector);
        x.clone().fold(Vector3::repeat(f64::NEG_INFINITY), |a, b| a.sup(&b))
            - x.fold(Vector3::repeat(f64::INFINITY), |a, b| a.inf(&b))
    };
    assert!(moved(1).norm() > 0.2 && moved(2).norm() > 0.2, "two or more of them move");
}

#[test]
fn an_empty_table_is_a_quiet_stage() {
    let scenario: Scenario = toml::from_str("").unwrap();
    assert_eq!(scenario, Scenario::default());
    assert!(scenario.riders(&stage(), Path::new(".")).unwrap().len() == 3);
}

#[test]
fn every_fault_can_be_written() {
    let text = "[[device]]\nname = 'flock'\nfault = [\
        { kind = 'lost-bytes', count = 50, start_s = 5, end_s = 15 },\
        { kind = 'inserted-bytes', count = 50, start_s = 5, end_s = 15 },\
        { kind = 'bit7-flips', count = 50, start_s = 5, end_s = 15 },\
        { kind = 'data-bit-flips', count = 50, start_s = 5, end_s = 15 },\
        { kind = 'bursts', start_s = 5, end_s = 15, burst_ms = 16 },\
        { kind = 'unplug', at_s = 5, duration_s = 2 },\
        { kind = 'phase-cut', at_s = 5 },\
        { kind = 'stall', at_s = 5 },\
        { kind = 'power-cycle', at_s = 5 },\
        { kind = 'bird-dies', address = 2, at_s = 5 },\
        { kind = 'hemisphere-flip', address = 2, at_s = 5, duration_s = 0.5 },\
        { kind = 'out-of-range', address = 2, at_s = 5, duration_s = 0.5 },\
        { kind = 'bad-matrix', address = 2, at_s = 5, duration_s = 0.5 },\
        { kind = 'error', address = 1, at_s = 5, code = 13, detail = 2 } ]\n";
    let scenario: Scenario = toml::from_str(text).unwrap();
    assert_eq!(scenario.devices[0].faults.len(), 14);
    scenario.check(&stage()).unwrap();
    let again: Scenario = toml::from_str(&toml::to_string(&scenario).unwrap()).unwrap();
    assert_eq!(again, scenario);
}

#[test]
fn what_is_wrong_is_named() {
    let problem = |text: &str| match toml::from_str::<Scenario>(text) {
        Err(error) => error.message().to_owned(),
        Ok(scenario) => match scenario.check(&stage()) {
            Err(error) => error.to_string(),
            Ok(()) => scenario.riders(&stage(), Path::new("/none")).unwrap_err().to_string(),
        },
    };
    let body = "[[body]]\nname = 'arm'\nmotion.kind = 'curl'\n";
    assert!(problem("sede = 3").contains("unknown field `sede`"));
    assert!(problem("min_range_m = 0").contains("min_range_m: 0 should be above 0"));
    assert!(problem("[[device]]\nname = 'flok'").contains("no device `flok`"));
    assert!(problem("[[device]]\nname = 'flock'\nrate_hz = 500").contains("14 to 144 Hz"));
    assert!(problem("[[sensor]]\nname = 'wand'\nbody = 'x'").contains("no [[simulation.body]]"));
    assert!(problem(&format!("{body}motion.period_s = 0\n")).contains("period_s"));
    assert!(problem(&format!("{body}motion.perod_s = 1\n")).contains("perod_s"));
    assert!(
        problem(&format!("{body}[[sensor]]\nname = 'wand'\nbody = 'arm'\nsegment = 'hand'\n"))
            .contains("has the segments upper_arm, forearm")
    );
    assert!(
        problem("[[body]]\nname = 'a'\nmotion = { kind = 'file', path = 'a.bvh' }\n").contains("/none/a.bvh")
    );
    let fault = "[[device]]\nname = 'flock'\nfault = [{ kind = 'stall', at_s = -1 }]\n";
    assert!(problem(fault).contains("should begin at 0 s or later"), "{}", problem(fault));
    for fault in [
        "kind = 'stall', at_s = inf",
        "kind = 'stall', at_s = 1, duration_s = inf",
        "kind = 'stall', at_s = 1, duration_s = 1e300",
        "kind = 'stall', at_s = 1, duration_s = nan",
        "kind = 'unplug', at_s = 1, duration_s = inf",
        "kind = 'bursts', start_s = 1, end_s = inf, burst_ms = 16",
        "kind = 'bursts', start_s = 1, end_s = 2, burst_ms = inf",
        "kind = 'bursts', start_s = 1, end_s = 2, burst_ms = -1",
    ] {
        let scenario =
            toml::from_str::<Scenario>(&format!("[[device]]\nname = 'flock'\nfault = [{{ {fault} }}]\n"))
                .unwrap();
        assert!(scenario.check(&stage()).is_err(), "{fault}");
    }
    for key in ["burst_ms", "boot_ms"] {
        let endless = problem(&format!("[[device]]\nname = 'flock'\n{key} = inf\n"));
        assert!(endless.contains(key), "{endless}");
    }
}

#[test]
fn without_a_bird_at_address_1_an_extended_range_controller_is_there() {
    let mut stage = stage();
    for sensor in &mut stage.sensors {
        sensor.address += 1;
    }
    let scenario = Scenario::default();
    let riders = scenario.riders(&stage, Path::new(".")).unwrap();
    let (flock, _) = scenario.flock(&stage, 0, &riders).unwrap();
    assert!(flock.extended_range && flock.units[0].extended_controller);
    assert_eq!(flock.units.len(), 4);
    assert!(flock.units[0].sensor.is_none());
}

#[test]
fn the_floor_lies_below_the_transmitter_whatever_its_axes() {
    let scenario = Scenario {
        floor: Some(FloorSpec { z_m: 0.0, strength: 0.1, material: Material::Iron }),
        ..Scenario::default()
    };
    let tracker = scenario.tracker(&transmitter_in_room(&stage()), false);
    let floor = tracker.environment.floor.unwrap();
    assert_eq!(floor.distance_m, 1.0);
    assert!((floor.normal.into_inner() - Vector3::new(0.0, 0.0, -1.0)).norm() < 1e-12, "z is down");
}

#[test]
fn a_stage_file_gives_what_the_simulator_needs() {
    let text = r#"
        name = "any"
        [transmitter]
        pose_in_room = { position_m = [0, 0, 1], orientation_wxyz = [0, 1, 0, 0] }
        [[device]]
        name = "trackers"
        driver = "slimevr"
        port = "udp://0.0.0.0:6969"
        trackers = ["A4:CF:12:D4:E5:F6"]
        [[sensor]]
        name = "wand"
        device = "trackers"
        address = 1
        segment = "pelvis"
    "#;
    let spec = StageSpec::of(&toml::from_str::<toml::Table>(text).unwrap()).unwrap();
    assert_eq!(spec.transmitter_in_room, Some(([0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0])));
    assert_eq!(spec.devices[0].serials, ["A4:CF:12:D4:E5:F6"]);
    assert_eq!((spec.devices[0].baud, spec.devices[0].measurement_delay_ms), (115_200, 0.0));
    assert_eq!(spec.sensors, [SensorSpec { name: "wand".into(), device: "trackers".into(), address: 1 }]);
    assert!(StageSpec::of(&"text").is_err());
}

#[test]
fn every_driver_can_be_simulated_and_wrong_addresses_are_named() {
    let of = |driver: &str, port: &str, addresses: &[u16]| {
        let spec = crate::testing::stage_of(driver, port, 115_200, addresses);
        let built = crate::stage::VirtualStage::new(&spec, &Scenario::default(), ".".as_ref());
        built.map(drop).map_err(|error| error.to_string())
    };
    for (driver, port, good, bad) in [
        ("flock-of-birds", "a", &[1, 2][..], &[0, 1][..]),
        ("xbus", "a", &[1, 2, 3], &[1, 21]),
        ("x-imu3", "a", &[1, 300], &[0, 1]),
        ("slimevr", "udp://x:6969", &[1, 0x102], &[0x100]),
        ("motionstar", "tcp://x:6000", &[2, 3], &[0]),
        ("fastrak", "a", &[1, 4], &[5]),
        ("polhemus", "a", &[1, 16], &[17]),
        ("witmotion", "a", &[0], &[1]),
    ] {
        assert_eq!(of(driver, port, good), Ok(()), "{driver}");
        let error = of(driver, port, bad).unwrap_err();
        assert!(error.starts_with("simulation.device.device: "), "{driver} {error}");
        let twice = of(driver, port, &[good[0], good[0]]).unwrap_err();
        assert!(twice.contains("taken twice"), "{twice}");
    }
    assert!(of("vrpn", "tcp://x:3883", &[1]).unwrap_err().contains("256 * sensor + tracker"));
    assert!(of("vicon", "a", &[1]).unwrap_err().contains("cannot be simulated"));
    assert!(of("slimevr", "/dev/ttyUSB0", &[1]).unwrap_err().contains("udp://"));
}

#[test]
fn sensors_that_no_scenario_moves_move_where_their_host_looks_for_them() {
    let half_spaces = [
        ("fastrak", serde_json::json!([0.0, 0.0, -2.0]), [0.0, 0.0, -1.0]),
        ("flock-of-birds", serde_json::json!("left"), [0.0, -1.0, 0.0]),
        ("flock-of-birds", serde_json::json!(null), [1.0, 0.0, 0.0]),
        // No half-space at all.
        ("fastrak", serde_json::json!([0.0, 0.0, 0.0]), [1.0, 0.0, 0.0]),
    ];
    for (driver, hemisphere, direction) in half_spaces {
        let mut device = serde_json::json!({ "name": "tracker", "driver": driver });
        if !hemisphere.is_null() {
            device["hemisphere"] = hemisphere;
        }
        let sensors = [1, 2].map(|address| serde_json::json!({ "name": format!("s{address}"), "device": "tracker", "address": address }));
        let stage = StageSpec::of(&serde_json::json!({ "device": [device], "sensor": sensors })).unwrap();
        for rider in Scenario::default().riders(&stage, Path::new(".")).unwrap() {
            let along =
                |t_s: f64| rider.pose_in_room_s(t_s).translation.vector.dot(&Vector3::from(direction));
            assert!((0..600).all(|tick| along(0.05 * f64::from(tick)) > 0.3), "{driver} {direction:?}");
        }
    }
}
