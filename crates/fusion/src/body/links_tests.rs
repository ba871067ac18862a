//! Headings that drift for hours: the filter alone, with joints that are twisted and accelerated as people's are.

use super::links::{LINKS, Links, Source, UNITS, unit};
use super::skeleton::BodySegment;
use crate::testing::Random;

const HOURS: f64 = 3.0;
const WINDOW_S: f64 = 0.5;

/// What is wrong with each heading after hours, rad, and the filter; `source` says what identifies each, of those that drift at some 0.01 degrees a second.
fn after_hours(mut source: impl FnMut(usize) -> Source, seed: u64) -> ([f64; UNITS], Links) {
    let mut random = Random::new(seed);
    let sources = std::array::from_fn(|u| Some(source(u)));
    let mut rates: [f64; UNITS] = std::array::from_fn(|_| 2e-4 * random.normal());
    // A rate stays for ten minutes.
    let stays = libm::exp(-WINDOW_S / 600.0);
    let mut off = [0.0; UNITS];
    let mut twists = [0.0; LINKS.len()];
    let mut links = Links::default();
    links.begin(&sources);
    for _ in 0..(HOURS * 3600.0 / WINDOW_S) as usize {
        for ((off, rate), source) in off.iter_mut().zip(&mut rates).zip(&sources) {
            *rate = stays * *rate + 2e-4 * (1.0 - stays * stays).sqrt() * random.normal();
            if *source != Some(Source::Field) {
                *off += *rate * WINDOW_S;
            }
        }
        let seen = std::array::from_fn(|k| {
            let below = LINKS[k].below;
            let between = off[unit(below)] - off[unit(below.parent().unwrap())];
            // A twist that comes and goes within ten seconds.
            let keep = libm::exp(-WINDOW_S / 10.0);
            twists[k] =
                keep * twists[k] + 0.7 * LINKS[k].twist_rad * (1.0 - keep * keep).sqrt() * random.normal();
            Some((between + twists[k], 1.0))
        });
        for (k, link) in LINKS.iter().enumerate() {
            let between = off[unit(link.below)] - off[unit(link.below.parent().unwrap())];
            links.feel(k, between + 0.5 * random.normal(), 0.2);
        }
        let turned = links.run(&sources, &seen, WINDOW_S);
        for (off, turned) in off.iter_mut().zip(turned) {
            *off -= turned;
        }
    }
    (off, links)
}

#[test]
fn headings_hold_together_for_hours() {
    for seed in 0..3 {
        let gyro = |_: usize| Source::Gyro { rate_rad_s: 2e-4, turns: true };
        let (off, links) = after_hours(gyro, seed);
        for link in &LINKS {
            let parent = link.below.parent().unwrap();
            let between = (off[unit(link.below)] - off[unit(parent)]).abs();
            let sigma = links.between_rad2(link.below, parent).sqrt();
            assert!(between < 3.0 * sigma, "{}: {between} of {sigma} rad", link.below.name());
            assert!(between < 0.4, "{}: {between} rad", link.below.name());
        }
        // All together have drifted by some turns' tenths, and say so.
        let torso = off[unit(BodySegment::Torso)].abs();
        let sigma = links.rad2(BodySegment::Torso).sqrt();
        assert!(torso < 3.0 * sigma && sigma < 4.0, "{torso} of {sigma} rad");
    }
}

#[test]
fn what_a_field_identifies_holds_what_hangs_on_it() {
    let pelvis = unit(BodySegment::Pelvis);
    let (off, links) = after_hours(
        |u| if u == pelvis { Source::Field } else { Source::Gyro { rate_rad_s: 2e-4, turns: true } },
        7,
    );
    for segment in [BodySegment::Torso, BodySegment::Head, BodySegment::ThighR, BodySegment::FootL] {
        let off = off[unit(segment)].abs();
        let sigma = links.rad2(segment).sqrt();
        assert!(off < 3.0 * sigma && off < 0.4, "{}: {off} of {sigma} rad", segment.name());
    }
}

/// Somebody walks in a circle for two minutes, and the other way round for two more: each gyro's scale is wrong by some thousandths.
#[test]
fn who_turns_for_minutes_has_drifted_and_says_so() {
    let gyro = std::array::from_fn(|_| Some(Source::Gyro { rate_rad_s: 2e-5, turns: true }));
    let torso = unit(BodySegment::Torso);
    let mut squares = 0.0;
    const SEEDS: u64 = 20;
    for seed in 0..SEEDS {
        let mut random = Random::new(seed);
        let scales: [f64; UNITS] = std::array::from_fn(|_| 0.003 * random.normal());
        let mut off = [0.0; UNITS];
        let mut links = Links::default();
        links.begin(&gyro);
        for turns_rad_s in [0.8, -0.8] {
            for _ in 0..240 {
                links.turned(turns_rad_s * WINDOW_S);
                for (off, scale) in off.iter_mut().zip(&scales) {
                    *off += scale * turns_rad_s * WINDOW_S;
                }
                for (k, link) in LINKS.iter().enumerate() {
                    let between = off[unit(link.below)] - off[unit(link.below.parent().unwrap())];
                    links.feel(k, between + 0.5 * random.normal(), 0.2);
                }
                let turned = links.run(&gyro, &[None; LINKS.len()], WINDOW_S);
                for (off, turned) in off.iter_mut().zip(turned) {
                    *off -= turned;
                }
            }
            squares += off[torso].powi(2) / links.rad2(BodySegment::Torso);
        }
    }
    let sigmas = (squares / (2 * SEEDS) as f64).sqrt();
    assert!((0.4..1.5).contains(&sigmas), "{sigmas} of the stated sigma");
}

/// A disturbed field neither turns its own sensor nor holds another.
#[test]
fn what_has_a_field_is_never_turned() {
    let torso = unit(BodySegment::Torso);
    let mut links = Links::default();
    let sources = std::array::from_fn(|u| Some(Source::Gyro { rate_rad_s: 2e-4, turns: u != torso }));
    links.begin(&sources);
    let twisted = [Some((0.3, 1.0)); LINKS.len()];
    for _ in 0..100 {
        let turned = links.run(&sources, &twisted, WINDOW_S);
        assert_eq!(turned[torso], 0.0);
        assert!(turned.iter().any(|turned| *turned != 0.0));
    }
}
