//! How well labels agree with the truth.
//!
//! What comes in: two classes per frame, `None` where the truth is not scored. What goes out: accuracy, edit score,
//! F1 at overlaps, confusion. What it never does: let frames without truth count, for or against.
//!
//! Edit score and F1 as in Lea et al. 2017: over segments, so that over-segmentation shows, which accuracy hides.

use serde::Serialize;

/// Overlaps (intersection over union) from which a motion segment counts as found.
pub const OVERLAPS: [f64; 3] = [0.10, 0.25, 0.50];

/// Accuracy, edit score and F1 of named frames, summed over sequences, as is usual for the segmentation of actions.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Measures {
    /// Frames scored.
    pub frames: u64,
    /// Frames named right.
    pub right: u64,
    /// Frames of class `row` that were named class `column`.
    pub confusion: Vec<Vec<u64>>,
    /// Sum of the sequences' edit scores, 0 to 100.
    edit_sum: f64,
    sequences: u64,
    /// Segments found, invented and missed at each of [`OVERLAPS`].
    pub found: [[u64; 3]; 3],
}

impl Measures {
    /// Measures of so many classes, with nothing scored.
    pub fn new(classes: usize) -> Self {
        Self { confusion: vec![vec![0; classes]; classes], ..Self::default() }
    }

    /// Adds a sequence, one class per frame in both. Frames without truth are cut out before segments are formed.
    ///
    /// # Panics
    /// A class is not below the number of classes.
    pub fn add(&mut self, truth: &[Option<u16>], named: &[u16]) {
        let scored: Vec<(u16, u16)> =
            truth.iter().zip(named).filter_map(|(truth, named)| truth.map(|truth| (truth, *named))).collect();
        for (truth, named) in &scored {
            self.frames += 1;
            self.right += u64::from(truth == named);
            self.confusion[usize::from(*truth)][usize::from(*named)] += 1;
        }
        let truth = runs(scored.iter().map(|pair| pair.0));
        let named = runs(scored.iter().map(|pair| pair.1));
        self.edit_sum += edit_score(&truth, &named);
        self.sequences += 1;
        for (found, overlap) in self.found.iter_mut().zip(OVERLAPS) {
            let hits = hits(&truth, &named, overlap);
            found[0] += hits;
            found[1] += named.len() as u64 - hits;
            found[2] += truth.len() as u64 - hits;
        }
    }

    /// Share of frames named right, %; 0 without frames.
    pub fn accuracy(&self) -> f64 {
        100.0 * self.right as f64 / self.frames.max(1) as f64
    }

    /// Mean edit score over sequences, 0 to 100: 100 less the edits from one list of segments to the other, in % of the
    /// longer one.
    pub fn edit(&self) -> f64 {
        self.edit_sum / self.sequences.max(1) as f64
    }

    /// F1 at each of [`OVERLAPS`], %.
    pub fn f1(&self) -> [f64; 3] {
        self.found.map(|[found, invented, missed]| {
            200.0 * found as f64 / (2 * found + invented + missed).max(1) as f64
        })
    }
}

/// A run of one class: class, first frame, end.
type Run = (u16, usize, usize);

/// Runs of equal classes, in order: class, first frame, frame after the last.
pub fn runs(classes: impl Iterator<Item = u16>) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (frame, class) in classes.enumerate() {
        match runs.last_mut() {
            Some(last) if last.0 == class => last.2 = frame + 1,
            _ => runs.push((class, frame, frame + 1)),
        }
    }
    runs
}

/// 100 less the edits (Levenshtein) from one list of segments to the other, in % of the longer one.
fn edit_score(truth: &[Run], named: &[Run]) -> f64 {
    let longest = truth.len().max(named.len());
    if longest == 0 {
        return 100.0;
    }
    let mut row: Vec<usize> = (0..=named.len()).collect();
    for (i, truth) in truth.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, named) in named.iter().enumerate() {
            let replaced = diagonal + usize::from(truth.0 != named.0);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    100.0 * (1.0 - row[named.len()] as f64 / longest as f64)
}

/// Named segments that overlap a segment of their class, not taken yet, by at least `overlap` (intersection over
/// union); each takes the one it overlaps most.
fn hits(truth: &[Run], named: &[Run], overlap: f64) -> u64 {
    let mut taken = vec![false; truth.len()];
    let mut hits = 0;
    for named in named {
        let mut best = (0.0, None);
        for (index, truth) in truth.iter().enumerate().filter(|(_, truth)| truth.0 == named.0) {
            let common = named.2.min(truth.2).saturating_sub(named.1.max(truth.1)) as f64;
            let union = (named.2.max(truth.2) - named.1.min(truth.1)) as f64;
            if common / union > best.0 {
                best = (common / union, Some(index));
            }
        }
        if let (share, Some(index)) = best
            && share >= overlap
            && !taken[index]
        {
            taken[index] = true;
            hits += 1;
        }
    }
    hits
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(truth: &[u16], named: &[u16]) -> Measures {
        let mut measures = Measures::new(3);
        let truth: Vec<_> = truth.iter().map(|class| Some(*class)).collect();
        measures.add(&truth, named);
        measures
    }

    #[test]
    fn measures_by_hand() {
        // Truth 0 0 0 0 1 1 1 1 2 2; named with a flicker in the first segment and a late border.
        let m = measured(&[0, 0, 0, 0, 1, 1, 1, 1, 2, 2], &[0, 0, 2, 0, 0, 1, 1, 1, 2, 2]);
        assert_eq!(m.right, 8);
        assert!((m.accuracy() - 80.0).abs() < 1e-12);
        // Segments 0 1 2 against 0 2 0 1 2: two insertions of five.
        assert!((m.edit() - 60.0).abs() < 1e-9);
        // At 0.5: the first 0 (2 of 4), 1 (3 of 4) and 2 are found; 2 and the second 0 are invented.
        assert_eq!(m.found[2], [3, 2, 0]);
        assert!((m.f1()[2] - 75.0).abs() < 1e-9);
        assert_eq!(m.confusion[0], [3, 0, 1]);
    }

    #[test]
    fn frames_without_truth_do_not_count() {
        let mut measures = Measures::new(2);
        measures.add(&[Some(0), None, None, Some(1)], &[0, 1, 0, 1]);
        assert_eq!((measures.frames, measures.accuracy()), (2, 100.0));
        assert_eq!((measures.edit(), measures.f1()), (100.0, [100.0; 3]));
    }
}
