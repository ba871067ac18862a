//! Where a recording repeats itself: subsequences with close neighbours under dynamic time warping.
//!
//! What comes in: frames of scaled channels and a period. What goes out: candidates, each with the places of
//! its repetitions. What it never does: say which of them is right, or where exactly they begin and end; that
//! is the hidden Markov model's work.
//!
//! Weber et al. 2011, section III: the density at a subsequence is one over the distance to its k-th nearest neighbour
//! that does not overlap; candidates are denser than their neighbours. With k repetitions a subsequence has only
//! k - 1 true partners, so the (k - 1)-th decides here. The distance is relative to how much the subsequence moves:
//! rest is always like other rest.

/// Subsequences are compared at this many points at most.
const POINTS: usize = 40;
/// Half width of the warping band as a share of the subsequence (Sakoe & Chiba 1978).
const BAND: f64 = 0.15;
/// Starts of subsequences per period.
const STARTS_PER_PERIOD: f64 = 10.0;

/// A subsequence and its nearest neighbours.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Motif {
    /// First frames of the subsequence and its neighbours, rising.
    pub(super) starts: Vec<usize>,
    /// How much it moves, over the distance to the last neighbour.
    density: f64,
}

/// Candidates for repetitions of `period` frames, each like so many others, its `partners`; densest first, at most `most`.
///
/// `frames` has `width` values per frame, all finite, already scaled by their importance.
pub(super) fn motifs(
    frames: &[f64],
    width: usize,
    period: usize,
    partners: usize,
    most: usize,
) -> Vec<Motif> {
    let length = frames.len() / width.max(1);
    if period < 2 || length < 2 * period {
        return Vec::new();
    }
    let hop = (period as f64 / STARTS_PER_PERIOD).round().max(1.0) as usize;
    let starts: Vec<usize> = (0..=length - period).step_by(hop).collect();
    let points = period.min(POINTS);
    let band = (BAND * points as f64).ceil() as usize;
    let subsequences: Vec<Vec<f64>> = starts
        .iter()
        .map(|start| {
            (0..points)
                .flat_map(|point| {
                    let frame = start + point * period / points;
                    frames[frame * width..(frame + 1) * width].iter().copied()
                })
                .collect()
        })
        .collect();
    let envelopes: Vec<Envelope> =
        subsequences.iter().map(|values| Envelope::new(values, width, band)).collect();
    let mut warping = Warping::new(points, width, band);
    let partners = partners.max(1);
    let mut all: Vec<Motif> = Vec::with_capacity(starts.len());
    for (index, start) in starts.iter().enumerate() {
        // By lower bound, so that most distances need not be computed.
        let mut order: Vec<(f64, usize)> = (0..starts.len())
            .filter(|other| start.abs_diff(starts[*other]) >= period.div_ceil(2))
            .map(|other| (envelopes[index].lower_bound(&subsequences[other]), other))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut known: Vec<(f64, usize)> = Vec::new();
        let mut nearest = Vec::new();
        for (bound, other) in order {
            if nearest.len() == partners && nearest.last().is_some_and(|(last, _)| bound >= *last) {
                break;
            }
            let distance = warping.distance(&subsequences[index], &subsequences[other]);
            if nearest.len() == partners && nearest.last().is_some_and(|(last, _)| distance >= *last) {
                continue;
            }
            let place = known.partition_point(|entry| entry.0 <= distance);
            known.insert(place, (distance, starts[other]));
            nearest = without_overlap(&known, period, partners);
        }
        if nearest.len() < partners {
            continue;
        }
        let last = nearest.last().map_or(f64::INFINITY, |(distance, _)| *distance);
        let mut places: Vec<usize> = nearest.iter().map(|(_, place)| *place).collect();
        places.push(*start);
        places.sort_unstable();
        all.push(Motif { starts: places, density: movement(&subsequences[index], width) / last.max(1e-12) });
    }
    all.sort_by(|a, b| b.density.total_cmp(&a.density));
    // Denser than all others of its neighbourhood: those that share most of its places add nothing.
    let mut chosen: Vec<Motif> = Vec::new();
    for motif in all {
        if chosen.iter().all(|other| shared(other, &motif, hop) * 2 <= motif.starts.len()) {
            chosen.push(motif);
        }
        if chosen.len() == most {
            break;
        }
    }
    chosen
}

/// Mean squared distance from the mean.
fn movement(values: &[f64], width: usize) -> f64 {
    let points = (values.len() / width) as f64;
    (0..width)
        .map(|channel| {
            let column = || values.iter().skip(channel).step_by(width);
            let mean = column().sum::<f64>() / points;
            column().map(|value| (value - mean).powi(2)).sum::<f64>() / points
        })
        .sum()
}

/// The nearest entries of which no two overlap by more than half.
fn without_overlap(sorted: &[(f64, usize)], period: usize, most: usize) -> Vec<(f64, usize)> {
    let mut chosen: Vec<(f64, usize)> = Vec::with_capacity(most);
    for entry in sorted {
        if chosen.iter().all(|other| other.1.abs_diff(entry.1) >= period.div_ceil(2)) {
            chosen.push(*entry);
            if chosen.len() == most {
                break;
            }
        }
    }
    chosen
}

/// Number of places that two motifs have in common, within a hop.
fn shared(a: &Motif, b: &Motif, hop: usize) -> usize {
    b.starts.iter().filter(|start| a.starts.iter().any(|other| other.abs_diff(**start) <= hop)).count()
}

/// Highest and lowest value of each channel within the band around each point (Keogh & Ratanamahatana 2005).
struct Envelope {
    low: Vec<f64>,
    high: Vec<f64>,
    points: usize,
    band: usize,
}

