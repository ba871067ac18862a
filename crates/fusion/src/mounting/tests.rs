//! Mountings recovered from simulated movements.

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use posed_geometry::{GRAVITY_M_S2, so3};

type V = Vector3<f64>;
type Q = UnitQuaternion<f64>;

/// A hinge between two segments that also turn and move as a whole; sensors mounted askew.
struct Hinge {
    /// Sensor to segment.
    mounts: [Q; 2],
    /// From the joint to the sensors, segment axes.
    levers: [V; 2],
}

impl Hinge {
    const GRAVITY: V = V::new(0.0, 0.0, -GRAVITY_M_S2);

    fn new() -> Self {
        Self {
            mounts: [so3::exp(&V::new(0.4, -0.9, 0.3)), so3::exp(&V::new(-1.2, 0.5, 2.0))],
            levers: [V::new(0.03, 0.2, 0.0), V::new(0.05, -0.15, 0.0)],
        }
    }

    fn pose(&self, which: usize, t: f64, moving: f64) -> (Q, V) {
        let whole = so3::exp(
            &(V::new(libm::sin(0.9 * t), 0.8 * libm::cos(0.7 * t), 0.9 * libm::sin(1.1 * t)) * moving),
        );
        let joint =
            V::new(0.3 * libm::sin(1.7 * t), 0.2 * libm::cos(1.3 * t), 0.2 * libm::sin(2.1 * t)) * moving;
        let bend = so3::exp(&(V::z() * (0.8 + 0.7 * libm::sin(2.3 * t)) * moving));
        let q = if which == 0 { whole } else { whole * bend };
        (q, joint + q * self.levers[which])
    }

    /// Angular velocity, angular acceleration, specific force in sensor axes.
    fn motion(&self, which: usize, t: f64, moving: f64) -> (V, V, V) {
        let h = 1e-3;
        let back = self.mounts[which].inverse();
        let angular_velocity_rad_s = |t: f64| {
            let q = self.pose(which, t, moving).0;
            so3::log(&(q.inverse() * self.pose(which, t + h, moving).0)) / (2.0 * h)
                - so3::log(&(q.inverse() * self.pose(which, t - h, moving).0)) / (2.0 * h)
        };
        let (q, p) = self.pose(which, t, moving);
        let accel =
            (self.pose(which, t + h, moving).1 + self.pose(which, t - h, moving).1 - p * 2.0) / (h * h);
        (
            back * angular_velocity_rad_s(t),
            back * (angular_velocity_rad_s(t + h) - angular_velocity_rad_s(t - h)) / (2.0 * h),
            back * (q.inverse() * (accel - Self::GRAVITY)),
        )
    }

    fn motions(&self, moving: f64) -> Vec<[(V, V, V); 2]> {
        (0..1000).map(|k| [0, 1].map(|which| self.motion(which, 0.02 * f64::from(k), moving))).collect()
    }

    fn pairs(&self, moving: f64) -> Vec<([V; 2], [V; 2])> {
        self.motions(moving).iter().map(|[a, b]| ([a.0, b.0], [a.2, b.2])).collect()
    }
}

#[test]
fn a_hinges_axis_is_found_in_both_sensors_with_one_sign() {
    let hinge = Hinge::new();
    let found = hinge_axes(&hinge.pairs(1.0)).unwrap();
    let truth = [0, 1].map(|i| hinge.mounts[i].inverse() * V::z());
    let sign = found.first.dot(&truth[0]).signum();
    for (axis, truth) in [(found.first, truth[0]), (found.second, truth[1])] {
        let off = (axis * sign).angle(&truth).to_degrees();
        assert!(off < 1.0, "{off} degrees off");
    }
}

#[test]
fn an_axis_that_nothing_shows_is_refused() {
    let hinge = Hinge::new();
    assert!(matches!(hinge_axes(&hinge.pairs(0.0)), Err(Refused::Excitation { .. })));
    assert!(matches!(hinge_axes(&hinge.pairs(1.0)[..10]), Err(Refused::TooShort { .. })));
}

#[test]
fn a_joints_centre_is_found() {
    let hinge = Hinge::new();
    let found = joint_position(&hinge.motions(1.0)).unwrap();
    for (i, found) in [found.first_m, found.second_m].into_iter().enumerate() {
        // Along the axis the hinge shows nothing.
        let mut off = hinge.mounts[i] * found - hinge.levers[i];
        off.z = 0.0;
        assert!(off.norm() < 0.01, "sensor {i} {off:?}");
    }
    assert!(matches!(joint_position(&hinge.motions(0.0)), Err(Refused::Excitation { .. })));
}

fn observation(q_room_segment: Q, mount: Q, heading: bool) -> PoseObservation {
    let turned = if heading { Q::identity() } else { so3::exp(&(V::z() * 1.3)) };
    PoseObservation { q_room_segment, q_room_sensor: turned * q_room_segment * mount, heading }
}

#[test]
fn poses_give_the_mounting() {
    let mount = so3::exp(&V::new(0.7, -1.1, 0.4));
    let standing = so3::exp(&(V::x() * std::f64::consts::FRAC_PI_2));
    let raised = standing * so3::exp(&V::new(1.4, 0.1, 0.0));
    let one = mounting_from_poses(&[observation(standing, mount, true)]).unwrap();
    assert!(one.q_segment_sensor.angle_to(&mount) < 1e-9);
    let two = [observation(standing, mount, false), observation(raised, mount, false)];
    let found = mounting_from_poses(&two).unwrap();
    assert!(found.q_segment_sensor.angle_to(&mount) < 1e-6, "{found:?}");
}

#[test]
fn poses_that_say_too_little_or_contradict_each_other_are_refused() {
    let mount = so3::exp(&V::new(0.7, -1.1, 0.4));
    let standing = so3::exp(&(V::x() * std::f64::consts::FRAC_PI_2));
    let alone = [observation(standing, mount, false)];
    assert!(matches!(mounting_from_poses(&alone), Err(Refused::SamePoses { .. })));
    let other = mount * so3::exp(&V::new(0.3, 0.0, 0.0));
    let poses = [observation(standing, mount, true), observation(standing, other, true)];
    assert!(matches!(mounting_from_poses(&poses), Err(Refused::Disagree { .. })));
}
