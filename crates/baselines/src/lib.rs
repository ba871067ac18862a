//! Baselines: the methods of five papers as their authors describe them, to be compared with.
//!
//! What comes in and what goes out is what the live estimators take and give, so that a bench or a command can put one in the
//! place of the other. What they never do: run live. No crate of the live path depends on this one; only the program's
//! commands, the benches and the tests do.
//!
//! | module | paper | beside the live | run by |
//! |---|---|---|---|
//! | [`cascade`] | Piperakis, Saito, Nakajima (about 2005) | [`posed_field::solve`] | `posed field solve --method cascade` |
//! | [`change_points`] | Merckel, Nishida (2010) | [`posed_motion::keyframes::Hinge`] | `posed keyframes --method paper` |
//! | [`fault_map`] | Miller, McGlinchey, Chaperot (2006) | [`posed_motion::fault_map::FaultMap::train`] | `posed faults train --rule paper` |
//! | [`limbs`] | Weber, Bleser, Hendeby, Reiss, Stricker (2011) | [`posed_fusion::body::BodyFilter`] | `cargo bench --bench body` |
//! | [`segments`] | Cheema et al. (2019) | [`posed_motion::segments::Options`] | `posed segments train --paper` |
//! | [`singular_spectrum`] | Moskvina, Zhigljavsky (2003), beside Merckel and Nishida | the same | `posed keyframes study --method sst` |
//!
//! Each module states which equations it takes, and what had to be repaired or chosen because the paper errs or is silent. Of
//! the same paper as [`limbs`] is the counting of exercises, whose way posed goes live; `docs/exercise.md` states where it
//! differs.
//!
//! A sensor that moves along one axis and then along another, by the published statistic and by the live one:
//!
//! ```
//! use nalgebra::Isometry3;
//! use posed_baselines::change_points::{MeanDifference, MeanDifferenceSettings};
//! use posed_motion::keyframes::{Detector, Hinge, HingeSettings};
//!
//! // 200 poses, 1 cm a frame; it turns the corner at frame 100.
//! let poses: Vec<_> = (0..200)
//!     .map(|k| Isometry3::translation(0.01 * f64::from(k.min(100)), 0.01 * f64::from(k.max(100) - 100), 0.0))
//!     .collect();
//! let published = Detector::new(MeanDifference::new(MeanDifferenceSettings::default()));
//! let live = Detector::new(Hinge::new(HingeSettings::default()));
//! assert_eq!((published.delay_frames(), live.delay_frames()), (78, 60));
//! let (keys, _) = published.run(&poses);
//! assert_eq!(keys.iter().map(|key| key.frame).collect::<Vec<_>>(), [100]);
//! let (keys, _) = live.run(&poses);
//! assert!(keys[0].corner && keys[0].frame == 100);
//! ```

pub mod cascade;
pub mod change_points;
pub mod fault_map;
pub mod limbs;
pub mod segments;
pub mod singular_spectrum;
