//! Whether a model knows what is in a file of sequences.

use posed_motion::segments::Model;
use posed_recording::table::Sequences;

use super::super::{Error, notify};

/// Refuses a file that lacks most of the model's joints or is in another unit; tells of joints that are missing.
pub(super) fn fits(name: &str, file: &Sequences, model: &Model) -> Result<(), Error> {
    let preparation = &model.card.preparation;
    let joints = file.joints.iter().map(String::as_str);
    model.columns(joints).map_err(|what| Error::Failed(format!("{name}: {what}")))?;
    let missing: Vec<&str> =
        preparation.joints.iter().filter(|joint| !file.joints.contains(joint)).map(String::as_str).collect();
    if !missing.is_empty() {
        notify(&format!("{name}: goes without {}, which the model knows", missing.join(", ")));
    }
    let columns: Vec<usize> =
        (0..file.joints.len()).filter(|index| preparation.joints.contains(&file.joints[*index])).collect();
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for frame in 0..file.frames.len() {
        let positions = file.positions_m(frame);
        let known: Vec<[f64; 3]> = columns.iter().filter_map(|column| positions[*column]).collect();
        let mean: [f64; 3] = std::array::from_fn(|axis| {
            known.iter().map(|p| p[axis]).sum::<f64>() / known.len().max(1) as f64
        });
        sum += known.iter().map(|p| (0..3).map(|i| (p[i] - mean[i]).powi(2)).sum::<f64>()).sum::<f64>();
        count += known.len() as f64;
    }
    let size_m = (sum / count.max(1.0)).sqrt();
    let ratio = size_m / preparation.size_m;
    if count > 0.0 && !(0.2..5.0).contains(&ratio) {
        return Err(Error::Failed(format!(
            "{name}: joints lie {size_m:.3} m from their centre, where the model knows {:.3} m; is `--unit` right?",
            preparation.size_m
        )));
    }
    Ok(())
}
