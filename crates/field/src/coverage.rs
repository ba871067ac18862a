//! Whether the pole was in enough places and held in enough directions, and what to do next.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::hull::Hull;
use super::pole::PoleRun;
use super::problem::line;
use super::report::{Code, Reason};
use serde::{Deserialize, Serialize};

/// Side of a cell, and how near a reading must come to its middle, m.
const CELL_M: f64 = 0.2;
const NEAR_M: f64 = 0.3;
/// Cells this far inside the hull count, m.
const INSIDE_M: f64 = 0.05;
/// Share of the cells that must be covered.
const LEAST_COVERED: f64 = 0.7;
/// Least standard deviation of the pole's middle along each axis, m: a pole that only turns in place never shows the
/// same spot to two sensors that are not mirror images.
const LEAST_WANDER_M: f64 = 0.05;
/// Least mean square of the direction along any axis (a third if all directions are alike).
const LEAST_DIRECTION: f64 = 0.03;
/// Least share of frames in each pair of opposite octants.
const LEAST_OCTANT: f64 = 0.01;
/// Fewest frames.
const LEAST_FRAMES: usize = 100;

/// Most places that are named as unvisited.
const MOST_UNVISITED: usize = 60;

/// What somebody is asked to do with the pole. Directions and places are in the transmitter's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "FieldAsk"))]
#[serde(tag = "ask", rename_all = "snake_case")]
pub enum Ask {
    /// Switch its sensors on, or bring it near: none of them is seen.
    Show,
    /// Move it.
    Move,
    /// Move it for a minute: there is too little to judge by.
    Begin {
        /// Instants that could be used so far.
        instants: usize,
    },
    /// Carry it along a direction.
    Carry {
        /// How far its middle has moved that way (standard deviation), m.
        moved_m: f64,
        /// Which.
        along: [f64; 3],
    },
    /// Hold it along a direction, in which it was hardly ever.
    Hold {
        /// Which.
        along: [f64; 3],
    },
    /// The same, where it never was.
    HoldOnce {
        /// Which.
        along: [f64; 3],
    },
    /// Go near a place.
    Visit {
        /// Share of the volume that was visited, 0 to 1.
        visited: f64,
        /// Middle of what was not, m.
        near_m: [f64; 3],
    },
    /// Go on: everything was seen, but too briefly.
    GoOn,
}

impl Ask {
    /// Why a map is not used while this is missing.
    pub(crate) fn reason(&self) -> Reason {
        let code = match self {
            Self::Hold { .. } | Self::HoldOnce { .. } => Code::Excitation,
            _ => Code::Coverage,
        };
        Reason { code, text: self.to_string() }
    }
}

impl fmt::Display for Ask {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Show => write!(out, "move the pole: none of its sensors is seen yet"),
            Self::Move => write!(out, "move the pole"),
            Self::Begin { instants } => {
                write!(out, "only {instants} usable instants; move the pole for a minute")
            }
            Self::Carry { moved_m, along } => write!(
                out,
                "the middle of the pole moved only {:.0} mm along {}; carry it farther that way",
                1e3 * moved_m,
                text_of(&(*along).into())
            ),
            Self::Hold { along } => {
                write!(
                    out,
                    "the pole was hardly ever held along {}; hold it that way",
                    text_of(&(*along).into())
                )
            }
            Self::HoldOnce { along } => {
                write!(out, "the pole was never held along {}", text_of(&(*along).into()))
            }
            Self::Visit { visited, near_m: [x, y, z] } => write!(
                out,
                "only {:.0} % of the volume was visited; go near x = {x:.1} m, y = {y:.1} m, z = {z:.1} m",
                100.0 * visited
            ),
            Self::GoOn => write!(out, "go on waving the pole"),
        }
    }
}

/// Where the pole has been.
#[derive(Clone, Debug, Default)]
pub(crate) struct Coverage {
    /// Share of the cells inside the hull that a reading came near.
    pub(crate) cells: f64,
    /// Share of the four pairs of opposite octants in which the pole was held.
    pub(crate) directions: f64,
    /// Middles of cells that none came near, m; not more than [`MOST_UNVISITED`], spread over all of them.
    pub(crate) unvisited_m: Vec<Vector3<f64>>,
    /// What is missing, the first thing first.
    pub(crate) asks: Vec<Ask>,
}

/// Whether a whole recording has been everywhere.
pub(crate) fn judge(run: &PoleRun, hull: &Hull) -> Coverage {
    let usable = run.frames.iter().filter(|frame| frame.readings.iter().flatten().count() >= 3).count();
    if usable < LEAST_FRAMES {
        return Coverage { asks: vec![Ask::Begin { instants: usable }], ..Coverage::default() };
    }
    look(run, hull)
}

/// Share of the cells inside the hull that a reading came near.
pub(crate) fn visited(run: &PoleRun, hull: &Hull) -> f64 {
    cells(run, hull).0
}

