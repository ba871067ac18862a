//! Which numbers of a stream an exercise looks at.
//!
//! What comes in: the names of a stream's columns and rows of values. What goes out: channels: columns as they are,
//! and for the four columns of an orientation (`qw,qx,qy,qz`, with a common prefix or without) the direction
//! of "up" relative to the sensor (`up_x, up_y, up_z`), which does not depend on where north is. What it never does:
//! let the heading in, or the sign of a quaternion.

use posed_state::Plain;

/// Channels of an exercise bound to the columns of a stream.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Binding {
    sources: Vec<Source>,
    values: Vec<f64>,
}

/// Where a channel's value comes from.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
enum Source {
    /// A column.
    Column(usize),
    /// A component of the vertical in sensor axes, from the columns of w, x, y, z.
    Up { columns: [usize; 4], axis: usize },
}

impl Binding {
    /// Finds `channels` among `columns`.
    ///
    /// # Errors
    /// The name of the first channel that is neither a column nor follows from an orientation.
    pub(super) fn new(channels: &[String], columns: &[String]) -> Result<Self, String> {
        let mut sources = Vec::with_capacity(channels.len());
        for channel in channels {
            sources.push(source(channel, columns).ok_or_else(|| channel.clone())?);
        }
        Ok(Self { values: vec![f64::NAN; sources.len()], sources })
    }

    /// Values of the channels in a row of the stream; NaN where there is none.
    pub(super) fn values(&mut self, row: &[Option<f64>]) -> &[f64] {
        let cell = |column: usize| row.get(column).copied().flatten().unwrap_or(f64::NAN);
        for (value, source) in self.values.iter_mut().zip(&self.sources) {
            *value = match source {
                Source::Column(column) => cell(*column),
                Source::Up { columns, axis } => up(columns.map(cell))[*axis],
            };
        }
        &self.values
    }

    /// Number of channels.
    pub(super) fn width(&self) -> usize {
        self.sources.len()
    }
}

/// All channels that the columns of a stream can give, in order: the four columns of an orientation (`..qw`, `..qx`,
/// `..qy`, `..qz`) become the three of the vertical in sensor axes (`..up_x`, `..up_y`, `..up_z`), which do not depend
/// on the heading.
pub fn all_channels(columns: &[String]) -> Vec<String> {
    let mut channels = Vec::new();
    for column in columns {
        match column.strip_suffix("qw").filter(|prefix| orientation(prefix, columns).is_some()) {
            Some(prefix) => channels.extend(["up_x", "up_y", "up_z"].map(|name| format!("{prefix}{name}"))),
            None if is_part(column, columns) => {}
            None => channels.push(column.clone()),
        }
    }
    channels
}

/// The columns among `columns` that `channels` come from, in the order of `columns`.
///
/// # Errors
/// The name of the first channel that is neither a column nor follows from an orientation.
pub fn columns_of(channels: &[String], columns: &[String]) -> Result<Vec<String>, String> {
    let mut used = vec![false; columns.len()];
    for channel in channels {
        match source(channel, columns).ok_or_else(|| channel.clone())? {
            Source::Column(column) => used[column] = true,
            Source::Up { columns, .. } => columns.iter().for_each(|column| used[*column] = true),
        }
    }
    Ok(columns.iter().zip(used).filter(|(_, used)| *used).map(|(column, _)| column.clone()).collect())
}

/// Whether a column is the x, y or z of an orientation.
fn is_part(column: &str, columns: &[String]) -> bool {
    ["qx", "qy", "qz"]
        .iter()
        .any(|part| column.strip_suffix(part).is_some_and(|prefix| orientation(prefix, columns).is_some()))
}

fn orientation(prefix: &str, columns: &[String]) -> Option<[usize; 4]> {
    let mut found = [0; 4];
    for (found, part) in found.iter_mut().zip(["qw", "qx", "qy", "qz"]) {
        *found = columns.iter().position(|column| column.strip_prefix(prefix) == Some(part))?;
    }
    Some(found)
}

fn source(channel: &str, columns: &[String]) -> Option<Source> {
    if let Some(column) = columns.iter().position(|column| column == channel) {
        return Some(Source::Column(column));
    }
    ["up_x", "up_y", "up_z"].iter().enumerate().find_map(|(axis, name)| {
        let columns = orientation(channel.strip_suffix(name)?, columns)?;
        Some(Source::Up { columns, axis })
    })
}

/// The room's vertical in sensor axes: the last row of the rotation matrix.
fn up([w, x, y, z]: [f64; 4]) -> [f64; 3] {
    let norm = w * w + x * x + y * y + z * z;
    if norm.is_nan() || norm <= 1e-6 {
        return [f64::NAN; 3];
    }
    [2.0 * (x * z - w * y) / norm, 2.0 * (y * z + w * x) / norm, (w * w - x * x - y * y + z * z) / norm]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn an_orientation_becomes_the_vertical_and_other_columns_stay() {
        let columns = names(&["gx", "wrist_qw", "wrist_qx", "wrist_qy", "wrist_qz", "qx"]);
        assert_eq!(all_channels(&columns), ["gx", "wrist_up_x", "wrist_up_y", "wrist_up_z", "qx"]);
    }

    #[test]
    fn the_vertical_does_not_change_with_heading_or_sign() {
        let columns = names(&["qw", "qx", "qy", "qz"]);
        let mut binding = Binding::new(&names(&["up_x", "up_y", "up_z"]), &columns).unwrap();
        // 90 degrees about x: the room's z is the sensor's y.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let turned = [half, half, 0.0, 0.0];
        // The same after 90 degrees about the room's z: (h,0,0,h) * (h,h,0,0).
        let headed = [0.5, 0.5, 0.5, 0.5];
        for q in [turned, headed, headed.map(|part: f64| -2.0 * part)] {
            let up = binding.values(&q.map(Some)).to_vec();
            for (value, expected) in up.iter().zip([0.0, 1.0, 0.0]) {
                assert!((value - expected).abs() < 1e-12, "{q:?}: {up:?}");
            }
        }
        assert!(binding.values(&[Some(1.0), None, Some(0.0), Some(0.0)])[2].is_nan());
    }

    #[test]
    fn a_channel_that_is_not_there_is_named() {
        assert_eq!(Binding::new(&names(&["elbow"]), &names(&["knee"])), Err("elbow".to_owned()));
    }
}
