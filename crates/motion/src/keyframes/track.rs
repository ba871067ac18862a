//! One sensor's key poses over a stream with gaps.
//!
//! What comes in: a pose per frame, or none. What goes out: [`TrackEvent`]s in the stream's frame numbers. Short gaps are
//! bridged by a steady motion once the sensor is back; a longer one ends the motion, and another begins after it.

use nalgebra::Isometry3;
use posed_state::Plain;

use super::{Detector, Event, Hinge, KeyPose, Screw, Statistic, Trace, Window};
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
    /// Frames of the stream so far.
    frames: u64,
    motion: Motion,
}

/// What became known about a key pose, and what the sensor did before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackEvent {
    /// The event.
    pub event: Event,
    /// Of a confirmed one, the segment that it ends; `None` where nothing moved.
    pub segment: Option<Segment>,
}

/// A segment as one screw motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// The frame of the key pose before, or at which the motion began.
    pub since: u64,
    /// The pose there (m; sensor to the frame of reference).
    pub from: Isometry3<f64>,
    /// From that pose to that of the key pose.
    pub screw: Screw,
}

/// A motion without a gap: where its segment began, and its latest poses.
#[derive(Clone, Debug, Plain)]
struct Motion {
    /// Frame of the stream at which it began.
    start: u64,
    /// Frame of the stream and pose of the latest key pose, or of the beginning.
    since: u64,
    from: Isometry3<f64>,
    /// With those that were bridged.
    poses: Window<Isometry3<f64>>,
}

impl<S: Statistic + Clone> Track<S> {
    /// A track that has seen nothing; every motion begins with a copy of `detector`.
    pub fn new(detector: Detector<S>) -> Self {
        let motion = Motion {
            start: 0,
            since: 0,
            from: Isometry3::identity(),
            poses: Window::new(detector.delay_frames() + 1),
        };
        Self { fresh: detector.clone(), detector, last: None, missing: 0, frames: 0, motion }
    }

    /// Takes the next frame: a pose (m; sensor to the frame of reference) or `None` where it is missing. `emit` gets
    /// events.
    ///
    /// Returns the statistic at an earlier frame; `None` for a missing pose and until a window is full. Frames of
    /// events and of the statistic count from the stream's first. Bridging frames are taken with the pose that ends the
    /// gap.
    pub fn push(&mut self, pose: Option<&Isometry3<f64>>, emit: &mut dyn FnMut(TrackEvent)) -> Option<Trace> {
        let now = self.frames;
        self.frames += 1;
        let Some(pose) = pose else {
            self.missing += 1;
            if self.missing == BRIDGED_FRAMES + 1 && self.last.take().is_some() {
                self.motion.finish(&mut self.detector, now, emit);
            }
            return None;
        };
        match self.last {
            Some(last) => {
                for bridge in bridge(&last, pose, self.missing) {
                    self.motion.push(&mut self.detector, &bridge, now, emit);
                }
            }
            None => {
                self.detector.clone_from(&self.fresh);
                self.motion.begin(now, pose);
            }
        }
        let trace = self.motion.push(&mut self.detector, pose, now, emit);
        self.last = Some(*pose);
        self.missing = 0;
        trace.map(|trace| Trace { frame: self.motion.start + trace.frame, ..trace })
    }

    /// The frame at which the present segment began: that of the latest key pose, or of the motion's first pose. `None` while there is no motion.
    pub fn segment_since(&self) -> Option<u64> {
        self.last.map(|_| self.motion.since)
    }

    /// How many frames back an event may speak of.
    pub fn reach_frames(&self) -> usize {
        self.fresh.delay_frames() + BRIDGED_FRAMES + 1
    }
}

impl Motion {
    fn begin(&mut self, now: u64, pose: &Isometry3<f64>) {
        (self.start, self.since, self.from) = (now, now, *pose);
        self.poses.clear();
    }

    fn push<S: Statistic>(
        &mut self,
        detector: &mut Detector<S>,
        pose: &Isometry3<f64>,
        now: u64,
        emit: &mut dyn FnMut(TrackEvent),
    ) -> Option<Trace> {
        self.poses.push(*pose);
        let newest = self.start + detector.frames;
        detector.push(pose, &mut |event| emit(self.tell(event, newest, now)))
    }

    fn finish<S: Statistic>(
        &mut self,
        detector: &mut Detector<S>,
        now: u64,
        emit: &mut dyn FnMut(TrackEvent),
    ) {
        let newest = self.start + detector.frames.saturating_sub(1);
        detector.finish(&mut |event| emit(self.tell(event, newest, now)));
    }

    /// An event in the stream's numbers, decided now; `newest` is the frame of the latest pose.
    fn tell(&mut self, event: Event, newest: u64, now: u64) -> TrackEvent {
        let start = self.start;
        let key = |key: KeyPose| KeyPose { frame: start + key.frame, decided: now, ..key };
        match event {
            Event::Provisional(pose) => TrackEvent { event: Event::Provisional(key(pose)), segment: None },
            Event::Withdrawn(pose) => TrackEvent { event: Event::Withdrawn(key(pose)), segment: None },
            Event::Confirmed(pose) => {
                let key = key(pose);
                TrackEvent { segment: self.end_segment(key.frame, newest), event: Event::Confirmed(key) }
            }
        }
    }

    /// Ends a segment at a frame, where the next one begins.
    fn end_segment(&mut self, frame: u64, newest: u64) -> Option<Segment> {
        let to = *self.poses.latest().iter().nth_back((newest - frame) as usize)?;
        let screw = Screw::between(&self.from, &to);
        let since = std::mem::replace(&mut self.since, frame);
        let from = std::mem::replace(&mut self.from, to);
        Some(Segment { since, from, screw: screw? })
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

    fn confirmed(
        track: &mut Track,
        frames: impl Iterator<Item = Option<Isometry3<f64>>>,
    ) -> Vec<(KeyPose, Option<Segment>)> {
        let mut keys = Vec::new();
        for pose in frames {
            track.push(pose.as_ref(), &mut |event| {
                if let Event::Confirmed(key) = event.event {
                    keys.push((key, event.segment));
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
        let streamed: Vec<u64> = keys.iter().map(|(key, _)| key.frame).collect();
        assert!(streamed.len() >= 5, "{streamed:?}");
        assert_eq!(streamed, whole[..streamed.len()]);
        assert!(keys.iter().all(|(key, _)| key.decided == key.frame + 60));
        // Each segment goes from the key pose before it to its own.
        let mut since = 0;
        for (key, segment) in &keys {
            let segment = segment.unwrap();
            assert_eq!(segment.since, since);
            assert_eq!(
                segment.screw,
                Screw::between(&poses()[since as usize], &poses()[key.frame as usize]).unwrap()
            );
            since = key.frame;
        }
    }

    #[test]
    fn a_short_gap_is_bridged_and_a_long_one_ends_the_motion() {
        let detector = Detector::new(Hinge::new(HingeSettings::default()));
        let with_gap = |gap: std::ops::Range<usize>| {
            let poses = poses().into_iter().enumerate();
            let frames = poses.map(move |(k, pose)| (!gap.contains(&k)).then_some(pose));
            let keys = confirmed(&mut Track::new(detector.clone()), frames);
            keys.iter().map(|(key, _)| key.frame).collect::<Vec<_>>()
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
