//! Model files by their paths: the estimators read text, not files.
//!
//! What comes in: a path. What goes out: a checked model, or one sentence that names the file. What it never does: take a
//! model that its own checks refuse.

use std::path::Path;

use posed_field::FieldMap;
use posed_fusion::intrinsics::Intrinsics;

/// Reads a map of the magnetic field (JSON of `posed field solve`). A map that was not accepted is read as well.
///
/// # Errors
/// One sentence with the path: it cannot be read, or [`FieldMap::from_json`] refuses it.
pub fn read_field_map(path: &Path) -> Result<FieldMap, String> {
    FieldMap::from_json(&contents(path)?).map_err(|reason| format!("{} {reason}", path.display()))
}

/// Reads the intrinsics of an IMU (JSON of `posed imu calibrate` or `imu.calibrate`). A file that does not name its unit is
/// that of its own name without the ending.
///
/// # Errors
/// One sentence with the path: it cannot be read, or [`Intrinsics::from_json`] refuses it.
pub fn read_intrinsics(path: &Path) -> Result<Intrinsics, String> {
    let mut found =
        Intrinsics::from_json(&contents(path)?).map_err(|reason| format!("{}: {reason}", path.display()))?;
    if found.unit.is_none() {
        found.unit = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    }
    Ok(found)
}

fn contents(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("cannot read {}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intrinsics_are_of_the_unit_that_the_file_or_its_name_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("0123ABCD.json");
        let written = |text: serde_json::Value| {
            std::fs::write(&path, text.to_string()).unwrap();
            read_intrinsics(&path)
        };
        let mut text = serde_json::json!({
            "gyro_bias_rad_s": [0, 0, 0], "gyro_bias_sigma_rad_s": 0.001, "accel_bias_m_s2": [0, 0, 0],
            "accel_scale": [1, 1, 1], "accel_residual_m_s2": 0.01, "directions": 12, "mag": null,
        });
        assert_eq!(written(text.clone()).unwrap().unit.as_deref(), Some("0123ABCD"));
        text["unit"] = "98:76".into();
        assert_eq!(written(text).unwrap().unit.as_deref(), Some("98:76"));
        written(serde_json::json!({})).unwrap_err();
        let refusal = read_intrinsics(&path).unwrap_err();
        assert!(refusal.contains("0123ABCD.json: missing field"), "{refusal}");
        let absent = read_field_map(&folder.path().join("map.json")).unwrap_err();
        assert!(absent.starts_with("cannot read "), "{absent}");
    }
}
