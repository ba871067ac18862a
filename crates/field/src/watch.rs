//! Whether the field is still the one that was calibrated.
//!
//! What comes in: where sensors that never move, and sensors fixed to each other, are seen. What goes out: that metal or
//! the mains disturb the field now, by how much, and that it has drifted since. What it never does: learn while it is
//! disturbed.
//!
//! Each channel (a reference sensor's place, the distance of a pair) is averaged over short blocks; the first ten seconds say how
//! much blocks differ by themselves. Two blocks in a row beyond the limit, on the same side, are a disturbance.

use nalgebra::Vector3;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

/// Length of a block, s: two of them and the wait for their first must fit half a second.
const BLOCK_S: f64 = 0.15;
/// Fewest readings of a block that says something.
const LEAST_READINGS: f64 = 3.0;
/// Blocks that say how much blocks differ: ten seconds.
const BASELINE_BLOCKS: u32 = 66;
/// Limits in standard deviations of a block: of a disturbance, of its end, of the hum's amplitude.
const BEGIN_SIGMAS: f64 = 5.0;
const END_SIGMAS: f64 = 3.0;
const HUM_SIGMAS: f64 = 6.0;
/// Least standard deviation of a block, m: a device's words have a step.
const LEAST_SIGMA_M: f64 = 5e-5;
/// Blocks in a row that begin and end a disturbance.
const BEGIN_BLOCKS: u32 = 2;
const END_BLOCKS: u32 = 7;
/// How fast the undisturbed mean follows a slow drift, s; how far it may drift (standard deviations of a block, and m)
/// and for how long before a new calibration is asked for, s.
const FOLLOW_S: f64 = 20.0;
const DRIFT_SIGMAS: f64 = 4.0;
const DRIFT_M: f64 = 0.002;
const DRIFT_S: f64 = 120.0;
/// A disturbance is carried to other ranges by no more than this factor, and this far, m.
const MOST_GROWTH: f64 = 30.0;
const MOST_DOUBT_M: f64 = 0.5;

/// Which sensors watch the field, and the frequency of the mains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WatchSettings {
    /// Reference sensors, which never move, by index.
    pub reference_sensors: Vec<usize>,
    /// Pairs of sensors that are fixed to each other, by index.
    pub pairs: Vec<[usize; 2]>,
    /// Frequency of the mains, Hz: 50 or 60.
    pub mains_hz: f64,
}

/// Where one sensor is seen in a frame; transmitter frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WatchedPosition {
    /// As measured and corrected by the map, m; `None` where there is no reading. Reference sensors are watched by it.
    pub measured_m: Option<Vector3<f64>>,
    /// As filtered, at the frame's time, m; `None` where the sensor is not tracked. Pairs are watched by it.
    pub tracked_m: Option<Vector3<f64>>,
    /// What the map and the noise leave of a corrected position, 3-D rms, m.
    pub sigma_m: f64,
}

/// What tells of a disturbance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// A sensor that never moves seems to.
    ReferenceSensor,
    /// Two sensors that are fixed to each other seem to move apart or together.
    RigidPair,
    /// The mains hum.
    Hum,
}

/// What the watch reports.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Warning {
    /// A disturbance began or ended.
    Disturbed {
        /// Which kind of channel detected it.
        cause: Cause,
        /// The reference sensor, twice, or the pair.
        sensors: [usize; 2],
        /// Error of a block's mean, m; of the hum, its amplitude, m.
        deviation_m: f64,
        /// Began or ended.
        active: bool,
    },
    /// The field is not the one that was calibrated any more.
    Drifted {
        /// The reference sensor, twice, or the pair.
        sensors: [usize; 2],
        /// How far the undisturbed mean has moved since the first ten seconds, m.
        deviation_m: f64,
    },
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
struct Block {
    sum: Vector3<f64>,
    cos: Vector3<f64>,
    sin: Vector3<f64>,
    cos_sum: f64,
    sin_sum: f64,
    sigma_m: f64,
    count: f64,
    begun_s: Option<f64>,
}

/// Mean and spread of what blocks say, and where the mean has gone since.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
struct Baseline {
    has_origin: bool,
    blocks: u32,
    mean: Vector3<f64>,
    squares: f64,
    hum_mean: f64,
    hum_squares: f64,
    now: Vector3<f64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
struct Alarm {
    active: bool,
    blocks: u32,
    last: Vector3<f64>,
}

#[derive(Clone, Debug, PartialEq, Plain)]
struct Channel {
    sensors: [usize; 2],
    block: Block,
    baseline: Baseline,
    alarm: Alarm,
    hum: Alarm,
    deviation_m: f64,
    drifted_s: f64,
    drifted: bool,
}

impl Channel {
    fn new(sensors: [usize; 2]) -> Self {
        Self {
            sensors,
            block: Block::default(),
            baseline: Baseline::default(),
            alarm: Alarm::default(),
            hum: Alarm::default(),
            deviation_m: 0.0,
            drifted_s: 0.0,
            drifted: false,
        }
    }

