//! Stage files.

use serde::Deserialize;

use posed_pipeline::Pipeline;
use posed_simulator::scenario::{Scenario, StageSpec};
use posed_simulator::stage::VirtualStage;
use posed_stage::Stage;

/// A text is right exactly if it parses, and every problem has a line. One that is right makes a pipeline, and devices for it,
/// or is refused with a sentence.
///
/// # Panics
/// That does not hold.
pub(crate) fn stage_file(data: &[u8]) {
    posed_stage::fuzz(data);
    let Some(stage) = std::str::from_utf8(data).ok().and_then(|text| Stage::parse(text).ok()) else { return };
    if let Err(error) = Pipeline::new(&stage) {
        // The one thing that a stage may lack until somebody wears it.
        assert!(error.to_string().contains("height_m"), "{error}");
    }
    let scenario = stage.simulation.clone().map_or(Ok(Scenario::default()), Scenario::deserialize);
    if let (Ok(spec), Ok(scenario)) = (StageSpec::of(&stage), scenario) {
        let _ = VirtualStage::new(&spec, &scenario, "/nowhere".as_ref());
    }
}
