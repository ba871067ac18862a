//! Where the sensors sit on their segments, found from poses and movements.
//!
//! In: recorded samples of one or two IMUs, from a time in which a known pose or movement was held. Out: the
//! rotation from sensor to segment, hinge axes, joint positions, each with its quality, or a refusal that states
//! what was missing. It never returns a mounting that the movement did not show.

mod hinge;
mod pose;
mod position;
#[cfg(test)]
mod tests;

use thiserror::Error;

pub use hinge::{HingeAxes, hinge_axes};
pub use pose::{Mounting, PoseObservation, mounting_from_poses};
pub use position::{JointPosition, Motion, joint_position};

/// Why a mounting could not be found; the sentence states what to do.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Refused {
    /// Too few samples to say anything.
    #[error("only {found} samples; hold the pose or movement for at least {needed}")]
    TooShort {
        /// Samples there were.
        found: usize,
        /// Samples it takes.
        needed: usize,
    },
    /// The movement did not show what was asked for.
    #[error(
        "the movement shows too little (excitation {found:.2e}, needed {needed:.2e}): bend the joint further \
         and faster, and turn the whole limb about other axes meanwhile"
    )]
    Excitation {
        /// Smallest curvature of the cost per sample, in the unit of the method that refused.
        found: f64,
        /// What it takes.
        needed: f64,
    },
    /// All poses share one direction of gravity and no heading is known.
    #[error("the poses do not differ by at least {needed_deg:.0} degrees: add one in which the segment lies")]
    SamePoses {
        /// Smallest useful difference, degrees.
        needed_deg: f64,
    },
    /// Two poses contradict each other.
    #[error("the poses disagree by {found_deg:.1} degrees (limit {limit_deg:.1}): repeat them")]
    Disagree {
        /// Residual, degrees.
        found_deg: f64,
        /// Largest accepted, degrees.
        limit_deg: f64,
    },
}
