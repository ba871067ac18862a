//! Which channels measure the same kind of quantity.
//!
//! What comes in: names of channels. What goes out: for each the number of its kind. Channels of one kind share a
//! unit, so their sizes can be compared: a joint that turns by five degrees says little beside one that turns by a
//! hundred, and what a misplaced sensor mixes into it is as large. What it never does: look at values.

/// Number of each channel's kind, in the order of their first appearance.
pub(super) fn kinds(channels: &[String]) -> Vec<usize> {
    let mut names: Vec<&str> = Vec::new();
    channels
        .iter()
        .map(|channel| {
            let name = kind(channel);
            names.iter().position(|known| *known == name).unwrap_or_else(|| {
                names.push(name);
                names.len() - 1
            })
        })
        .collect()
}

/// Ends of names that are units.
const UNITS: [&str; 3] = ["_deg", "_rad", "_m"];
/// Ends of names of orientations and of vectors in sensor axes, whose units are known.
const SENSORS: [&str; 4] = ["q", "g", "a", "m"];

/// Whether the name of a column states what it measures: it ends in a unit (`_deg`, `_rad`, `_m`), or is a part of an orientation or an
/// axis of a sensor (`qw`, `gx`, `wrist_ay`).
pub fn has_unit(column: &str) -> bool {
    let last = column.rsplit('_').next().unwrap_or(column);
    let axis = last.strip_suffix(['w', 'x', 'y', 'z']).unwrap_or("");
    UNITS.iter().any(|unit| column.ends_with(unit)) || SENSORS.contains(&axis)
}

/// The unit at the end of a name; else what is left of it without its axis.
fn kind(channel: &str) -> &str {
    if let Some(unit) = UNITS.into_iter().find(|unit| channel.ends_with(unit)) {
        return unit;
    }
    // The vertical of any sensor is a vertical.
    if ["up_x", "up_y", "up_z"].iter().any(|up| channel.ends_with(up)) {
        return "up_";
    }
    channel.strip_suffix(['x', 'y', 'z']).filter(|rest| !rest.is_empty()).unwrap_or(channel)
}

/// For each channel the other channels that are axes of the same vector in sensor axes (angular velocities, accelerations, the
/// vertical): a sensor that sits turned mixes them.
pub(super) fn siblings(channels: &[String]) -> Vec<Vec<usize>> {
    let vector = |channel: &str| -> Option<String> {
        let rest = channel.strip_suffix(['x', 'y', 'z'])?;
        (rest.ends_with("up_") || rest.ends_with(['g', 'a', 'm'])).then(|| rest.to_owned())
    };
    let vectors: Vec<Option<String>> = channels.iter().map(|channel| vector(channel)).collect();
    let same = |a: usize, b: usize| a != b && vectors[a].is_some() && vectors[a] == vectors[b];
    (0..channels.len()).map(|a| (0..channels.len()).filter(|b| same(a, *b)).collect()).collect()
}

/// Whether a channel is a joint's angle that shows a posture whoever wears the sensors wherever. What turns about a limb's own axis
/// or the vertical does not: it is lost where an arm hangs, and drifts without a field.
pub(super) fn is_posture(channel: &str) -> bool {
    let lost = ["plane", "rotation", "azimuth", "heading", "yaw"];
    channel.ends_with("_deg") && !lost.iter().any(|word| channel.contains(word))
}

/// For each value the largest one of its kind.
pub(super) fn largest(kinds: &[usize], values: &[f64]) -> Vec<f64> {
    let of = |kind: usize| {
        let same = kinds.iter().zip(values).filter(|(other, _)| **other == kind);
        same.map(|(_, value)| *value).fold(0.0, f64::max)
    };
    kinds.iter().map(|kind| of(*kind)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_and_joints_are_of_one_kind_and_units_are_kept_apart() {
        let names =
            ["elbow_flexion_deg", "gx", "gz", "knee_deg", "ax", "left_up_x", "right_up_z", "left_x_m", "x"];
        let kinds = kinds(&names.map(str::to_owned));
        assert_eq!(kinds, [0, 1, 1, 0, 2, 3, 3, 4, 5]);
        assert_eq!(largest(&[0, 1, 0], &[2.0, 5.0, 3.0]), [3.0, 5.0, 3.0]);
    }

    #[test]
    fn postures_are_joint_angles_that_are_always_defined() {
        for channel in ["elbow_flexion_deg", "hip_r_adduction_deg", "knee_deg"] {
            assert!(is_posture(channel), "{channel}");
        }
        for channel in ["shoulder_r_plane_deg", "spine_rotation_deg", "wrist_up_z", "wrist_x_m", "gx"] {
            assert!(!is_posture(channel), "{channel}");
        }
    }

    #[test]
    fn axes_of_one_sensor_are_siblings_and_places_in_the_room_are_not() {
        let names = ["gx", "gy", "ax", "wrist_gx", "wrist_up_z", "wrist_up_x", "x_m", "knee_deg", "gz"];
        let siblings = siblings(&names.map(str::to_owned));
        assert_eq!(siblings[0], [1, 8]);
        assert_eq!(siblings[4], [5]);
        assert!([2, 3, 6, 7].iter().all(|channel| siblings[*channel].is_empty()), "{siblings:?}");
    }
}
