//! The files of models that a stage loads at its start.

use std::fs;
use std::path::Path;

use super::super::Stage;
use super::super::problem::Notes;
use super::Item;
use posed_motion::fault_map::FaultMap;

/// Looks at every file that `[models]` names.
pub(super) fn check(models: &Item<'_, '_>, folder: &Path, notes: &mut Notes<'_>) {
    let exercises = models.get("exercises").and_then(|list| list.get_ref().as_array());
    for path in exercises.into_iter().flatten() {
        let Some(text) = path.get_ref().as_str() else { continue };
        let full = folder.join(text);
        let fix = "name a file that `posed exercise teach` or `exercise.teach` wrote; relative paths begin at the \
                    stage file";
        match fs::read_to_string(&full) {
            Err(error) => {
                let message = format!("cannot read {}: {error}", full.display());
                notes.problem(&path.span(), "exercises", message, fix);
            }
            Ok(json) if format_of(&json).as_deref() != Some("posed-exercise") => {
                let message = format!("{} holds no exercise", full.display());
                notes.problem(&path.span(), "exercises", message, fix);
            }
            Ok(_) => {}
        }
    }
    super::folder_key(models, "exercise_folder", folder, notes);
    super::folder_key(models, "faults_folder", folder, notes);
    super::folder_key(models, "imu_folder", folder, notes);
    super::folder_key(models, "segments_folder", folder, notes);
    if let Some(map) = models.text("field")
        && let Err(reason) = crate::read_field_map(&folder.join(map.value))
    {
        notes.problem(&map.at, "field", reason, "name a map that `posed field solve` wrote");
    }
}

/// Looks at the fault map, which has to be of the stage's magnetic sensors.
pub(super) fn check_faults(models: &Item<'_, '_>, folder: &Path, stage: &Stage, notes: &mut Notes<'_>) {
    let Some(path) = models.text("faults") else { return };
    let full = folder.join(path.value);
    if let Err(message) = read_faults(&full, stage) {
        let fix = "name a file that `posed faults train` or `faults.train` wrote for these sensors";
        notes.problem(&path.at, "faults", message, fix);
    }
}

/// Reads a fault map for a stage.
///
/// # Errors
/// One sentence: it cannot be read, is none, or knows other sensors than the stage's magnetic ones.
pub(crate) fn read_faults(path: &Path, stage: &Stage) -> Result<FaultMap, String> {
    let text = fs::read(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    let fault_map: FaultMap =
        serde_json::from_slice(&text).map_err(|error| format!("{}: {error}", path.display()))?;
    let fits = fault_map.check_sensors(&stage.magnetic_sensors());
    fits.map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(fault_map)
}

/// The `format` that a JSON file says it has.
fn format_of(json: &str) -> Option<String> {
    #[derive(serde::Deserialize)]
    struct Head {
        format: String,
    }
    serde_json::from_str::<Head>(json).ok().map(|head| head.format)
}
