//! A stage in simulated time: virtual devices, the real pipeline, and nobody in between. For tests, benches and the swarm.
//!
//! In: a stage file and what is simulated on it. Out: what the pipeline said, the log that says it again, and the truth.

#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

pub mod counting;
mod host;
pub mod leg;
mod people;
mod rig;
mod said;
pub mod wand;

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use posed_field::{FieldMap, FieldNoise, Prepared, fit_known};
use posed_motion::fault_map::FaultMap;
use posed_recording::{Header, Machine, Replayable, Writer};
use posed_simulator::scenario::{Scenario, StageSpec};
use posed_simulator::stage::VirtualStage;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input, Model};
use serde::Deserialize;

pub use host::{Host, Sleepy};
pub use people::{Member, people, people_toml};
pub use rig::{Rig, replay};
pub use said::Said;

/// Copies the demo's stage file and what it names into a folder where a test may write.
pub fn copy_demo(folder: &Path) {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    for file in std::fs::read_dir(config).unwrap() {
        let path = file.unwrap().path();
        let name = path.file_name().unwrap();
        if name.to_str().is_some_and(|name| name.starts_with("demo")) {
            std::fs::copy(&path, folder.join(name)).unwrap();
        }
    }
}

/// A stage file with Flocks of so many birds each; one bird stands alone.
pub fn stage(birds: &[u16]) -> Stage {
    let mut text = String::from("name = \"test\"\n");
    for (device, &birds) in birds.iter().enumerate() {
        text += &format!("[[device]]\nname = \"d{device}\"\ndriver = \"flock-of-birds\"\nport = \"none\"\n");
        // Eight quaternions do not fit a cycle at 115200 baud, eight times three angles do.
        if birds > 6 {
            text += "format = \"position-angles\"\n";
        }
        for bird in 0..birds {
            let address = if birds == 1 { 0 } else { bird + 1 };
            text += &format!(
                "[[sensor]]\nname = \"s{device}-{bird}\"\ndevice = \"d{device}\"\naddress = {address}\n"
            );
        }
    }
    toml::from_str(&text).unwrap()
}

/// The stage of `posed demo`, as its file specifies it.
pub const DEMO: &str = include_str!("../../../config/demo.toml");

/// The stage of `posed demo`, and what happens on it.
pub fn demo_stage() -> (Stage, Scenario) {
    let stage = Stage::parse(DEMO).unwrap();
    let scenario = Scenario::deserialize(stage.simulation.clone().unwrap()).unwrap();
    (stage, scenario)
}

/// The stage of `posed demo`, and its rig, with the maps of its field and of its faults, as the program has them.
pub fn demo() -> (Stage, Rig) {
    let (stage, scenario) = demo_stage();
    let mut rig = Rig::new(&stage, &scenario);
    let fault_map: FaultMap = serde_json::from_str(include_str!("../../../config/demo-faults.json")).unwrap();
    rig.push(Input::Model(Model::Faults { fault_map: Box::new(fault_map) }));
    let map: FieldMap = serde_json::from_str(include_str!("../../../config/demo-field.json")).unwrap();
    rig.push(Input::Model(Model::Field { version: 1, map: Some(Prepared::new(map)) }));
    (stage, rig)
}

/// A map of a tracker that says everything three percent too long, for two metres around it.
pub fn field_map() -> FieldMap {
    let pairs: Vec<_> = (0..900)
        .map(|k| {
            let place = |n: usize| (k * n % 31) as f64 / 15.0 - 1.0;
            let p = Vector3::new(place(1), place(7), place(12)) * 2.0;
            (p * 1.03, p)
        })
        .filter(|(z, _)| z.norm() > 0.1)
        .collect();
    fit_known(&pairs, FieldNoise { sigma_signal: 1e-5, floor_m: 3e-4 }).unwrap()
}

/// A file of a real recording: `tests/recordings/README.md` states which there are, and whose.
pub fn recording(source: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings").join(source).join(name)
}

/// Virtual devices for a stage.
pub fn simulate(stage: &Stage, scenario: &Scenario) -> VirtualStage {
    let spec = StageSpec::of(stage).unwrap();
    VirtualStage::new(&spec, scenario, ".".as_ref()).unwrap()
}

/// The log of a session as a recording, and of the messages that follow from it those of one topic.
pub fn record(path: &Path, log: &[Entry], stage_toml: &str, topic_kept: &str) -> Vec<serde_json::Value> {
    let stage = Stage::parse(stage_toml).unwrap();
    let header = Header::new(&stage, stage_toml, 0);
    let (_, mut machine) = Machine::as_recorded(&header).unwrap();
    let mut writer = Writer::new(std::fs::File::create(path).unwrap(), header).unwrap();
    let mut kept = Vec::new();
    for entry in log {
        writer.entry(entry).unwrap();
        machine.push(entry, &mut |topic, _, json| {
            if topic == topic_kept {
                kept.push(serde_json::from_slice(json).unwrap());
            }
        });
    }
    writer.finish("the end").unwrap();
    kept
}
