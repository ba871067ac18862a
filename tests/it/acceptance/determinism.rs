//! The same entries give the same outputs: twice, from a snapshot taken anywhere, with models swapped in.

use posed_pipeline::Pipeline;
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::scenario::DeviceScenario;
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
    let mut rig = Rig::new(&stage, &scene(5, NOISY, &["s0-0", "s0-1", "s1-0"], flocks));
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
    assert_eq!(replay(&mut Pipeline::new(&stage).unwrap(), &rig.log), rig.emitted);
    for (models, snapshot, entries, emitted) in snapshots {
        let mut restored = Pipeline::restore(&stage, &models, &snapshot).unwrap();
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
