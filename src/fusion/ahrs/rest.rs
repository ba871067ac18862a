//! Is the sensor lying still?
//!
//! In: gyro and accelerometer samples. Out: a flag, and the low-passed gyro, which at rest is the bias.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// When a sensor counts as lying still; Laidig & Seel 2023, their defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RestParams {
    /// Time constant of the low-pass, s.
    pub tau_s: f64,
    /// Largest departure of the gyro from its low-pass, rad/s.
    pub gyro_rad_s: f64,
    /// Largest departure of the accelerometer from its low-pass, m/s².
    pub accel_m_s2: f64,
    /// How long both must hold, s.
    pub min_s: f64,
    /// After so long nothing but a bias keeps a gyro from zero, s; before, a rate that the bias cannot explain is slow turning.
    pub certain_s: f64,
    /// Largest bias that can be; a constant rate above it is no rest, rad/s.
    pub bias_clip_rad_s: f64,
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
        }
    }
}

/// State of the detector.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Rest {
    gyro: LowPass,
    accel: LowPass,
    still_s: f64,
    at_rest: bool,
}

impl Rest {
    pub(super) fn push(&mut self, params: &RestParams, gyro: Vector3<f64>, accel: Vector3<f64>, dt_s: f64) {
        let rate = self.gyro.push(gyro, dt_s, params.tau_s);
        let force = self.accel.push(accel, dt_s, params.tau_s);
        let moving = (gyro - rate).norm_squared() > params.gyro_rad_s.powi(2)
            || (accel - force).norm_squared() > params.accel_m_s2.powi(2)
            || rate.amax() > params.bias_clip_rad_s;
        self.still_s = if moving { 0.0 } else { self.still_s + dt_s };
        self.at_rest = self.still_s >= params.min_s;
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
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
