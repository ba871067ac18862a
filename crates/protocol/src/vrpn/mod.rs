//! What programs that speak VRPN receive: every sensor is a tracker of its own name.
//!
//! What comes in: frames and outcomes, and what a client says. What goes out: bytes, the same for all clients. What it never
//! does: tell a pose that is not good (the protocol cannot say so), open a file because a client asks, own a socket.
//!
//! A tracker has sensor 0. Positions are in the room, m; a sensor that measures none is at the origin. Velocities and
//! accelerations are linear in room axes, and rotations in room axes made within [`ROTATION_S`]. The filter has no
//! acceleration: it is the difference of the velocities of two frames.

mod peer;

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use posed_drivers::Timestamp;

use posed_drivers::vrpn::wire::{self, From, system, types};
use posed_fusion::faults::Cause;
use posed_stage::output::{Estimate, Outcome, OutcomeKind, PoseEstimate, SensorEstimate};

pub use self::peer::Peer;

/// Time in which the rotation of an angular velocity is made, s.
pub const ROTATION_S: f64 = 0.01;
/// Frames further apart tell no acceleration, s.
const MAX_STEP_S: f64 = 0.1;

/// The types that are described to clients; their numbers are their places.
const TYPES: [&str; 7] =
    [types::POSE, types::VELOCITY, types::ACCELERATION, types::BUTTON, types::TEXT, types::PING, types::PONG];
const POSE: i32 = 0;
const VELOCITY: i32 = 1;
const ACCELERATION: i32 = 2;
const BUTTON: i32 = 3;
const TEXT: i32 = 4;
const PONG: i32 = 6;

/// What there is on a stage; it never changes.
#[derive(Debug)]
pub struct Catalogue {
    epoch_utc_ns: i64,
    /// By number.
    names: Vec<String>,
}

/// Turns frames into messages.
#[derive(Debug)]
pub struct Publisher {
    catalogue: Arc<Catalogue>,
    trackers: Vec<Tracker>,
}

/// What was reported of one sensor.
#[derive(Clone, Debug, Default)]
struct Tracker {
    /// Time, velocity and angular velocity (room axes) of the frame before.
    before: Option<(Timestamp, Vector3<f64>, Vector3<f64>)>,
    pressed: bool,
}

impl Catalogue {
    /// Of sensors of these names, in the stage file's order, on a stage whose epoch is `epoch_utc_ns`, ns since 1970. Names are
    /// cut to [`wire::MAX_NAME`] bytes.
    pub fn new<'a>(names: impl IntoIterator<Item = &'a str>, epoch_utc_ns: i64) -> Self {
        let cut = |name: &str| name[..name.floor_char_boundary(wire::MAX_NAME)].to_owned();
        Self { epoch_utc_ns, names: names.into_iter().map(cut).collect() }
    }

    /// The bytes that every connection begins with, after the greetings: who speaks, and of what.
    pub fn descriptions(&self) -> Vec<u8> {
        let mut out = Vec::new();
        for (number, name) in (0..).zip(&self.names) {
            wire::description(system::SENDER, number, name, self.epoch_utc_ns, &mut out);
        }
        for (number, name) in (0..).zip(TYPES) {
            wire::description(system::TYPE, number, name, self.epoch_utc_ns, &mut out);
        }
        out
    }

    /// Number of the tracker of this name.
    fn number(&self, name: &str) -> Option<i32> {
        self.names.iter().position(|known| known == name).map(|at| at as i32)
    }

    fn utc_ns(&self, t: Timestamp) -> i64 {
        self.epoch_utc_ns.saturating_add(t.as_nanos())
    }
}

impl Publisher {
    /// For what there is on a stage.
    pub fn new(catalogue: Catalogue) -> Self {
        let trackers = vec![Tracker::default(); catalogue.names.len()];
        Self { catalogue: Arc::new(catalogue), trackers }
    }

    /// What there is on the stage.
    pub fn catalogue(&self) -> Arc<Catalogue> {
        Arc::clone(&self.catalogue)
    }

