//! Whether who was moving now rests.
//!
//! What comes in: a stream of what somebody's sensors said. What goes out: whether its newest second and a half is rest after
//! movement. What it never does: ask for stillness in numbers of its own; who breathes, sways and wears noisy sensors
//! rests too, if that is little beside the movement before.
//!
//! The variances of all sensors are added up in their unit, so that a sensor that did not take part, and has nothing but noise
//! to show, does not weigh as much as the arm that did. Angles of a body are looked at only where nothing else is there:
//! they follow from its sensors, and some mean nothing at rest, as the direction into which a hanging arm is raised.

use super::material::Stream;

/// So long, s.
const REST_S: f64 = 1.5;
/// Share of the movement's variance that may go on.
const MOST: f64 = 0.02;

/// What a sensor reports: how the columns end, and the variance, over all sensors, that is no exercise yet.
struct Kind {
    ends: &'static [&'static str],
    least: f64,
}

/// Components of a unit quaternion; half an angle of two degrees.
const ROTATION: Kind = Kind { ends: &["qw", "qx", "qy", "qz"], least: 3e-4 };
/// Rotations; positions (a centimetre); specific forces and angular velocities of single inertial sensors.
const KINDS: [Kind; 4] = [
    ROTATION,
    Kind { ends: &["x_m", "y_m", "z_m"], least: 1e-4 },
    Kind { ends: &["ax", "ay", "az"], least: 0.1 },
    Kind { ends: &["gx", "gy", "gz"], least: 0.02 },
];
/// Angles (two degrees), or whatever else there is.
const OTHER: Kind = Kind { ends: &[""], least: 4.0 };

/// Whether the newest second and a half of a stream is rest, and there was movement before it: a demonstration has
/// ended.
///
/// False for a stream that is shorter, empty or was at rest all along. It looks at orientations, positions (`x_m`, ..),
/// specific forces and angular velocities by the ends of their names, and without any of these at all columns.
pub fn rests(stream: &Stream<'_>) -> bool {
    let Some(last) = stream.t_s.last() else { return false };
    let rest = stream.t_s.partition_point(|t_s| *t_s < last - REST_S);
    if rest == 0 {
        return false;
    }
    let is_one = |kind: &&Kind| stream.columns.iter().any(|column| column.ends_with(kind.ends[0]));
    let mut kinds: Vec<&Kind> = KINDS.iter().filter(is_one).collect();
    if kinds.is_empty() {
        kinds.push(&OTHER);
    }
    let (mut moved, mut goes_on) = (0.0, 0.0);
    for kind in kinds {
        let (mut all, mut newest) = (0.0, 0.0);
        for columns in columns_of(kind, stream.columns) {
            all += variance(stream, &columns, 0);
            newest += variance(stream, &columns, rest);
        }
        // What hardly moved hardly counts.
        moved += all / (all + kind.least);
        goes_on += newest / (all + kind.least);
    }
    moved > 0.5 && goes_on < MOST * moved
}

/// The columns of a kind, sensor by sensor.
fn columns_of(kind: &Kind, columns: &[String]) -> Vec<Vec<usize>> {
    let of = |prefix: &str| -> Option<Vec<usize>> {
        let place = |end: &&str| {
            columns.iter().position(|column| column.strip_suffix(*end).is_some_and(|rest| rest == prefix))
        };
        kind.ends.iter().map(place).collect()
    };
    columns.iter().filter_map(|column| of(column.strip_suffix(kind.ends[0])?)).collect()
}

/// Variance of a vector from a row on; of a quaternion without regard to its sign, which is one's to choose.
fn variance(stream: &Stream<'_>, columns: &[usize], from: usize) -> f64 {
    let (mut n, mut sum, mut square) = (0.0, [0.0; 4], 0.0);
    let mut before = [0.0; 4];
    for row in stream.values.chunks_exact(stream.columns.len().max(1)).skip(from) {
        let mut value = [0.0; 4];
        let all = columns
            .iter()
            .zip(&mut value)
            .all(|(column, value)| row[*column].map(|there| *value = there).is_some());
        if !all {
            continue;
        }
        let along: f64 = before.iter().zip(value).map(|(a, b)| a * b).sum();
        if columns.len() == ROTATION.ends.len() && along < 0.0 {
            value = value.map(|part| -part);
        }
        before = value;
        n += 1.0;
        sum.iter_mut().zip(value).for_each(|(sum, part)| *sum += part);
        square += value.iter().map(|part| part * part).sum::<f64>();
    }
    let mean_square: f64 = sum.iter().map(|sum| f64::powi(sum / f64::max(n, 1.0), 2)).sum();
    if n > 1.0 { (square / n - mean_square).max(0.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARTS: [&str; 7] = ["_x_m", "_y_m", "_z_m", "_qw", "_qx", "_qy", "_qz"];

    /// An arm that moves and then rests beside a sensor that stays where it is, both as noisy as `noise`.
    fn rests_after(moving_s: f64, resting_s: f64, noise: f64) -> bool {
        let of = |sensor: &str| PARTS.map(|part| format!("{sensor}{part}"));
        let mut columns = [of("arm"), of("table"), of("lost")].concat();
        columns.push("shoulder_plane_deg".into());
        let rows = (100.0 * (moving_s + resting_s)) as usize;
        let t_s: Vec<f64> = (0..rows).map(|row| row as f64 / 100.0).collect();
        let row = |t: &f64| {
            let angle = if *t < moving_s { libm::sin(3.0 * t) } else { libm::sin(3.0 * moving_s) };
            let jitter = |k: f64| noise * libm::sin(k * t);
            // Half a turn off, so that its sign is all noise's.
            let sign = libm::sin(33.0 * t).signum();
            let (s, c) = libm::sincos(0.4 * angle);
            let arm = [0.2 * angle + jitter(40.0), 0.1, jitter(45.0), 0.0, sign * c, sign * s, 0.0];
            let table = [1.0 + jitter(60.0), jitter(65.0), 0.0, 1.0, 0.3 * jitter(70.0), 0.0, 0.0];
            // This says nothing, and leaps about.
            let plane_deg = 170.0 * libm::sin(20.0 * t).signum();
            let there = [arm, table].concat().into_iter().map(Some);
            there.chain([None; PARTS.len()]).chain([Some(plane_deg)]).collect::<Vec<_>>()
        };
        let values: Vec<_> = t_s.iter().flat_map(row).collect();
        rests(&Stream { columns: &columns, t_s: &t_s, values: &values })
    }

    #[test]
    fn rest_after_movement_is_distinguished_from_movement_and_from_rest_alone() {
        for noise in [0.0, 1e-4, 0.01] {
            assert!(rests_after(8.0, 2.0, noise), "{noise}");
            assert!(!rests_after(8.0, 0.5, noise), "{noise}");
            assert!(!rests_after(10.0, 0.0, noise), "{noise}");
            assert!(!rests_after(0.0, 10.0, noise), "{noise}");
        }
        assert!(!rests(&Stream { columns: &[], t_s: &[], values: &[] }));
    }

    #[test]
    fn angles_alone_are_enough() {
        let columns = ["elbow_r_flexion_deg".to_owned()];
        let t_s: Vec<f64> = (0..800).map(|row| f64::from(row) / 100.0).collect();
        let angle =
            |until_s: f64| t_s.iter().map(move |t| Some(60.0 * libm::sin(3.0 * t.min(until_s)))).collect();
        let rests_from = |until_s| {
            let values: Vec<_> = angle(until_s);
            rests(&Stream { columns: &columns, t_s: &t_s, values: &values })
        };
        assert!(rests_from(6.0) && !rests_from(8.0));
    }
}