    fn is_pair(&self) -> bool {
        self.sensors[0] != self.sensors[1]
    }

    /// Value and expected error of this channel in a frame.
    fn value(&self, seen: impl Fn(usize) -> WatchedPosition) -> Option<(Vector3<f64>, f64)> {
        let [a, b] = self.sensors.map(seen);
        if self.is_pair() {
            let distance = (a.tracked_m? - b.tracked_m?).norm();
            Some((Vector3::x() * distance, ((a.sigma_m.powi(2) + b.sigma_m.powi(2)) / 3.0).sqrt()))
        } else {
            a.measured_m.map(|p| (p, 0.0))
        }
    }

    fn add(&mut self, t_s: f64, (value, sigma_m): (Vector3<f64>, f64), mains_hz: f64) {
        let block = &mut self.block;
        block.begun_s.get_or_insert(t_s);
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * mains_hz * t_s);
        let value = value - self.baseline.now;
        block.sum += value;
        block.cos += value * cos;
        block.sin += value * sin;
        block.cos_sum += cos;
        block.sin_sum += sin;
        block.sigma_m += sigma_m;
        block.count += 1.0;
    }

    /// Judges a full block; `quiet`: no channel is disturbed, so that this one may learn.
    fn judge(&mut self, quiet: bool, emit: &mut dyn FnMut(Warning)) {
        let block = std::mem::take(&mut self.block);
        if block.count < LEAST_READINGS {
            return;
        }
        let offset = block.sum / block.count;
        let cos = (block.cos - offset * block.cos_sum) * (2.0 / block.count);
        let sin = (block.sin - offset * block.sin_sum) * (2.0 / block.count);
        let hum_m = libm::hypot(cos.norm(), sin.norm());
        let baseline = &mut self.baseline;
        if baseline.blocks < BASELINE_BLOCKS {
            baseline.learn(offset, hum_m);
            return;
        }
        let own = (baseline.squares / f64::from(BASELINE_BLOCKS - 1)).sqrt().max(LEAST_SIGMA_M);
        // A map errs differently at another place: a pair that moves is expected to show it.
        let sigma_m = own.max(block.sigma_m / block.count);
        self.deviation_m = offset.norm();
        let sensors = self.sensors;
        let cause = if self.is_pair() { Cause::RigidPair } else { Cause::ReferenceSensor };
        let deviation_m = self.deviation_m;
        self.alarm.step(offset, sigma_m, BEGIN_SIGMAS, &mut |active| {
            emit(Warning::Disturbed { cause, sensors, deviation_m, active });
        });
        if !self.is_pair() {
            let spread = (self.baseline.hum_squares / f64::from(BASELINE_BLOCKS - 1)).sqrt();
            let over = Vector3::x() * (hum_m - self.baseline.hum_mean).max(0.0);
            let spread = spread.max(0.5 * self.baseline.hum_mean).max(LEAST_SIGMA_M);
            self.hum.step(over, spread, HUM_SIGMAS, &mut |active| {
                emit(Warning::Disturbed { cause: Cause::Hum, sensors, deviation_m: hum_m, active });
            });
        }
        if quiet && !self.alarm.active && !self.hum.active && self.alarm.blocks == 0 {
            self.baseline.now += offset * (BLOCK_S / FOLLOW_S);
        }
        let drift_m = (self.baseline.now - self.baseline.mean).norm();
        let far = drift_m > (DRIFT_SIGMAS * own).max(DRIFT_M);
        self.drifted_s = if far { self.drifted_s + BLOCK_S } else { 0.0 };
        if self.drifted_s > DRIFT_S && !self.drifted {
            self.drifted = true;
            emit(Warning::Drifted { sensors, deviation_m: drift_m });
        }
    }
}

impl Baseline {
    /// Welford's sums. The very first block only states where the others are near: they speak relative to it.
    fn learn(&mut self, offset: Vector3<f64>, hum_m: f64) {
        if !self.has_origin {
            (self.has_origin, self.now) = (true, offset);
            return;
        }
        self.blocks += 1;
        let n = f64::from(self.blocks);
        let value = self.now + offset;
        let before = value - self.mean;
        self.mean += before / n;
        self.squares += before.dot(&(value - self.mean)) / 3.0;
        let before = hum_m - self.hum_mean;
        self.hum_mean += before / n;
        self.hum_squares += before * (hum_m - self.hum_mean);
        if self.blocks == BASELINE_BLOCKS {
            self.now = self.mean;
        }
    }
}

