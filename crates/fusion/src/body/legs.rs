//! What a body's filter shows the feet's: where the points of the feet are from the hips, and how they are accelerated.

use nalgebra::Vector3;

use super::moving::Moving;
use super::sensor::Sensor;
use super::skeleton::{BodySegment, Limb};
use super::travel::{Foot, Legs, Point};
use super::{BodyFilter, BodySamples, HOLD_S, LEGS_S, health};
use posed_geometry::GRAVITY_M_S2;

impl BodyFilter {
    /// What the feet say of one time; `None` unless the sensors on pelvis and both legs show it.
    pub(super) fn legs(&self, samples: &BodySamples) -> Option<Legs> {
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
        let sides = [(BodySegment::ShankR, BodySegment::FootR), (BodySegment::ShankL, BodySegment::FootL)];
        let acceleration_m_s2 = |moving: &Moving, from_sensor_m: Vector3<f64>| {
            moving.at(&from_sensor_m) - Vector3::z() * GRAVITY_M_S2
        };
        let feet = [0, 1].map(|side| {
            let (shank, foot) = sides[side];
            let at_m = ankles_m[side];
            if self.shows(foot).is_none() {
                let ankle_m = self.skeleton.end_in_segment_m(shank);
                return Foot::Ankle(Point {
                    at_m,
                    accel_m_s2: self
                        .moving(shank, samples)
                        .map(|(moving, sensor)| acceleration_m_s2(&moving, ankle_m - sensor.mount.offset_m)),
                    turns_rad_s: None,
                });
            }
            let moving = self.moving(foot, samples);
            Foot::Sole(
                self.travel.sole_m(side).map(|point_m| Point {
                    at_m: at_m + all[foot.index()] * point_m,
                    accel_m_s2: moving
                        .map(|(moving, sensor)| acceleration_m_s2(&moving, point_m - sensor.mount.offset_m)),
                    turns_rad_s: moving.map(|(moving, _)| moving.angular_velocity_rad_s),
                }),
            )
        });
        Some(Legs { sensor_m, specific_force_m_s2, rests, ankles_m, feet })
    }

    /// The sensor that shows this segment now.
    fn shows(&self, segment: BodySegment) -> Option<&Sensor> {
        let sensor = self.sensors[segment.index()].as_ref()?;
        let current = sensor.behind_s <= HOLD_S && sensor.settled_s >= LEGS_S;
        (current && self.estimate.orientations[segment.index()].is_some()).then_some(sensor)
    }

    /// How a segment moves by the sensor on it, if that measured at this time.
    fn moving(&self, segment: BodySegment, samples: &BodySamples) -> Option<(Moving, &Sensor)> {
        let sensor = self.sensors[segment.index()].as_ref()?;
        let sample = measured(samples, segment)?;
        let q_room_segment = self.estimate.posture[segment.index()];
        Some((sensor.moving(&sample, &sensor.mount.q_segment_sensor, q_room_segment), sensor))
    }
}

fn measured(samples: &BodySamples, segment: BodySegment) -> Option<super::ImuSample> {
    samples[segment.index()].filter(health::usable)
}