impl Envelope {
    fn new(values: &[f64], width: usize, band: usize) -> Self {
        let points = values.len() / width;
        let (mut low, mut high) = (values.to_vec(), values.to_vec());
        for point in 0..points {
            for other in point.saturating_sub(band)..(point + band + 1).min(points) {
                for channel in 0..width {
                    let value = values[other * width + channel];
                    let here = point * width + channel;
                    low[here] = low[here].min(value);
                    high[here] = high[here].max(value);
                }
            }
        }
        Self { low, high, points, band }
    }

    /// Never more than the warped distance to `values`.
    fn lower_bound(&self, values: &[f64]) -> f64 {
        let mut sum = 0.0;
        for ((low, high), value) in self.low.iter().zip(&self.high).zip(values) {
            let beyond = (value - high).max(low - value).max(0.0);
            sum += beyond * beyond;
        }
        // No path in the band is longer than this.
        sum / (self.points + 2 * self.band).min(2 * self.points - 1) as f64
    }
}

/// Dynamic time warping with its buffers.
struct Warping {
    points: usize,
    width: usize,
    band: usize,
    rows: [Vec<(f64, u32)>; 2],
}

impl Warping {
    fn new(points: usize, width: usize, band: usize) -> Self {
        let row = vec![(f64::INFINITY, 1); points];
        Self { points, width, band, rows: [row.clone(), row] }
    }

    /// Mean squared difference along the best path in the band.
    fn distance(&mut self, a: &[f64], b: &[f64]) -> f64 {
        let [before, row] = &mut self.rows;
        before.fill((f64::INFINITY, 1));
        for i in 0..self.points {
            row.fill((f64::INFINITY, 1));
            let here = &a[i * self.width..(i + 1) * self.width];
            for j in i.saturating_sub(self.band)..(i + self.band + 1).min(self.points) {
                let mut cost = 0.0;
                for (x, y) in here.iter().zip(&b[j * self.width..(j + 1) * self.width]) {
                    cost += (x - y) * (x - y);
                }
                let mut best = if i == 0 && j == 0 { (0.0, 0) } else { before[j] };
                if j > 0 {
                    for step in [before[j - 1], row[j - 1]] {
                        if step.0 < best.0 {
                            best = step;
                        }
                    }
                }
                row[j] = (best.0 + cost, best.1 + 1);
            }
            std::mem::swap(before, row);
        }
        let (sum, steps) = before[self.points - 1];
        sum / f64::from(steps)
    }
}

#[cfg(test)]
mod tests {
    use super::super::viterbi::tests::Random;
    use super::*;

    fn series(seed: u64, points: usize) -> Vec<f64> {
        let mut random = Random::new(seed);
        (0..2 * points).map(|_| random.unit()).collect()
    }

    /// Sum along the cheapest path by trying all of them.
    fn cheapest(a: &[f64], b: &[f64], i: usize, j: usize, band: usize) -> f64 {
        if i.abs_diff(j) > band {
            return f64::INFINITY;
        }
        let cost: f64 = (0..2).map(|c| (a[2 * i + c] - b[2 * j + c]).powi(2)).sum();
        let before = match (i, j) {
            (0, 0) => 0.0,
            (0, _) => cheapest(a, b, 0, j - 1, band),
            (_, 0) => cheapest(a, b, i - 1, 0, band),
            _ => cheapest(a, b, i - 1, j, band).min(cheapest(a, b, i, j - 1, band)).min(cheapest(
                a,
                b,
                i - 1,
                j - 1,
                band,
            )),
        };
        before + cost
    }

    #[test]
    fn warping_equals_brute_force_is_symmetric_and_zero_on_itself() {
        for seed in 0..40 {
            let (a, b) = (series(seed, 7), series(seed + 100, 7));
            for band in [1, 2, 6] {
                let mut warping = Warping::new(7, 2, band);
                let (there, back) = (warping.distance(&a, &b), warping.distance(&b, &a));
                let steps = f64::from(warping.rows[0][6].1);
                assert!((there - back).abs() < 1e-12, "seed {seed}, band {band}");
                assert!((back * steps - cheapest(&a, &b, 6, 6, band)).abs() < 1e-12, "seed {seed}");
                assert_eq!(warping.distance(&a, &a), 0.0);
            }
        }
    }

    #[test]
    fn the_lower_bound_is_one() {
        for seed in 0..200 {
            let (a, b) = (series(seed, 20), series(seed + 1000, 20));
            for band in [1, 3, 19] {
                let bound = Envelope::new(&a, 2, band).lower_bound(&b);
                let distance = Warping::new(20, 2, band).distance(&a, &b);
                assert!(bound <= distance + 1e-12, "seed {seed}, band {band}: {bound} > {distance}");
            }
        }
    }

    #[test]
    fn given_bumps_in_noise_their_places_are_found() {
        let mut random = Random::new(5);
        let mut frames: Vec<f64> = (0..600).map(|_| 0.05 * random.unit()).collect();
        let places = [103, 150, 201, 260, 305];
        for place in places {
            for i in 0..40 {
                frames[place + i] += libm::sin(std::f64::consts::PI * i as f64 / 40.0);
            }
        }
        let found = motifs(&frames, 1, 40, 4, 3);
        let starts = &found[0].starts;
        assert_eq!(starts.len(), 5);
        let shift = starts[0] as f64 - 103.0;
        for (start, place) in starts.iter().zip(places) {
            assert!((*start as f64 - place as f64 - shift).abs() <= 6.0, "{starts:?}");
        }
    }
}
