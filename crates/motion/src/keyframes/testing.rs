//! What a detector promises whatever its statistic.

use nalgebra::Isometry3;
use posed_state::Plain;

use super::{Detector, Event, Statistic};

/// Holds that each key pose is provisional before it is confirmed, one at a time, and confirmed after the stated delay; returns
/// how many were confirmed.
///
/// # Panics
/// The detector does not do so.
pub(super) fn confirms_as_stated<S: Statistic>(mut detector: Detector<S>, poses: &[Isometry3<f64>]) -> usize {
    let delay = detector.delay_frames() as u64;
    let (mut open, mut confirmed) = (None, 0);
    for pose in poses {
        detector.push(pose, &mut |event| match event {
            Event::Provisional(key) => open = Some(key.frame),
            Event::Withdrawn(key) => assert_eq!(open.take(), Some(key.frame)),
            Event::Confirmed(key) => {
                assert_eq!(open.take(), Some(key.frame));
                assert_eq!(key.decided - key.frame, delay);
                confirmed += 1;
            }
        });
    }
    confirmed
}

/// Holds that a detector which is stored and restored every 37 poses goes on as one that never was.
///
/// # Panics
/// It does not.
pub(super) fn goes_on_when_restored<S: Statistic>(
    detector: impl Fn() -> Detector<S>,
    poses: &[Isometry3<f64>],
) where
    Detector<S>: Plain,
{
    let (mut straight, mut broken) = (detector(), detector());
    for (k, pose) in poses.iter().enumerate() {
        if k % 37 == 0 {
            let bytes = posed_state::snapshot(&broken);
            broken = detector();
            posed_state::restore(&mut broken, &bytes).unwrap();
        }
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let traces =
            (straight.push(pose, &mut |event| a.push(event)), broken.push(pose, &mut |event| b.push(event)));
        assert_eq!(traces.0, traces.1);
        assert_eq!(a, b);
    }
}

/// Holds that what is confirmed within the first `end` poses, for each of `ends`, is the same without the others.
///
/// # Panics
/// It is not.
pub(super) fn does_not_look_ahead<S: Statistic>(
    detector: impl Fn() -> Detector<S>,
    poses: &[Isometry3<f64>],
    ends: &[usize],
) {
    let (whole, _) = detector().run(poses);
    for &end in ends {
        let (mut detector, mut keys) = (detector(), Vec::new());
        for pose in &poses[..end] {
            detector.push(pose, &mut |event| {
                if let Event::Confirmed(key) = event {
                    keys.push(key);
                }
            });
        }
        let known: Vec<_> = whole.iter().filter(|key| key.decided < end as u64).copied().collect();
        assert_eq!(keys, known, "the first {end} frames");
    }
}