/// Where the pole has been so far, and where it should go.
pub(crate) fn look(run: &PoleRun, hull: &Hull) -> Coverage {
    let mut asks = Vec::new();
    let (mut middles, mut directions) = (Vec::new(), Vec::new());
    let mut row = Vec::new();
    for frame in &run.frames {
        run.row(frame, &mut row);
        if row.len() >= 3 {
            let (points, offsets): (Vec<_>, Vec<_>) = row.iter().copied().unzip();
            let (middle, along) = line(&points, &offsets);
            middles.push(middle);
            directions.push(along);
        }
    }
    let count = (middles.len() as f64).max(1.0);
    let mean = middles.iter().sum::<Vector3<f64>>() / count;
    let spread =
        middles.iter().fold(Matrix3::zeros(), |s, m| s + (m - mean) * (m - mean).transpose() / count);
    let (least, axis) = weakest(&spread);
    if least.max(0.0).sqrt() < LEAST_WANDER_M {
        asks.push(Ask::Carry { moved_m: least.max(0.0).sqrt(), along: axis.into() });
    }
    let turning = directions.iter().fold(Matrix3::zeros(), |s, d| s + d * d.transpose() / count);
    let (least, axis) = weakest(&turning);
    if least < LEAST_DIRECTION {
        asks.push(Ask::Hold { along: axis.into() });
    }
    let mut octants = [0usize; 4];
    for d in &directions {
        let d = if d.z < 0.0 { -d } else { *d };
        octants[usize::from(d.x < 0.0) + 2 * usize::from(d.y < 0.0)] += 1;
    }
    for (k, seen) in octants.iter().enumerate() {
        if (*seen as f64) < LEAST_OCTANT * count && least >= LEAST_DIRECTION {
            let axis =
                Vector3::new(if k & 1 == 1 { -1.0 } else { 1.0 }, if k & 2 == 2 { -1.0 } else { 1.0 }, 1.0);
            asks.push(Ask::HoldOnce { along: axis.normalize().into() });
        }
    }
    let held = octants.iter().filter(|seen| **seen as f64 >= LEAST_OCTANT * count && **seen > 0).count();
    let (cells, empty) = cells(run, hull);
    if cells < LEAST_COVERED {
        let near = empty.iter().sum::<Vector3<f64>>() / empty.len().max(1) as f64;
        asks.push(Ask::Visit { visited: cells, near_m: near.into() });
    }
    let unvisited_m = empty.iter().step_by(empty.len().div_ceil(MOST_UNVISITED).max(1)).copied().collect();
    Coverage { cells, directions: held as f64 / octants.len() as f64, unvisited_m, asks }
}

/// Smallest eigenvalue and its axis.
fn weakest(matrix: &Matrix3<f64>) -> (f64, Vector3<f64>) {
    let eigen = matrix.symmetric_eigen();
    let k = eigen.eigenvalues.imin();
    (eigen.eigenvalues[k], eigen.eigenvectors.column(k).into_owned())
}

/// An axis in words.
fn text_of(axis: &Vector3<f64>) -> String {
    let k = axis.iamax();
    if axis[k].abs() > 0.9 {
        return ["x", "y", "z"][k].to_owned();
    }
    let axis = if axis[k] < 0.0 { -axis } else { *axis };
    format!("({:.1}, {:.1}, {:.1})", axis.x, axis.y, axis.z)
}

/// Share of the cells inside the hull that a reading came near, and those that none did.
fn cells(run: &PoleRun, hull: &Hull) -> (f64, Vec<Vector3<f64>>) {
    let [low, high] = hull.bounds_m();
    let step = CELL_M.max(libm::cbrt((high - low).iter().product::<f64>() / 8000.0));
    let counts = (high - low).map(|x| (x / step).ceil() as usize + 1);
    let at = |index: usize| {
        let (i, j, k) = (index % counts.x, index / counts.x % counts.y, index / (counts.x * counts.y));
        low + Vector3::new(i as f64, j as f64, k as f64) * step
    };
    let total = counts.x * counts.y * counts.z;
    let mut near = vec![false; total];
    let near_m = NEAR_M.max(1.5 * step);
    for (_, _, reading) in run.readings() {
        let cell = ((reading.position_m - low) / step).map(|x| x.round() as isize);
        for (di, dj, dk) in (0..27).map(|n| (n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1)) {
            let [i, j, k] = [cell.x + di, cell.y + dj, cell.z + dk];
            let inside = |v: isize, n: usize| (0..n as isize).contains(&v);
            if inside(i, counts.x) && inside(j, counts.y) && inside(k, counts.z) {
                let index = (k as usize * counts.y + j as usize) * counts.x + i as usize;
                if !near[index] && (at(index) - reading.position_m).norm() < near_m {
                    near[index] = true;
                }
            }
        }
    }
    let (mut covered, mut empty) = (0usize, Vec::new());
    for (index, near) in near.iter().enumerate() {
        let position_m = at(index);
        if hull.outside_m(&position_m) < -INSIDE_M {
            if *near {
                covered += 1;
            } else {
                empty.push(position_m);
            }
        }
    }
    let inside = covered + empty.len();
    (if inside == 0 { 1.0 } else { covered as f64 / inside as f64 }, empty)
}
