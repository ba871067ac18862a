//! The files of models that a stage loads at its start.

use std::fs;
use std::path::Path;

use super::super::problem::Notes;
use super::Item;

/// Looks at every file that `[models]` names.
pub(super) fn check(models: &Item<'_, '_>, folder: &Path, notes: &mut Notes<'_>) {
    let exercises = models.get("exercises").and_then(|list| list.get_ref().as_array());
    for path in exercises.into_iter().flatten() {
        let Some(text) = path.get_ref().as_str() else { continue };
        let full = folder.join(text);
        let mend = "name a file that `posed exercise teach` or `exercise.teach` wrote; relative paths begin at the \
                    stage file";
        match fs::read_to_string(&full) {
            Err(error) => {
                let message = format!("cannot read {}: {error}", full.display());
                notes.problem(&path.span(), "exercises", message, mend);
            }
            Ok(json) if format_of(&json).as_deref() != Some("posed-exercise") => {
                let message = format!("{} holds no exercise", full.display());
                notes.problem(&path.span(), "exercises", message, mend);
            }
            Ok(_) => {}
        }
    }
    super::folder_key(models, "exercise_folder", folder, notes);
    if let Some(map) = models.text("field")
        && let Err(reason) = crate::field::FieldMap::read(&folder.join(map.value))
    {
        notes.problem(&map.at, "field", reason, "name a map that `posed field solve` wrote");
    }
}

/// The `format` that a JSON file says it has.
fn format_of(json: &str) -> Option<String> {
    #[derive(serde::Deserialize)]
    struct Head {
        format: String,
    }
    serde_json::from_str::<Head>(json).ok().map(|head| head.format)
}