    /// Appends the messages of a frame: of each sensor its button, where it changed, and, where its pose may be used as good,
    /// pose, velocity and acceleration. Frames and units: see the module; no acceleration after a gap.
    pub fn frame(&mut self, estimate: &Estimate, out: &mut Vec<u8>) {
        let (t, utc_ns) = (estimate.t_valid, self.catalogue.utc_ns(estimate.t_valid));
        for (sender, (tracker, sensor)) in (0..).zip(self.trackers.iter_mut().zip(&estimate.sensors)) {
            let from = |kind| From { sender, kind, utc_ns };
            tracker.button(sensor, from(BUTTON), out);
            match sensor.usable_pose() {
                Some(pose) => tracker.pose(t, pose, from, out),
                None => tracker.before = None,
            }
        }
    }

    /// Appends the sentence of an outcome; only a fault has one, a warning while it lasts.
    pub fn outcome(&self, outcome: &Outcome, out: &mut Vec<u8>) {
        let OutcomeKind::Fault { sensor, cause, active } = outcome.what else { return };
        let Some(name) = self.catalogue.names.get(usize::from(sensor)) else { return };
        let sent = matches!(
            cause,
            Cause::HemisphereInversion | Cause::VerticalInversion | Cause::Stuck | Cause::Missing
        );
        let what = format!("{}{}", cause.words(), if sent { "" } else { ", and is not sent" });
        let sentence = if active { what } else { format!("over: {what}") };
        let from =
            From { sender: i32::from(sensor), kind: TEXT, utc_ns: self.catalogue.utc_ns(outcome.t_valid) };
        wire::text(from, &format!("{name}: {sentence}"), active, out);
    }
}

impl Tracker {
    fn pose(&mut self, t: Timestamp, pose: &PoseEstimate, from: impl Fn(i32) -> From, out: &mut Vec<u8>) {
        wire::pose(from(POSE), 0, pose.position_m.unwrap_or_default(), pose.orientation_wxyz, out);
        let Some(orientation) = posed_geometry::orientation_from_wxyz(pose.orientation_wxyz) else { return };
        let velocity = Vector3::from(pose.velocity_m_s.unwrap_or_default());
        let angular_velocity = orientation * Vector3::from(pose.angular_velocity_rad_s);
        wire::motion(from(VELOCITY), velocity.into(), rotation_wxyz(angular_velocity), ROTATION_S, out);
        if let Some((before, earlier_velocity, earlier_angular_velocity)) =
            self.before.replace((t, velocity, angular_velocity))
        {
            let step_s = t.seconds_since(before);
            if 0.0 < step_s && step_s < MAX_STEP_S {
                let linear = (velocity - earlier_velocity) / step_s;
                let angular = rotation_wxyz((angular_velocity - earlier_angular_velocity) / step_s);
                wire::motion(from(ACCELERATION), linear.into(), angular, ROTATION_S, out);
            }
        }
    }

    fn button(&mut self, sensor: &SensorEstimate, from: From, out: &mut Vec<u8>) {
        let Some(button) = sensor.measured.and_then(|measured| measured.button) else { return };
        let pressed = button != 0;
        if pressed != self.pressed {
            self.pressed = pressed;
            wire::button(from, 0, pressed, out);
        }
    }
}

/// What the fuzz target does with any bytes: answers have whole messages.
#[doc(hidden)]
pub fn fuzz_client(data: &[u8]) {
    let catalogue = Catalogue::new(["left", "right"], 0);
    let (mut messages, mut peer, mut answer) = (wire::Messages::default(), Peer::default(), Vec::new());
    for piece in data.chunks(100) {
        messages.push(piece);
        while let Ok(Some(message)) = messages.find() {
            if peer.take(message, &catalogue, &mut answer).is_err() {
                return;
            }
        }
    }
    assert_eq!(answer.len() % wire::HEADER, 0);
}

