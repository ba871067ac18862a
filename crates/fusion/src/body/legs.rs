//! What a body's filter shows the feet's: where the points of the feet are from the hips, and how they are accelerated.

use nalgebra::Vector3;

use super::moving::Moving;
use super::sensor::Sensor;
use super::skeleton::{BodySegment, Limb};
use super::travel::{Foot, Legs, Point, ShankSeen};
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
        let shanks = sides.map(|(shank, _)| {
            let (moving, sensor) = self.moving(shank, samples)?;
            let (ankle_m, length_m) = (self.skeleton.end_in_segment_m(shank), self.skeleton.shank_m);
            let ankle_m_s2 = acceleration_m_s2(&moving, ankle_m - sensor.mount.offset_m);
            let by_length = moving.q_room_segment * (moving.lever() * ankle_m) / length_m;
            Some((ShankSeen { ankle_m_s2, length_m, by_length }, sensor.is_learnt()))
        });
        let feet = [0, 1].map(|side| {
            let (_, foot) = sides[side];
            let at_m = ankles_m[side];
            if self.shows(foot).is_none() {
                return Foot::Ankle(Point {
                    at_m,
                    accel_m_s2: shanks[side].map(|(seen, _)| seen.ankle_m_s2),
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
        let shanks = shanks.map(|seen| seen.filter(|(_, learns)| *learns).map(|(seen, _)| seen));
        Some(Legs { sensor_m, specific_force_m_s2, rests, ankles_m, feet, shanks })
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
