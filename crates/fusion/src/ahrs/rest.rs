//! Is the sensor lying still?
//!
//! In: gyro, accelerometer and magnetometer samples. Out: a flag, and the low-passed gyro, which at rest is the bias. A gyro
//! that reads more than its known bias can be that lies still all the same where gravity and field keep their
//! places: what turns takes them along.

use nalgebra::Vector3;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

/// When a sensor counts as lying still. Of the defaults the first four and the bias clip are those of Laidig & Seel (2023).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct RestParams {
    /// Time constant of the low-pass, s.
    pub tau_s: f64,
    /// Largest departure of the gyro from its low-pass, rad/s, length of the vector.
    pub gyro_rad_s: f64,
    /// Largest departure of the accelerometer from its low-pass, m/s², length of the vector.
    pub accel_m_s2: f64,
    /// How long both must hold, s.
    pub min_s: f64,
    /// After so long nothing but a bias keeps a gyro from zero, s; before, an angular velocity that the bias cannot explain is
    /// slow turning.
    pub certain_s: f64,
    /// Largest bias about an axis of a unit whose bias is known; a constant angular velocity above it is no rest, rad/s.
    pub bias_clip_rad_s: f64,
    /// Largest bias about an axis of a unit as it comes from the factory, rad/s.
    pub factory_bias_rad_s: f64,
    /// How long gravity and field must keep their places to prove that a constant angular velocity is a bias, s.
    pub proof_s: f64,
}

impl Default for RestParams {
    fn default() -> Self {
        Self {
            tau_s: 0.5,
            gyro_rad_s: 2.0_f64.to_radians(),
            accel_m_s2: 0.5,
            min_s: 1.5,
            certain_s: 30.0,
            bias_clip_rad_s: 2.0_f64.to_radians(),
            factory_bias_rad_s: 10.0_f64.to_radians(),
            proof_s: 2.0,
        }
    }
}

/// Turn that a direction must show by to say anything, rad, and which part of it may be noise.
const TELLING_RAD: f64 = 0.02;
const NOISE_SHARE: f64 = 0.3;
/// Change of the low-passed gyro that may be its noise, rad/s, some 0.3 degrees a second.
const STEADY_RAD_S: f64 = 5e-3;

/// The gyro's mean over so long, s, counts when the rest has lasted for as long as this many of them after it: a movement that begins slowly is
/// not seen at once, and would be taken for a bias.
const BLOCK_S: f64 = 0.5;
const BLOCKS: usize = 2;

/// State of the detector.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub(super) struct Rest {
    gyro: LowPass,
    accel: LowPass,
    mag: LowPass,
    /// Since the low-passes have settled.
    reference: Option<RestReference>,
    still_s: f64,
    /// The same with an angular velocity that only a factory's bias could explain.
    steady_s: f64,
    at_rest: bool,
    /// Integral of the gyro over the running block, rad, and its length, s; means of those before it, the oldest first.
    block: (Vector3<f64>, f64),
    blocks_rad_s: [Option<Vector3<f64>>; BLOCKS],
    shown_rad_s: Option<Vector3<f64>>,
}

/// What there was when the low-passes had settled.
#[derive(Clone, Debug, PartialEq, Plain)]
struct RestReference {
    /// The low-passed gyro, and gravity and field then.
    gyro_rad_s: Vector3<f64>,
    directions: [Vector3<f64>; 2],
    /// How long ago, s.
    ago_s: f64,
    /// Integral of the gyro since, rad.
    turned_rad: Vector3<f64>,
}

impl Rest {
    pub(super) fn push(
        &mut self,
        params: &RestParams,
        gyro: Vector3<f64>,
        accel: Vector3<f64>,
        mag: Option<Vector3<f64>>,
        dt_s: f64,
    ) {
        let angular_velocity_rad_s = self.gyro.push(gyro, dt_s, params.tau_s);
        let specific_force_m_s2 = self.accel.push(accel, dt_s, params.tau_s);
        let field = mag.map_or(self.mag.stage[1], |mag| self.mag.push(mag, dt_s, params.tau_s));
        let moving = (gyro - angular_velocity_rad_s).norm_squared() > params.gyro_rad_s.powi(2)
            || (accel - specific_force_m_s2).norm_squared() > params.accel_m_s2.powi(2);
        let steady = !moving && angular_velocity_rad_s.amax() <= params.factory_bias_rad_s;
        self.steady_s = if steady { self.steady_s + dt_s } else { 0.0 };
        let still = !moving && angular_velocity_rad_s.amax() <= params.bias_clip_rad_s;
        self.still_s = if still { self.still_s + dt_s } else { 0.0 };
        self.at_rest = self.still_s >= params.min_s;
        self.collect(params, gyro, dt_s);
        self.reference = match self.reference.take() {
            _ if self.steady_s < params.tau_s => None,
            None => Some(RestReference {
                gyro_rad_s: angular_velocity_rad_s,
                directions: [specific_force_m_s2, field],
                ago_s: 0.0,
                turned_rad: Vector3::zeros(),
            }),
            Some(reference) => Some(RestReference {
                ago_s: reference.ago_s + dt_s,
                turned_rad: reference.turned_rad + gyro * dt_s,
                ..reference
            }),
        };
    }