fn rotation_wxyz(angular_velocity_rad_s: Vector3<f64>) -> [f64; 4] {
    posed_geometry::orientation_to_wxyz(&UnitQuaternion::from_scaled_axis(
        angular_velocity_rad_s * ROTATION_S,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_stage::output::{Measured, SensorState};

    fn doubles(payload: &[u8]) -> Vec<f64> {
        payload[8..].as_chunks().0.iter().map(|bytes| f64::from_be_bytes(*bytes)).collect()
    }

    fn estimate(t_s: f64, speed_m_s: f64, state: SensorState, button: u8) -> Estimate {
        let half = 0.5_f64.sqrt();
        let pose = PoseEstimate {
            position_m: Some([1.0, 2.0, 3.0]),
            // A quarter about y: the sensor's x axis is down.
            orientation_wxyz: [half, 0.0, half, 0.0],
            velocity_m_s: Some([speed_m_s, 0.0, 0.0]),
            angular_velocity_rad_s: [2.0, 0.0, 0.0],
            covariance: [0.0; 21],
            sigma_m: Some(0.001),
        };
        let measured = Measured {
            t_valid: Timestamp::ZERO,
            position_m: None,
            clipped: false,
            orientation_wxyz: None,
            button: Some(button),
            inertial: None,
        };
        let sensor = SensorEstimate {
            state,
            pose: Some(pose),
            measured: Some(measured),
            fault: None,
            ..SensorEstimate::default()
        };
        Estimate { t_valid: Timestamp::from_secs_f64(t_s), sensors: vec![sensor], ..Estimate::default() }
    }

    #[test]
    fn a_frame_is_a_pose_a_velocity_and_what_has_changed() {
        let mut publisher = Publisher::new(Catalogue::new(["hand"], 1_000_000_000));
        let mut emitted = Vec::new();
        let mut report = |publisher: &mut Publisher, estimate: &Estimate| {
            let mut bytes = Vec::new();
            publisher.frame(estimate, &mut bytes);
            assert!(
                bytes.is_empty() || bytes[4..8] == [0, 0, 0, 2],
                "captured in the second after the epoch"
            );
            let mut messages = wire::Messages::default();
            messages.push(&bytes);
            emitted.clear();
            while let Some(message) = messages.find().unwrap() {
                emitted.push((message.kind, message.payload.to_vec()));
            }
            emitted.clone()
        };
        let first = report(&mut publisher, &estimate(1.0, 0.5, SensorState::Ok, 0));
        assert_eq!(first.iter().map(|(kind, _)| *kind).collect::<Vec<_>>(), [POSE, VELOCITY]);
        let half = 0.5_f64.sqrt();
        assert_eq!(doubles(&first[0].1), [1.0, 2.0, 3.0, 0.0, half, 0.0, half]);
        let velocity = doubles(&first[1].1);
        assert_eq!((velocity[0], velocity[7]), (0.5, ROTATION_S));
        // 2 rad/s about the sensor's x axis are -2 rad/s about the room's z axis.
        assert!((velocity[5] + libm::sin(0.01_f64)).abs() < 1e-12, "{velocity:?}");
        let second = report(&mut publisher, &estimate(1.01, 0.6, SensorState::Repaired, 1));
        assert_eq!(
            second.iter().map(|(kind, _)| *kind).collect::<Vec<_>>(),
            [BUTTON, POSE, VELOCITY, ACCELERATION]
        );
        assert!((doubles(&second[3].1)[0] - 10.0).abs() < 1e-6);
        assert_eq!(report(&mut publisher, &estimate(1.02, 0.6, SensorState::Suspect, 1)), []);
        let back = report(&mut publisher, &estimate(1.03, 0.6, SensorState::Ok, 1));
        assert_eq!(back.len(), 2, "no acceleration over a gap");
    }

    #[test]
    fn faults_are_sentences() {
        let publisher = Publisher::new(Catalogue::new(["hand"], 0));
        let what = OutcomeKind::Fault { sensor: 0, cause: Cause::Missing, active: true };
        let outcome = Outcome { t_valid: Timestamp::ZERO, t_decided: Timestamp::ZERO, what };
        let mut bytes = Vec::new();
        publisher.outcome(&outcome, &mut bytes);
        assert_eq!(bytes.len(), 1056);
        assert!(bytes[32..].starts_with(b"hand: nothing arrives\0"));
    }
}