impl Alarm {
    fn step(&mut self, offset: Vector3<f64>, sigma_m: f64, begin: f64, emit: &mut dyn FnMut(bool)) {
        let far = offset.norm() / sigma_m;
        if self.active {
            self.blocks = if far < END_SIGMAS { self.blocks + 1 } else { 0 };
            if self.blocks == END_BLOCKS {
                *self = Self::default();
                emit(false);
            }
            return;
        }
        let again = self.blocks > 0 && offset.dot(&self.last) > 0.0;
        self.blocks = if far > begin { u32::from(again) * self.blocks + 1 } else { 0 };
        self.last = offset;
        if self.blocks == BEGIN_BLOCKS {
            (self.active, self.blocks) = (true, 0);
            emit(true);
        }
    }
}

/// The watch over one field: reports disturbances within half a second, and drift after two minutes.
///
/// Each channel needs ten undisturbed seconds first, in which it reports nothing. Method and limits:
/// `docs/methods/field.md`; delay and false alarms: `docs/field.md`.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub struct Watch {
    mains_hz: f64,
    channels: Vec<Channel>,
    /// Range of the reference sensor that is off, and by how much, m.
    reference: Option<(f64, f64)>,
    /// How far pairs are off, m.
    pair_m: f64,
}

impl Watch {
    /// A watch that has seen nothing. Without reference sensors and pairs it never reports anything.
    pub fn new(settings: &WatchSettings) -> Self {
        let reference_sensors = settings.reference_sensors.iter().map(|sensor| Channel::new([*sensor; 2]));
        let pairs = settings.pairs.iter().map(|pair| Channel::new(*pair));
        Self {
            mains_hz: settings.mains_hz,
            channels: reference_sensors.chain(pairs).collect(),
            ..Self::default()
        }
    }

    /// Forgets all that was seen, as after a change of the map: the first ten seconds are learnt anew. Disturbances
    /// that were going on end without a warning.
    pub fn reset(&mut self) {
        self.channels.iter_mut().for_each(|channel| *channel = Channel::new(channel.sensors));
        (self.reference, self.pair_m) = (None, 0.0);
    }

    /// Whether a disturbance goes on. Meanwhile nothing must be learnt: no noise, no calibration.
    pub fn is_disturbed(&self) -> bool {
        self.channels.iter().any(|channel| channel.alarm.active || channel.hum.active)
    }

    /// Takes a frame at time `t_s` (s). `seen`: where the sensor of an index is; `emit` gets each warning when it
    /// begins and ends.
    ///
    /// A block ends after 0.15 s, or at once where time runs backwards; one with fewer than three readings is left out.
    /// A disturbance takes two blocks in a row beyond 5 standard deviations to begin, and seven below 3 to end.
    pub fn push(&mut self, t_s: f64, seen: impl Fn(usize) -> WatchedPosition, emit: &mut dyn FnMut(Warning)) {
        for at in 0..self.channels.len() {
            let quiet = !self.is_disturbed();
            let channel = &mut self.channels[at];
            if channel.block.begun_s.is_some_and(|begun| t_s - begun >= BLOCK_S || t_s < begun) {
                channel.judge(quiet, emit);
            }
            if let Some(value) = channel.value(&seen) {
                channel.add(t_s, value, self.mains_hz);
            }
        }
        (self.reference, self.pair_m) = (None, 0.0);
        for channel in &self.channels {
            if channel.is_pair() && channel.alarm.active {
                self.pair_m = self.pair_m.max(channel.deviation_m);
            } else if channel.alarm.active {
                let deviation_m = channel.deviation_m;
                if self.reference.is_none_or(|(_, other)| other < deviation_m) {
                    self.reference = Some((channel.baseline.mean.norm(), deviation_m));
                }
            }
        }
    }

    /// What a disturbance may do to a sensor at `range_m` from the transmitter, variance per axis, m^2; 0 while there
    /// is none.
    ///
    /// The deviation of the worst reference sensor is carried there by the fourth power of the range (30-fold at most),
    /// and that of the pairs is added to it. The standard deviation in 3-D is 0.5 m at most.
    pub fn doubt_m2(&self, range_m: f64) -> f64 {
        let reference = self.reference.map_or(0.0, |(own_m, deviation_m)| {
            deviation_m * (range_m / own_m.max(0.1)).powi(4).min(MOST_GROWTH)
        });
        (libm::hypot(reference, self.pair_m)).min(MOST_DOUBT_M).powi(2) / 3.0
    }
}

#[cfg(test)]
#[path = "watch_tests.rs"]
mod tests;
