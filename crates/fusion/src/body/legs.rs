//! What a body's filter shows the feet's: where the points of the feet are from the hips, and how they are accelerated.

use nalgebra::{UnitQuaternion, Vector3};

use super::skeleton::{BodySegment, Limb, SEGMENTS};
use super::travel::{Foot, Legs, Point, ShankSeen, carried};
use super::{BodyFilter, BodySamples, HOLD_S, LEGS_S, LimbFilter, Sensor, health};

impl BodyFilter {
    /// What the feet say of one time; `None` unless the sensors on pelvis and both legs show it.
    pub(super) fn legs(&mut self, samples: &BodySamples) -> Option<Legs> {
        let pelvis = self.shows(BodySegment::Pelvis)?;
        let all = self.estimate.posture;
        let q_room_pelvis = all[BodySegment::Pelvis.index()];
        let specific_force_m_s2 = measured(samples, BodySegment::Pelvis)
            .map(|sample| q_room_pelvis * (pelvis.mount.q_segment_sensor * sample.accel_m_s2));
        let sensor_m = q_room_pelvis * pelvis.mount.offset_m;
        let rests = pelvis.ahrs.at_rest();
        let ankles_m = self.skeleton.ankles_m(&all, Vector3::zeros());
        for segment in [Limb::LegR, Limb::LegL].into_iter().flat_map(|limb| limb.segments()) {
            self.shows(segment)?;
        }
        let mut shanks = [None; 2];
        let sides = [(BodySegment::ShankR, BodySegment::FootR), (BodySegment::ShankL, BodySegment::FootL)];
        let mut foot = |side: usize| {
            let (shank, foot) = sides[side];
            let at_m = ankles_m[side];
            let ankle_m = self.skeleton.end_in_segment_m(shank);
            let turned = self.turned(shank, samples);
            let [accel_m_s2] = self.accelerations(shank, [ankle_m], turned, samples, &all);
            // What a length makes of the acceleration is what it is of a point so far away, less what it is of the sensor itself.
            let learns = self.sensors[shank.index()].as_ref().is_some_and(Sensor::is_learnt);
            let [longer_m_s2] = self.accelerations(shank, [ankle_m * 2.0], turned, samples, &all);
            let length_m = self.skeleton.shank_m;
            shanks[side] = accel_m_s2.zip(longer_m_s2).filter(|_| learns).map(|(ankle_m_s2, longer_m_s2)| {
                ShankSeen { ankle_m_s2, length_m, by_length: (longer_m_s2 - ankle_m_s2) / length_m }
            });
            if self.shows(foot).is_none() {
                self.turns_rad_s[foot.index()] = None;
                return Foot::Ankle(Point { at_m, accel_m_s2 });
            }
            let sole_m = self.travel.sole_m(side);
            let turned = self.turned(foot, samples);
            let accels_m_s2 = self.accelerations(foot, sole_m, turned, samples, &all);
            Foot::Sole([0, 1].map(|which| Point {
                at_m: at_m + all[foot.index()] * sole_m[which],
                accel_m_s2: accels_m_s2[which],
            }))
        };
        let feet = [foot(0), foot(1)];
        Some(Legs { sensor_m, specific_force_m_s2, rests, ankles_m, feet, shanks })
    }

    /// Limbs and feet that stand have shown how long segments are: both sides are alike.
    pub(super) fn resize(&mut self) {
        let mean = |lengths_m: [Option<f64>; 2], before_m: f64| match lengths_m {
            [Some(right_m), Some(left_m)] => 0.5 * (right_m + left_m),
            [one, other] => one.or(other).unwrap_or(before_m),
        };
        let upper_m = |limbs: [Limb; 2]| {
            limbs.map(|limb| {
                LimbFilter::upper_length_m(&self.limbs[limb as usize]).map(|[length_m, _]| length_m)
            })
        };
        let shanks_m = self.travel.shanks_m();
        let learnt =
            |segment: BodySegment| self.sensors[segment.index()].as_ref().is_some_and(Sensor::is_learnt);
        let shanks_m = [(BodySegment::ShankR, shanks_m[0]), (BodySegment::ShankL, shanks_m[1])]
            .map(|(shank, [length_m, _])| learnt(shank).then_some(length_m));
        let thigh_m = mean(upper_m([Limb::LegR, Limb::LegL]), self.skeleton.thigh_m);
        let upper_arm_m = mean(upper_m([Limb::ArmR, Limb::ArmL]), self.skeleton.upper_arm_m);
        let shank_m = mean(shanks_m, self.skeleton.shank_m);
        (self.skeleton.thigh_m, self.skeleton.upper_arm_m, self.skeleton.shank_m) =
            (thigh_m, upper_arm_m, shank_m);
    }

    /// The sensor that shows this segment now.
    fn shows(&self, segment: BodySegment) -> Option<&Sensor> {
        let sensor = self.sensors[segment.index()].as_ref()?;
        let current = sensor.behind_s <= HOLD_S && sensor.settled_s >= LEGS_S;
        (current && self.estimate.orientations[segment.index()].is_some()).then_some(sensor)
    }

    /// Angular velocities of the sensor on this segment at this time and a sample ago, rad/s, sensor axes; `None` unless there are both.
    fn turned(&mut self, segment: BodySegment, samples: &BodySamples) -> Option<[Vector3<f64>; 2]> {
        let sensor = self.sensors[segment.index()].as_ref()?;
        let now = measured(samples, segment).map(|sample| sample.gyro_rad_s - sensor.ahrs.bias_rad_s());
        let before = std::mem::replace(&mut self.turns_rad_s[segment.index()], now);
        Some([now?, before?])
    }

    /// Accelerations of points of a segment, given in its axes, m: room, m/s².
    fn accelerations<const N: usize>(
        &self,
        segment: BodySegment,
        points_m: [Vector3<f64>; N],
        turned: Option<[Vector3<f64>; 2]>,
        samples: &BodySamples,
        all: &[UnitQuaternion<f64>; SEGMENTS],
    ) -> [Option<Vector3<f64>>; N] {
        let (Some([now, before]), Some(sensor), Some(sample)) =
            (turned, &self.sensors[segment.index()], measured(samples, segment))
        else {
            return [None; N];
        };
        let mount = &sensor.mount;
        let q_room_sensor = all[segment.index()] * mount.q_segment_sensor;
        points_m.map(|point_m| {
            let from_sensor_m = mount.q_segment_sensor.inverse() * (point_m - mount.offset_m);
            Some(carried(&q_room_sensor, &sample.accel_m_s2, [&now, &before], sensor.step_s, &from_sensor_m))
        })
    }
}

fn measured(samples: &BodySamples, segment: BodySegment) -> Option<super::ImuSample> {
    samples[segment.index()].filter(health::usable)
}