    /// Means of the gyro over the blocks of a rest, once it has settled.
    fn collect(&mut self, params: &RestParams, gyro: Vector3<f64>, dt_s: f64) {
        if self.still_s < params.tau_s {
            (self.block, self.blocks_rad_s, self.shown_rad_s) = Default::default();
            return;
        }
        self.block.0 += gyro * dt_s;
        self.block.1 += dt_s;
        if self.block.1 >= BLOCK_S {
            let (turned_rad, block_s) = std::mem::take(&mut self.block);
            self.shown_rad_s = self.blocks_rad_s[0];
            self.blocks_rad_s.rotate_left(1);
            self.blocks_rad_s[BLOCKS - 1] = Some(turned_rad / block_s);
        }
    }

    /// The gyro's mean over a part of the rest that has lasted long enough after it, rad/s: each part once.
    pub(super) fn shown_rad_s(&mut self) -> Option<Vector3<f64>> {
        self.shown_rad_s.take()
    }

    /// Whether what the gyro reads beyond a bias of `bias_rad_s` has stayed as it is, as a bias does, while gravity stayed where it
    /// was. What turns too slowly to show it otherwise shows it so, and is watched anew from then on.
    pub(super) fn holds_steady(&mut self, params: &RestParams, bias_rad_s: &Vector3<f64>) -> bool {
        let Some(reference) = &self.reference else { return false };
        let ends = [reference.directions[0], self.accel.stage[1]].map(|force| force.try_normalize(0.0));
        let [Some(from), Some(to)] = ends else { return false };
        // A direction of the room turns in sensor axes against the sensor.
        let expected = from.cross(&(reference.turned_rad - bias_rad_s * reference.ago_s));
        let turns =
            expected.norm() > TELLING_RAD && (to - from).dot(&expected) > 0.5 * expected.norm_squared();
        let gyro = self.gyro_rad_s();
        let beyond_rad_s = (gyro - bias_rad_s).norm();
        let varies = (gyro - reference.gyro_rad_s).norm() > STEADY_RAD_S.max(NOISE_SHARE * beyond_rad_s);
        // A rotation about the vertical shows in neither.
        let is_told =
            expected.norm() > TELLING_RAD || reference.ago_s >= params.min_s || beyond_rad_s <= STEADY_RAD_S;
        if turns || varies {
            self.reference = None;
            self.steady_s = 0.0;
        }
        !turns && !varies && is_told
    }

    /// Whether the angular velocity is a bias however large it is, because gravity and field kept their places. A rotation
    /// about the vertical shows in the field alone; without one `vertical` states whether an angular velocity about it may be
    /// taken for a bias.
    pub(super) fn proves_bias(&self, params: &RestParams, vertical: bool) -> bool {
        let Some(reference) = &self.reference else { return false };
        let turned = reference.turned_rad;
        let off = self.gyro_rad_s() * reference.ago_s - turned;
        // What swings to and fro comes back to its place, and is no bias.
        if reference.ago_s < params.proof_s || off.norm() > NOISE_SHARE * turned.norm() {
            return false;
        }
        let now = [self.accel.stage[1], self.mag.stage[1]];
        // What no direction that should have turned can speak of: the part about that direction itself.
        let mut unseen = turned.norm();
        let mut reported = 0;
        for (from, to) in reference.directions.iter().zip(&now) {
            let (Some(from), Some(to)) = (from.try_normalize(0.0), to.try_normalize(0.0)) else { continue };
            let expected = turned.cross(&from).norm();
            if expected < TELLING_RAD {
                continue;
            }
            if (to - from).norm() > NOISE_SHARE * expected {
                return false;
            }
            reported += 1;
            unseen = if reported == 1 { turned.dot(&from).abs() } else { 0.0 };
        }
        unseen <= NOISE_SHARE * turned.norm() || (vertical && !self.mag.started)
    }

    pub(super) fn at_rest(&self) -> bool {
        self.at_rest
    }

    pub(super) fn still_s(&self) -> f64 {
        self.still_s
    }

    pub(super) fn gyro_rad_s(&self) -> Vector3<f64> {
        self.gyro.stage[1]
    }
}

/// Two equal first-order stages in series: settles without overshoot.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
struct LowPass {
    started: bool,
    stage: [Vector3<f64>; 2],
}

impl LowPass {
    fn push(&mut self, value: Vector3<f64>, dt_s: f64, tau_s: f64) -> Vector3<f64> {
        if !self.started {
            *self = Self { started: true, stage: [value; 2] };
            return value;
        }
        // Each stage has half the time constant, so that their step response settles like tau_s.
        let gain = dt_s / (0.5 * tau_s + dt_s);
        self.stage[0] += (value - self.stage[0]) * gain;
        self.stage[1] += (self.stage[0] - self.stage[1]) * gain;
        self.stage[1]
    }
}
