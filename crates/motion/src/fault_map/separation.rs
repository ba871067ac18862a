//! How well a map separates classes: the paper's figures of merit.

use serde::Serialize;

use super::FaultMap;
use super::frames::Frames;
use posed_fusion::faults::Class;

/// How well the second layer separates the classes of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Separation {
    /// Neurons per sensor.
    pub neurons: usize,
    /// Rows of the second layer.
    pub side: usize,
    /// Cells that win for some frame.
    pub used: usize,
    /// Share of all cells that win for some frame, 0 to 1.
    pub used_share: f64,
    /// Cells that win for frames of two classes.
    pub overlaps: usize,
    /// Change-overs between classes in the recording: as many overlaps are par.
    pub changeovers: usize,
    /// Share of frames that are in a cell of their own class.
    pub purity: f64,
    /// Share of used neighbouring cells that have the same class.
    pub grouping: f64,
    /// Mean distance of frames from their cell, in shares of a first-layer chain.
    pub error: f64,
}

/// Measures a fault map against one class per frame; frames of unknown class are left out. The frames are in the order
/// of its sensors.
pub fn separation(fault_map: &FaultMap, frames: &Frames, classes: &[Class]) -> Separation {
    let (rows, columns) = fault_map.size();
    let mut counts = vec![[0usize; 4]; rows * columns];
    let (mut error, mut total) = (0.0, 0usize);
    fault_map.watch().follow(fault_map, frames, |k, judged| {
        if let Some(winner) = judged.winner
            && classes[k] != Class::Unknown
        {
            counts[winner.cell][classes[k] as usize] += 1;
            error += winner.distance;
            total += 1;
        }
    });
    let used = |cell: usize| counts[cell].iter().sum::<usize>() > 0;
    let largest = |cell: usize| counts[cell].iter().copied().max().unwrap_or(0);
    let class = |cell: usize| (0..4).max_by_key(|class| counts[cell][*class]);
    let cells: Vec<usize> = (0..counts.len()).filter(|cell| used(*cell)).collect();
    let (mut alike, mut pairs) = (0, 0);
    for &cell in &cells {
        let right = (cell % columns + 1 < columns).then_some(cell + 1);
        let below = (cell + columns < counts.len()).then_some(cell + columns);
        for other in [right, below].into_iter().flatten().filter(|other| used(*other)) {
            pairs += 1;
            alike += usize::from(class(cell) == class(other));
        }
    }
    let share = |part: usize, whole: usize| part as f64 / whole.max(1) as f64;
    Separation {
        neurons: fault_map.positions.first().map_or(0, |positions| positions.classes.len()),
        side: rows,
        used: cells.len(),
        used_share: share(cells.len(), counts.len()),
        overlaps: cells.iter().filter(|cell| counts[**cell].iter().filter(|n| **n > 0).count() > 1).count(),
        changeovers: classes.windows(2).filter(|pair| pair[0] != pair[1]).count(),
        purity: share(cells.iter().map(|cell| largest(*cell)).sum(), total),
        grouping: share(alike, pairs),
        error: error / total.max(1) as f64,
    }
}
