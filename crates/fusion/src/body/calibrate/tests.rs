//! Which way an axis points whose movement does not begin in the pose, or goes both ways.

use nalgebra::{UnitQuaternion, Vector3};

use super::super::block::Movement;
use super::*;
use crate::ahrs::ImuSample;
use posed_geometry::{GRAVITY_M_S2, so3};

type Q = UnitQuaternion<f64>;

/// Torso and head of somebody who stands for three seconds, bows between 4 and 8 s, and nods between 10 and 16 s, forward and back alike.
fn recorded() -> (Vec<Recorded>, [Q; 2]) {
    let mounts = [Vector3::new(0.4, -0.9, 0.3), Vector3::new(-1.2, 0.5, 2.0)].map(|v| so3::exp(&v));
    let facing = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7);
    let pitched = |rad: f64| facing * upright() * so3::exp(&(Vector3::z() * -rad));
    let bow = |t: f64| {
        if (4.0..8.0).contains(&t) { 0.6 * libm::sin(0.5 * std::f64::consts::PI * t).powi(2) } else { 0.0 }
    };
    let nod =
        |t: f64| if (10.0..16.0).contains(&t) { 0.5 * libm::sin(std::f64::consts::PI * t) } else { 0.0 };
    let at = |t: f64| [pitched(bow(t)), pitched(bow(t) + nod(t))];
    let field_ut = Vector3::new(0.0, 20.0, -40.0);
    let recording = (0..1800).map(|k| {
        let t = 0.01 * f64::from(k);
        let (now, later, before) = (at(t), at(t + 1e-4), at(t - 1e-4));
        let mut samples = [None; SEGMENTS];
        for (which, segment) in [BodySegment::Torso, BodySegment::Head].into_iter().enumerate() {
            let back = (now[which] * mounts[which]).inverse();
            samples[segment.index()] = Some(ImuSample {
                gyro_rad_s: mounts[which].inverse() * so3::log(&(before[which].inverse() * later[which]))
                    / 2e-4,
                accel_m_s2: back * Vector3::z() * GRAVITY_M_S2,
                mag: Some(back * field_ut),
            });
        }
        (t, samples)
    });
    (recording.collect(), mounts)
}

#[test]
fn an_axis_points_as_the_pose_shows_wherever_its_movement_begins_and_if_it_goes_both_ways() {
    let (recording, truth) = recorded();
    let nod = BlockKind::Move(BodySegment::Head, Movement::Flexion);
    // The second bow begins bent; a nod that is cut anywhere goes one way as much as the other.
    for (bow_s, nod_s) in
        [([4.0, 8.0], [10.0, 16.0]), ([5.0, 7.9], [10.0, 15.99]), ([4.9, 7.0], [10.5, 14.5])]
    {
        let blocks = [(BlockKind::NPose, [0.5, 3.0]), (BlockKind::Bow, bow_s), (nod, nod_s)];
        let blocks = blocks.map(|(kind, [start_s, end_s])| Block { kind, start_s, end_s });
        let found = calibrate(&recording, &blocks, &Skeleton::from_height(1.8), &[None; SEGMENTS]).unwrap();
        for (segment, truth) in [BodySegment::Torso, BodySegment::Head].into_iter().zip(&truth) {
            let off = found.mounts[segment.index()].unwrap().q_segment_sensor.angle_to(truth).to_degrees();
            assert!(off < 2.0, "{segment:?} {bow_s:?}: {off}");
        }
    }
}
