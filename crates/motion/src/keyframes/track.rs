//! One sensor's key poses over a stream with gaps.
//!
//! What comes in: a pose per frame, or none. What goes out: [`Event`]s in the stream's frame numbers. Short gaps are
//! bridged by a steady motion once the sensor is back; a longer one ends the motion, and another begins after it.

use nalgebra::Isometry3;
use posed_state::Plain;

use super::{Detector, Event, Hinge, KeyPose, Statistic, Trace};
use posed_geometry::so3;

/// Missing frames up to this many are bridged; a longer gap ends the motion, and another begins after it.
pub const BRIDGED_FRAMES: usize = 5;

/// Finds key poses of one sensor in a stream with gaps. Delay and accuracy are those of its detector; nothing is
/// decided within the lag of either side of a gap that is not bridged.
#[derive(Clone, Debug, Plain)]
pub struct Track<S = Hinge> {
    /// As it is before its first pose.
    fresh: Detector<S>,
    detector: Detector<S>,
    last: Option<Isometry3<f64>>,
    missing: usize,
    /// Frames of the stream so far, and the one at which this motion began.
    frames: u64,
    start: u64,
}

impl<S: Statistic + Clone> Track<S> {
    /// A track that has seen nothing; every motion begins with a copy of `detector`.
    pub fn new(detector: Detector<S>) -> Self {
        Self { fresh: detector.clone(), detector, last: None, missing: 0, frames: 0, start: 0 }
    }

    /// Takes the next frame: a pose (m; sensor to the frame of reference) or `None` where it is missing. `emit` gets
    /// events.
    ///
    /// Returns the statistic at an earlier frame; `None` for a missing pose and until a window is full. Frames of
    /// events and of the statistic count from the stream's first. Bridging frames are taken with the pose that ends the
    /// gap.
    pub fn push(&mut self, pose: Option<&Isometry3<f64>>, emit: &mut impl FnMut(Event)) -> Option<Trace> {
        let now = self.frames;
        self.frames += 1;
        let Some(pose) = pose else {
            self.missing += 1;
            if self.missing == BRIDGED_FRAMES + 1 && self.last.take().is_some() {
                self.detector.finish(&mut in_stream(self.start, now, emit));
            }
            return None;
        };
        match self.last {
            Some(last) => {
                for bridge in bridge(&last, pose, self.missing) {
                    self.detector.push(&bridge, &mut in_stream(self.start, now, emit));
                }
            }
            None => {
                self.detector.clone_from(&self.fresh);
                self.start = now;
            }
        }
        let trace = self.detector.push(pose, &mut in_stream(self.start, now, emit));
        self.last = Some(*pose);
        self.missing = 0;
        trace.map(|trace| Trace { frame: self.start + trace.frame, ..trace })
    }

    /// What a peak of the statistic must exceed; `None` where it depends on the motion.
    pub fn threshold(&self) -> Option<f64> {
        self.fresh.threshold()
    }

    /// How many frames back an event may speak of.
    pub fn reach_frames(&self) -> usize {
        self.fresh.delay_frames() + BRIDGED_FRAMES + 1
    }
}

/// Frames of an event in the stream's numbers, decided now.
fn in_stream(start: u64, now: u64, emit: &mut impl FnMut(Event)) -> impl FnMut(Event) {
    move |event| {
        let key = |key: KeyPose| KeyPose { frame: start + key.frame, decided: now, ..key };
        emit(match event {
            Event::Provisional(pose) => Event::Provisional(key(pose)),
            Event::Confirmed(pose) => Event::Confirmed(key(pose)),
            Event::Withdrawn(pose) => Event::Withdrawn(key(pose)),
        });
    }
}

/// Poses of a steady motion between two, `missing` of them, in equal steps: straight in position, about one axis in
/// rotation (by the shorter way).
pub fn bridge<'a>(
    from: &'a Isometry3<f64>,
    to: &'a Isometry3<f64>,
    missing: usize,
) -> impl Iterator<Item = Isometry3<f64>> + 'a {
    (1..=missing).map(move |k| {
        let share = k as f64 / (missing + 1) as f64;
        let position = from.translation.vector.lerp(&to.translation.vector, share);
        let rotation_vector_rad = so3::log(&(from.rotation.inverse() * to.rotation)) * share;
        Isometry3::from_parts(position.into(), from.rotation * so3::exp(&rotation_vector_rad))
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::keyframes::HingeSettings;

    /// Back and forth, turning round every 100 frames.
    fn poses() -> Vec<Isometry3<f64>> {
        let place = |k: usize| {
            let there = (k % 200) as f64;
            let noise = ((k * 7919) % 101) as f64 * 1e-6;
            Isometry3::translation(0.01 * there.min(200.0 - there) + noise, 0.0, 0.0)
        };
        (0..700).map(place).collect()
    }

    fn confirmed(track: &mut Track, frames: impl Iterator<Item = Option<Isometry3<f64>>>) -> Vec<KeyPose> {
        let mut keys = Vec::new();
        for pose in frames {
            track.push(pose.as_ref(), &mut |event| {
                if let Event::Confirmed(key) = event {
                    keys.push(key);
                }
            });
        }
        keys
    }

    #[test]
    fn a_stream_gives_what_the_whole_motion_gives() {
        let detector = Detector::new(Hinge::new(HingeSettings::default()));
        let (whole, _) = detector.clone().run(&poses());
        let whole: Vec<u64> = whole.iter().map(|key| key.frame).collect();
        let keys = confirmed(&mut Track::new(detector), poses().into_iter().map(Some));
        let streamed: Vec<u64> = keys.iter().map(|key| key.frame).collect();
        assert!(streamed.len() >= 5, "{streamed:?}");
        assert_eq!(streamed, whole[..streamed.len()]);
        assert!(keys.iter().all(|key| key.decided == key.frame + 60));
    }

    #[test]
    fn a_short_gap_is_bridged_and_a_long_one_ends_the_motion() {
        let detector = Detector::new(Hinge::new(HingeSettings::default()));
        let with_gap = |gap: std::ops::Range<usize>| {
            let poses = poses().into_iter().enumerate();
            let frames = poses.map(move |(k, pose)| (!gap.contains(&k)).then_some(pose));
            let keys = confirmed(&mut Track::new(detector.clone()), frames);
            keys.iter().map(|key| key.frame).collect::<Vec<_>>()
        };
        let whole = with_gap(0..0);
        // In the middle of a straight piece a bridge is nearly what was lost.
        assert_eq!(with_gap(250..250 + BRIDGED_FRAMES), whole);
        let cut = with_gap(290..320);
        let far = |frames: &[u64]| {
            frames.iter().copied().filter(|frame| !(255..=355).contains(frame)).collect::<Vec<_>>()
        };
        assert_eq!(far(&cut), far(&whole));
        assert!(!cut.iter().any(|frame| (290..350).contains(frame)), "{cut:?}");
    }

    #[test]
    fn a_bridge_turns_and_moves_in_equal_steps() {
        let to = Isometry3::new(Vector3::new(0.3, 0.0, 0.0), Vector3::new(0.0, 0.0, 0.6));
        let steps: Vec<_> = bridge(&Isometry3::identity(), &to, 2).collect();
        assert!(
            (steps[0].translation.x - 0.1).abs() < 1e-12 && (steps[1].rotation.angle() - 0.4).abs() < 1e-12
        );
    }
}
