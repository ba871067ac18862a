//! What a motion means: where it changes, which exercise it is.
//!
//! What comes in: poses, angles or raw signals, frame by frame. What goes out: events with the frame they speak about
//! and the frame at which they were decided. What it never does: change a pose, look at a clock, allocate once warm.
//!
//! | module | finds | after |
//! |---|---|---|
//! | [`keyframes`] | where a rigid motion changes its velocity | Merckel & Nishida 2010 |
//! | [`exercise`] | repetitions of an exercise that was shown | Weber et al. 2011 |
//! | [`segments`] | what every frame of a motion shows | Cheema et al. 2019 |
//! | [`fault_map`] | faulty frames of magnetic trackers | Miller et al. 2006 |
//!
//! ```
//! use nalgebra::{Isometry3, UnitQuaternion, Vector3};
//! use posed_motion::keyframes::{Detector, Hinge, HingeSettings};
//!
//! // A body that stands still for a second, then goes along x with a jitter of a tenth of a millimetre.
//! let pose = |k: usize| {
//!     let jitter = 1e-4 * ((k * 7919 % 101) as f64 / 101.0 - 0.5);
//!     let x_m = jitter + 0.01 * k.saturating_sub(100) as f64;
//!     Isometry3::from_parts(Vector3::new(x_m, jitter, -jitter).into(), UnitQuaternion::identity())
//! };
//! let poses: Vec<_> = (0..200).map(pose).collect();
//! let settings = HingeSettings { orientation: false, ..HingeSettings::default() };
//! let (keys, _) = Detector::new(Hinge::new(settings)).run(&poses);
//! assert!(keys.iter().any(|key| key.frame.abs_diff(100) <= 2), "{keys:?}");
//! ```

pub mod exercise;
pub mod fault_map;
pub mod keyframes;
pub mod segments;
