//! The same entries give the same outputs: twice, from a snapshot taken anywhere, with models swapped in.

use posed_pipeline::Pipeline;
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::scenario::DeviceScenario;
use posed_stage::Stage;
use posed_stage::input::{Input, Model};

use super::{NOISY, device, scene};
use posed_rig::{Rig, replay, stage};

fn bytes() -> Bytes {
    Bytes { count: 60, start_s: 2.0, end_s: 9.0 }
}

#[test]
fn outputs_repeat_from_every_snapshot() {
    let stage = stage(&[2, 1]);
    let faults = vec![
        Fault::LostBytes(bytes()),
        Fault::InsertedBytes(bytes()),
        Fault::Unplug { at_s: 5.0, duration_s: Some(1.0), power: false },
        Fault::HemisphereFlip { address: 2, at_s: 8.0, duration_s: 0.7 },
    ];
    let flocks = vec![
        DeviceScenario { burst_ms: 16.0, ..device(0, faults) },
        DeviceScenario { rate_hz: 103.3, ..device(1, vec![Fault::DataBitFlips(bytes())]) },
    ];
    let rig = Rig::new(&stage, &scene(5, NOISY, &["s0-0", "s0-1", "s1-0"], flocks));
    repeats(&stage, rig);
}

/// Boards, phones, trackers of a receiver and a Liberty: what comes in envelopes, as text, and with clocks behind radios.
#[test]
fn outputs_of_radios_repeat_from_every_snapshot() {
    let mut text = String::from("name = \"radios\"\n");
    let devices = [
        ("d0", "polhemus", "/dev/none", "baud = 921600"),
        ("boards", "open-imu", "udp://0.0.0.0:9301", "devices = [\"b-1\", \"b-2\"]"),
        ("phones", "open-imu", "websocket", "devices = [\"p-1\", \"p-2\"]"),
        ("trackers", "slimevr", "/dev/hidraw0", ""),
    ];
    for (name, driver, port, settings) in devices {
        text +=
            &format!("[[device]]\nname = \"{name}\"\ndriver = \"{driver}\"\nport = \"{port}\"\n{settings}\n");
        for address in 1..=2 {
            text += &format!(
                "[[sensor]]\nname = \"{name}-{address}\"\ndevice = \"{name}\"\naddress = {address}\n"
            );
        }
    }
    let stage: Stage = toml::from_str(&text).unwrap();
    let radio = |(name, ..): (&str, &str, &str, &str)| DeviceScenario {
        name: name.into(),
        radio_jitter_ms: if name == "d0" { 0.0 } else { 40.0 },
        faults: vec![
            Fault::LostDatagrams(bytes()),
            Fault::DuplicatedDatagrams(bytes()),
            Fault::BirdDies { address: 2, at_s: 4.0, duration_s: Some(3.0) },
            Fault::Unplug { at_s: 5.0, duration_s: Some(1.0), power: false },
        ],
        ..DeviceScenario::default()
    };
    let names: Vec<&str> = stage.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let rig = Rig::new(&stage, &scene(5, NOISY, &names, devices.map(radio).to_vec()));
    repeats(&stage, rig);
}

/// A replay of its log says what it said, from the beginning and from every snapshot on.
fn repeats(stage: &Stage, mut rig: Rig) {
    let mut snapshots = Vec::new();
    // In set-up, between two records, inside a burst, while the port is away, while it is set up again.
    for until_s in [0.0, 0.15, 0.9, 1.7, 3.3333, 4.4444, 5.5, 6.1, 6.7, 8.3, 10.0] {
        rig.run_until(until_s);
        snapshots.push((
            rig.pipeline.models().clone(),
            rig.pipeline.snapshot(),
            rig.log.len(),
            rig.emitted.len(),
        ));
        if until_s == 4.4444 {
            rig.push(Input::Model(Model::Transmitter {
                position_m: [0.1, 0.2, 1.0],
                orientation_wxyz: [0.0, 1.0, 0.0, 0.0],
            }));
            rig.push(Input::Model(Model::TrackerNoise {
                device: "d0".into(),
                r0_m: 1.0,
                sigma_radial_m: 2e-4,
                sigma_rotation_rad: 2e-3,
            }));
        }
    }
    rig.run_until(11.0);
    assert!(rig.estimates().count() > 700);
    assert_eq!(replay(&mut Pipeline::new(stage).unwrap(), &rig.log), rig.emitted);
    for (models, snapshot, entries, emitted) in snapshots {
        let mut restored = Pipeline::restore(stage, &models, &snapshot).unwrap();
        assert_eq!(restored.snapshot(), snapshot, "at entry {entries}");
        assert_eq!(
            replay(&mut restored, &rig.log[entries..]),
            rig.emitted[emitted..],
            "from entry {entries}"
        );
        assert_eq!(restored.status(), rig.pipeline.status(), "from entry {entries}");
        assert_eq!(restored.snapshot(), rig.pipeline.snapshot(), "from entry {entries}");
    }
}
