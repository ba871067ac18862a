//! Repetitions of a demonstration that are alike but smaller: the first and the last step of a walk, and those of a turn.
//!
//! What comes in: a movement, its repetitions of full size, and how many of those announced are missing. What goes out: as
//! many smaller ones, which the exercise is then counted in too. What it never does: take what is not like the movement at its
//! own size, or what would make two repetitions of one beat.

use std::ops::Range;

use super::align::{Repetition, repetitions};
use super::exercise::RHYTHM;
use super::hmm::{LogRatio, Movement, median};
use super::judge::{Measures, is_alike, measure};
use super::material::Material;

/// Least size of a repetition that counts, the taught one being 1: half a movement is none.
pub(super) const LEAST_GAIN: f64 = 0.66;
/// Smallest size of a repetition of a demonstration, the others being 1.
const SMALLEST: f64 = 0.2;
/// Sizes are looked for in steps of this: what lies between two is wrong by less than the floor of a state's deviation.
const STEP: f64 = 0.6;

/// The `missing` repetitions that are most like the movement at a smaller size, beside those `found` in full size.
pub(super) fn smaller(
    material: &Material,
    movement: &Movement,
    found: &[Repetition],
    missing: usize,
) -> Vec<Repetition> {
    if missing == 0 {
        return Vec::new();
    }
    let sizes = sizes_down_to(0.0);
    let sized: Vec<Movement> = sizes.iter().map(|size| movement.sized(*size)).collect();
    let ratios: Vec<LogRatio> =
        sized.iter().map(|movement| LogRatio::new(movement, &material.channels)).collect();
    let states = ratios[0].states();
    let measures = |repetition: &Repetition| {
        let rows = material.along(repetition.moving(states));
        measure(&sized[repetition.size], &ratios[repetition.size], &material.channels, material.rate_hz, rows)
    };
    let mut taken: Vec<Range<usize>> = found.iter().map(|repetition| repetition.range(states)).collect();
    let middle = |value: fn(&Measures) -> f64| median(found.iter().map(|r| value(&measures(r))));
    let typical = (middle(|m| m.duration_s), middle(|m| m.mean_log_ratio), interval(&taken));
    let (Some(duration_s), Some(log_ratio), Some(interval)) = typical else { return Vec::new() };
    let mut candidates: Vec<(f64, Repetition)> =
        repetitions(&material.observations, 2 * material.width(), &ratios)
            .into_iter()
            .filter(|repetition| repetition.size > 0)
            .map(|repetition| (measures(&repetition), repetition))
            .filter(|(measures, repetition)| {
                is_alike(measures, duration_s, log_ratio)
                    && measures.gain * sizes[repetition.size] >= SMALLEST
            })
            .map(|(measures, repetition)| (measures.similarity, repetition))
            .collect();
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut smaller = Vec::new();
    for (_, repetition) in candidates {
        let range = repetition.range(states);
        let near = |other: &Range<usize>| (other.end.abs_diff(range.end) as f64) < RHYTHM * interval;
        let apart = |other: &Range<usize>| other.end <= range.start || range.end <= other.start;
        if smaller.len() < missing && taken.iter().all(|other| apart(other) && !near(other)) {
            taken.push(range);
            smaller.push(repetition);
        }
    }
    smaller
}

/// Sizes in equal steps from 1 to about `least`, but not below the smallest, so that everything between is near to one of
/// them; 1 alone where the least is not another size.
pub(super) fn sizes_down_to(least: f64) -> Vec<f64> {
    if least >= LEAST_GAIN {
        return vec![1.0];
    }
    let steps = (libm::log(least.max(SMALLEST)) / libm::log(STEP) - 0.5).ceil() as i32;
    (0..=steps).map(|step| STEP.powi(step)).collect()
}

/// Median distance of the ends of segments that follow each other, frames.
pub(super) fn interval(segments: &[Range<usize>]) -> Option<f64> {
    median(segments.windows(2).map(|pair| pair[1].end as f64 - pair[0].end as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_fall_in_equal_steps_and_what_is_nearly_full_is_full() {
        assert_eq!(sizes_down_to(0.9), [1.0]);
        assert_eq!(sizes_down_to(0.6), [1.0, 0.6]);
        let all = sizes_down_to(0.0);
        assert_eq!(all, sizes_down_to(SMALLEST));
        assert!(all.windows(2).all(|pair| pair[1] < pair[0]), "{all:?}");
        let least = all[all.len() - 1];
        assert!((STEP.sqrt()..=1.0 / STEP.sqrt()).contains(&(SMALLEST / least)), "{all:?}");
    }

    #[test]
    fn the_interval_is_that_of_most() {
        assert_eq!(interval(&[0..6, 10..16, 20..26, 60..66]), Some(10.0));
        assert_eq!(interval(&[]), None);
    }
}
