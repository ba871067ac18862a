//! Which sensor sits on which segment, found from the calibration's script.
//!
//! In: how fast each sensor turned while each movement was done. Out: a segment per sensor, or which two segments cannot be
//! told apart and what to do. It never guesses between two that moved alike.
//!
//! A movement names the segments that turn in it; everybody else holds still. Sensors and segments are matched so that
//! the sum of squared departures is least (Kuhn 1955).

use nalgebra::DMatrix;
use thiserror::Error;

use super::calibrate::{Kind, Movement};
use super::skeleton::Segment;

/// Two assignments whose costs differ by less, per movement, cannot be told apart.
const MARGIN: f64 = 0.15;

/// Why sensors cannot be placed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlaceError {
    /// Nothing moved.
    #[error("nobody moved in {0}: repeat it, further and faster")]
    Still(String),
    /// As many sensors as segments are needed.
    #[error("{sensors} sensors for {segments} segments")]
    Count {
        /// Sensors.
        sensors: usize,
        /// Segments.
        segments: usize,
    },
    /// Two segments moved alike.
    #[error("{first} and {second} moved alike: add a movement of one of them alone, such as {mend}")]
    Alike {
        /// One of them.
        first: &'static str,
        /// The other.
        second: &'static str,
        /// A movement that tells them apart.
        mend: String,
    },
}

/// How much a segment turns in a movement, as a part of what turns most.
fn share(segment: Segment, kind: Kind) -> f64 {
    match kind {
        Kind::NPose | Kind::TPose => 0.0,
        Kind::Bow => match segment {
            Segment::ThighR | Segment::ThighL | Segment::ShankR | Segment::ShankL => 0.0,
            _ => 1.0,
        },
        Kind::TrunkRotation => match segment {
            Segment::Pelvis | Segment::ThighR | Segment::ThighL | Segment::ShankR | Segment::ShankL => 0.0,
            _ => 1.0,
        },
        Kind::Move(moved, movement) => {
            let child = segment.parent() == Some(moved);
            if segment == moved || (child && movement != Movement::Pronation) { 1.0 } else { 0.0 }
        }
    }
}

/// The segment of each sensor. `turned[k][i]` is the root mean square rate of sensor i in movement k, rad/s.
///
/// # Errors
/// Movements that do not tell the segments apart.
pub fn places(
    segments: &[Segment],
    movements: &[Kind],
    turned: &[Vec<f64>],
) -> Result<Vec<Segment>, PlaceError> {
    let count = segments.len();
    let sensors = turned.first().map_or(0, Vec::len);
    if sensors != count {
        return Err(PlaceError::Count { sensors, segments: count });
    }
    let mut cost = DMatrix::<f64>::zeros(count, count);
    for (kind, rates) in movements.iter().zip(turned) {
        let most = rates.iter().copied().fold(0.0, f64::max);
        if matches!(kind, Kind::NPose | Kind::TPose) {
            continue;
        }
        if most < 0.2 {
            return Err(PlaceError::Still(kind.name()));
        }
        for (i, rate) in rates.iter().enumerate() {
            for (j, segment) in segments.iter().enumerate() {
                cost[(i, j)] += (rate / most - share(*segment, *kind)).powi(2);
            }
        }
    }
    let assigned = least_cost(&cost);
    // Any two sensors swapped must cost clearly more.
    for i in 0..count {
        for j in 0..i {
            let (a, b) = (assigned[i], assigned[j]);
            let more = cost[(i, b)] + cost[(j, a)] - cost[(i, a)] - cost[(j, b)];
            if more < MARGIN {
                let mend = match segments[a] {
                    Segment::Torso | Segment::Pelvis => Kind::TrunkRotation,
                    limb => Kind::Move(limb, Movement::Flexion),
                };
                let mend = mend.name();
                let (first, second) = (segments[a].name(), segments[b].name());
                return Err(PlaceError::Alike { first, second, mend });
            }
        }
    }
    Ok(assigned.into_iter().map(|j| segments[j]).collect())
}

/// The column of each row so that the sum is least: improves by augmenting along shortest paths (Jonker & Volgenant 1987).
fn least_cost(cost: &DMatrix<f64>) -> Vec<usize> {
    let n = cost.nrows();
    let (mut u, mut v) = (vec![0.0; n + 1], vec![0.0; n + 1]);
    let (mut row_of, mut way) = (vec![0_usize; n + 1], vec![0_usize; n + 1]);
    for i in 1..=n {
        row_of[0] = i;
        let mut j0 = 0;
        let mut least = vec![f64::INFINITY; n + 1];
        let mut used = vec![false; n + 1];
        while row_of[j0] != 0 {
            used[j0] = true;
            let i0 = row_of[j0];
            let (mut delta, mut j1) = (f64::INFINITY, 0);
            for j in 1..=n {
                if used[j] {
                    continue;
                }
                let reduced = cost[(i0 - 1, j - 1)] - u[i0] - v[j];
                if reduced < least[j] {
                    least[j] = reduced;
                    way[j] = j0;
                }
                if least[j] < delta {
                    delta = least[j];
                    j1 = j;
                }
            }
            for j in 0..=n {
                if used[j] {
                    u[row_of[j]] += delta;
                    v[j] -= delta;
                } else {
                    least[j] -= delta;
                }
            }
            j0 = j1;
        }
        while j0 != 0 {
            let j1 = way[j0];
            row_of[j0] = row_of[j1];
            j0 = j1;
        }
    }
    let mut columns = vec![0; n];
    for j in 1..=n {
        columns[row_of[j] - 1] = j - 1;
    }
    columns
}
