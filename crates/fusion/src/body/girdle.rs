//! An arm that hangs on a shoulder with a sensor: what that shows of the arm's joint.
//!
//! In: the motion of the torso, and the shoulder's sample. Out: the motion that the arm's filter is to begin from. The arm stays turned against the torso: a
//! shoulder says how its joint is accelerated, which a shrug moves and the torso does not know.

use super::skeleton::{BodySegment, Limb};
use super::{BodyFilter, BodySamples, health};
use crate::limb::Base;
use posed_geometry::so3::lever;

/// How well a sensor on a shoulder shows the specific force at the arm's joint, m/s²: as well as the torso's own.
const FORCE_M_S2: f64 = 0.2;

impl BodyFilter {
    /// What a limb's filter is to take for the motion of its trunk: the trunk's, with a specific force that makes up what a shoulder's sensor feels at the arm's joint.
    pub(super) fn hung(&self, limb: Limb, trunk: &Base, samples: &BodySamples) -> Base {
        self.at_joint(limb, trunk, samples).unwrap_or(*trunk)
    }

    fn at_joint(&self, limb: Limb, trunk: &Base, samples: &BodySamples) -> Option<Base> {
        let [_, upper, _] = limb.segments();
        let shoulder: BodySegment = upper.shoulder()?;
        let sensor = self.sensors[shoulder.index()].as_ref()?;
        let sample = samples[shoulder.index()].filter(health::usable)?;
        if !sensor.is_settled() {
            return None;
        }
        let mount = &sensor.mount;
        let moving = sensor.moving(&sample, &mount.q_segment_sensor, sensor.orientation()?);
        let felt_m_s2 = moving.at(&(self.skeleton.end_in_segment_m(shoulder) - mount.offset_m));
        let to_joint_m = self.limbs[limb as usize].base_to_joint_m();
        let carried = lever(&trunk.angular_velocity_rad_s, &trunk.accel_rad_s2) * to_joint_m;
        Some(Base {
            specific_force_m_s2: trunk.q_room_base.inverse() * felt_m_s2 - carried,
            specific_force_sigma_m_s2: FORCE_M_S2,
            ..*trunk
        })
    }
}
