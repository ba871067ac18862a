//! Key poses on generated gestures: the published table, the default beside it, the path, and real dwells.

use posed_baselines::change_points::{MeanDifference, MeanDifferenceSettings, ScrewPath};
use posed_motion::keyframes::Spline;
use posed_motion::keyframes::{Detector, Hinge, HingeSettings, Statistic};
use posed_simulator::gesture::{Gesture, NOISE, Shape, count_errors};

/// False positives and misses of the paper: rows are levels of noise, columns N = 10, 20, 30, 40, 50.
const PAPER: [[(usize, usize); 5]; 7] = [
    [(0, 0), (0, 0), (0, 0), (1, 0), (1, 1)],
    [(0, 1), (0, 0), (0, 0), (1, 0), (1, 1)],
    [(2, 1), (0, 0), (0, 0), (1, 1), (1, 1)],
    [(19, 0), (1, 0), (0, 0), (0, 0), (0, 1)],
    [(27, 0), (10, 0), (0, 0), (0, 0), (0, 1)],
    [(28, 1), (13, 0), (4, 0), (1, 0), (0, 1)],
    [(28, 1), (10, 1), (4, 0), (3, 0), (4, 2)],
];
const WINDOWS: [usize; 5] = [10, 20, 30, 40, 50];

/// Mean errors per cell over some seeds.
fn table<S: Statistic + Clone>(seeds: u64, statistic: impl Fn(usize) -> S) -> [[f64; 5]; 7] {
    let mut cells = [[0.0; 5]; 7];
    // The threshold is computed once.
    let detectors = WINDOWS.map(|window| Detector::new(statistic(window)));
    for (level, row) in cells.iter_mut().enumerate() {
        for seed in 0..seeds {
            let poses = Gesture::of_the_table(seed).noisy(NOISE[level]);
            for (cell, detector) in row.iter_mut().zip(&detectors) {
                let (keys, _) = detector.clone().run(&poses);
                let (alarms, misses) = count_errors(keys.iter().map(|key| key.frame as usize));
                *cell += (alarms + misses) as f64 / seeds as f64;
            }
        }
    }
    cells
}

fn paper(window: usize) -> MeanDifference {
    let settings = MeanDifferenceSettings::default();
    MeanDifference::new(MeanDifferenceSettings { window, metres_per_radian: 0.01, ..settings })
}

fn hinge(window: usize) -> Hinge {
    Hinge::new(HingeSettings { window, ..HingeSettings::default() })
}

fn sum(cells: &[[f64; 5]; 7]) -> f64 {
    cells.iter().flatten().sum()
}

/// Ranks, ties shared.
fn ranks(values: &[f64]) -> Vec<f64> {
    let rank = |value: &f64| {
        let below = values.iter().filter(|other| *other < value).count() as f64;
        let equal = values.iter().filter(|other| *other == value).count() as f64;
        below + 0.5 * (equal - 1.0)
    };
    values.iter().map(rank).collect()
}

fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = (a.len() - 1) as f64 / 2.0;
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean)).sum::<f64>();
    product(&a, &b) / (product(&a, &a) * product(&b, &b)).sqrt()
}

#[test]
fn the_papers_table_is_reproduced_in_its_pattern() {
    let cells = table(10, paper);
    println!("{cells:.1?}");
    let ours: Vec<f64> = cells.iter().flatten().copied().collect();
    let theirs: Vec<f64> = PAPER.iter().flatten().map(|(alarms, misses)| (alarms + misses) as f64).collect();
    let correlation = rank_correlation(&ours, &theirs);
    let total = sum(&cells);
    println!("sum {total:.1}, rank correlation {correlation:.2}");
    // 152.9 and 0.80 were seen; the paper's own table has 174.
    assert!((135.0..175.0).contains(&total), "{total}");
    assert!(correlation >= 0.77, "{correlation}");
    let column = |c: usize| cells.iter().map(|row| row[c]).sum::<f64>();
    let best = (0..5).min_by(|a, b| column(*a).total_cmp(&column(*b))).unwrap();
    assert!(best == 2 || best == 3, "N = {} is best", WINDOWS[best]);
    // N = 50 always misses one of the changes at 250 and 300.
    assert!(cells.iter().all(|row| row[4] >= 0.9), "{cells:.1?}");
}

#[test]
fn the_default_finds_all_changes_where_the_noise_is_that_of_a_tracker() {
    let detector = Detector::new(hinge(30));
    let (mut alarms, mut misses) = (0, 0);
    for seed in 0..10 {
        for shape in [Shape::Straight, Shape::Bent, Shape::Swaying] {
            let poses = Gesture { seed, shape, size_m: 1.0, rotation_deg: 200.0 }.noisy((0.001, 0.5));
            let (keys, _) = detector.clone().run(&poses);
            let errors = count_errors(keys.iter().map(|key| key.frame as usize));
            (alarms, misses) = (alarms + errors.0, misses + errors.1);
        }
    }
    // 30 gestures with 180 changes, five minutes of motion: no error was seen.
    println!("{alarms} false alarms, {misses} misses");
    assert!(alarms <= 2 && misses == 0, "{alarms} {misses}");
}

#[test]
fn the_spline_is_nearer_to_the_recording_than_the_screw_on_every_gesture() {
    let detector = Detector::new(hinge(30));
    for seed in 0..4 {
        for shape in [Shape::Straight, Shape::Bent, Shape::Swaying] {
            for noise in [(0.0, 0.0), (0.001, 0.1), NOISE[2]] {
                let poses = Gesture { shape, ..Gesture::of_the_table(seed) }.noisy(noise);
                let (keys, _) = detector.clone().run(&poses);
                let last = poses.len() - 1;
                let spline = Spline::fit(&poses, &keys).unwrap().deviation(&poses, 0..=last);
                let screw = ScrewPath::new(&poses, &keys).unwrap().deviation(&poses, 0..=last);
                let what = format!("{shape:?} {seed} {noise:?}: {spline:?} {screw:?}");
                assert!(spline.position_m < screw.position_m, "{what}");
                // A straight piece without noise turns about one axis: both are exact there.
                assert!(spline.rotation_rad < screw.rotation_rad + 1e-6, "{what}");
            }
        }
    }
}
