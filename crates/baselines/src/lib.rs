//! Baselines: the methods of five papers as their authors describe them, to be compared with.
//!
//! What comes in and what goes out is what the live estimators take and give, so that a bench or a command can put one in the
//! place of the other. What they never do: run live. No crate of the live path depends on this one; only the program's
//! commands, the benches and the tests do.
//!
//! | module | paper | beside the live | run by |
//! |---|---|---|---|
//! | [`cascade`] | Piperakis, Saito, Nakajima (about 2005) | [`posed_field::solve`] | `posed field solve --method cascade` |
//! | [`fault_map`] | Miller, McGlinchey, Chaperot (2006) | [`posed_motion::fault_map::FaultMap::train`] | `posed faults train --rule paper` |
//! | [`limbs`] | Weber, Bleser, Hendeby, Reiss, Stricker (2011) | [`posed_fusion::body::BodyFilter`] | `cargo bench --bench body` |
//! | [`segments`] | Cheema et al. (2019) | [`posed_motion::segments::Options`] | `posed segments train --paper` |
//! | [`singular_spectrum`] | Moskvina, Zhigljavsky (2003), beside Merckel and Nishida | [`posed_motion::keyframes::Hinge`] | `posed keyframes study --method sst` |
//!
//! Each module states which equations it takes, and what had to be repaired or chosen because the paper errs or is silent. Two published
//! methods are not here, for posed goes their way live: the change points of Merckel and Nishida
//! ([`posed_motion::keyframes::MeanDifference`]), and the counting of exercises of the same paper as [`limbs`] (`docs/exercise.md`).

pub mod cascade;
pub mod fault_map;
pub mod limbs;
pub mod segments;
pub mod singular_spectrum;
