//! Where the hips are in the room, from the feet that stand on it.
//!
//! In: orientations of pelvis, thighs and shanks, and what the sensors on pelvis and shanks measure. Out: the hips' mid-point in the room and how likely
//! each foot stands ([`Travel`]). It never turns a segment, and it stops where a segment of the legs is not known.
//!
//! ```text
//! pelvis:  specific force ──────────────────────────────┐ predicts
//! ankle:   speed (hips' velocity and posture) ─┐        v
//!          acceleration (shank's sensor) ──────┴> stands? ──> hips' position and velocity
//!                                          posture: ankle from pelvis ┘ holds a foot that stands where it is
//! ```
//! A Kalman filter with a foothold for each foot (Bloesch et al. 2012, without their rotation, which the body's filters know). No sensor shows a
//! foot: what stands is the ankle. A foot that rolls over its ball lifts it; such an ankle counts as moving, and the pelvis's
//! accelerometer bridges the tenths of a second until the other foot stands. Axes of the room are independent of one another: each has
//! a filter of five states of its own.
//!
//! The floor is level as long as footholds lie within [`STEP_M`] of one another in height: less than that is what wrong lengths and tilts
//! make. Two in a row that are both above it, or both below, are a new floor: stairs, and slopes steeper than that a step, are followed.

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};
use posed_state::Plain;

use posed_geometry::GRAVITY_M_S2;

/// How fast and with which acceleration an ankle moves that stands, and one that does not, root mean square of an axis, m/s, m/s². One
/// that stands plays with skin and shoe.
const SPEED_M_S: [f64; 2] = [0.06, 1.0];
const ACCEL_M_S2: [f64; 2] = [0.8, 8.0];
/// For so long evidence says the same again, s; and no more than this at a time, natural logarithm.
const CORRELATED_S: f64 = 0.03;
const MOST: f64 = 4.0;
/// A foot stands that is likelier to stand than this.
const STANDS: f64 = 0.5;
/// For so long a foot stands, and is off the floor, s: the means.
const STANDS_S: f64 = 0.6;
const SWINGS_S: f64 = 0.4;
/// Of the acceleration: white noise, m/s² per root hertz, and what tilt and bias leave for a while, m/s², and how long, s.
const NOISE_M_S2: f64 = 0.05;
const LASTING_M_S2: f64 = 0.15;
const LASTING_S: f64 = 20.0;
/// Of an ankle that stands, from the pelvis, m: posture and skin.
const ANKLE_M: f64 = 0.01;
/// An ankle that moves says less: as if it were wrong by what it does in this time, s.
const LOOSE_S: f64 = 0.3;
/// Nobody jumps for longer, s. Beyond, the velocity is nothing and the lower ankle where an ankle stands to so much, m/s, m, at each time.
const JUMP_S: f64 = 1.0;
const ROLLS_M_S: f64 = 1.0;
const FLOOR_M: f64 = 0.3;
/// A foot lies flat after so long, s.
const LANDED_S: f64 = 0.08;
/// Footholds whose heights differ by less are on one floor, m, and this is how level a floor is.
const STEP_M: f64 = 0.04;
const LEVEL_M: f64 = 0.005;
/// What is known of the velocity at first, m/s.
const START_M_S: f64 = 1.0;

/// What is known of the place where something else says where the hips are, m; what each step adds at random, m; and what lengths of legs that are a little
/// wrong make of the way, as a share.
const PLACED_M: f64 = 0.02;
const PER_STEP_M: f64 = 0.02;
const LENGTHS: f64 = 0.015;

/// States of an axis: position and velocity of the pelvis's sensor, lasting error of its acceleration, and both footholds.
const STATES: usize = 5;
const POSITION: usize = 0;
const VELOCITY: usize = 1;
const ERROR: usize = 2;
const FEET: [usize; 2] = [3, 4];

/// Where a body is, and what it stands on.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Travel {
    /// The hips' mid-point, room, m.
    pub pelvis_m: Vector3<f64>,
    /// Standard deviation of each level axis of it, m, from where something else said last where it is, or else from where it began. Where the legs are not
    /// known it is that of before.
    pub sigma_m: f64,
    /// How likely the right and the left foot stand, 0 to 1; `None` while a segment of the legs is not known: the body stays where it was.
    pub contacts: Option<[f64; 2]>,
}

/// What the filter sees of one time; all vectors in room axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Legs {
    /// From the hips' mid-point to the pelvis's sensor, m.
    pub sensor_m: Vector3<f64>,
    /// What that sensor measures, m/s²; `None` where it said nothing at this time.
    pub specific_force_m_s2: Option<Vector3<f64>>,
    /// From the hips' mid-point to the right and the left ankle, m.
    pub ankles_m: [Vector3<f64>; 2],
    /// Acceleration of both ankles by the shanks' sensors, m/s²; `None` where it is not known.
    pub accels_m_s2: [Option<Vector3<f64>>; 2],
}

/// One axis of the room.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Axis {
    state: SVector<f64, STATES>,
    covariance: SMatrix<f64, STATES, STATES>,
}

/// The filter.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct TravelFilter {
    /// Ankle to floor, m.
    foot_m: f64,
    axes: [Axis; 3],
    begun: bool,
    /// From the hips' mid-point to the pelvis's sensor, as last seen, m.
    sensor_from_hips_m: Vector3<f64>,
    /// Both ankles as they were seen last, from the pelvis's sensor, m.
    ankles_m: Option<[Vector3<f64>; 2]>,
    contacts: [f64; 2],
    /// For how long each foot that stands has, s.
    stood_s: [f64; 2],
    /// Height of the floor that was stood on last, m.
    floor_m: f64,
    /// By how much the last foothold was above it, m; 0 if it was level with it.
    risen_m: f64,
    /// For so long no foot has stood, s.
    aloft_s: f64,
    /// Where it was placed last, or began, room, m, and how many steps were made since.
    placed_m: Vector3<f64>,
    steps: f64,
}

impl TravelFilter {
    /// A body whose ankles are so high above its soles, m; it has not moved yet.
    pub(super) fn new(foot_m: f64) -> Self {
        Self {
            foot_m,
            axes: [Axis::new(0.0); 3],
            begun: false,
            sensor_from_hips_m: Vector3::zeros(),
            ankles_m: None,
            contacts: [0.5; 2],
            stood_s: [0.0; 2],
            floor_m: 0.0,
            risen_m: 0.0,
            aloft_s: 0.0,
            placed_m: Vector3::zeros(),
            steps: 0.0,
        }
    }

    /// Takes the legs of one time, `dt_s` after the last, s; their headings are known to `heading_rad` (standard deviation).
    pub(super) fn push(&mut self, legs: &Legs, heading_rad: f64, dt_s: f64) -> Travel {
        if !self.begun {
            let height_m = self.foot_m - lower_m(&legs.ankles_m);
            self.place_at(Vector3::new(0.0, 0.0, height_m), legs.sensor_m);
        }
        self.sensor_from_hips_m = legs.sensor_m;
        let ankles_m = legs.ankles_m.map(|ankle_m| ankle_m - legs.sensor_m);
        let accel_m_s2 = legs.specific_force_m_s2.map(|force| force - Vector3::z() * GRAVITY_M_S2);
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.predict(accel_m_s2.map(|accel| accel[k]), dt_s);
        }
        let last_m = self.ankles_m.replace(ankles_m);
        let velocity_m_s = Vector3::from_fn(|k, _| self.axes[k].state[VELOCITY]);
        let velocity_m2_s2 =
            self.axes.iter().map(|axis| axis.covariance[(VELOCITY, VELOCITY)]).sum::<f64>() / 3.0;
        for side in 0..2 {
            let ankle_m_s = last_m.map(|last_m| velocity_m_s + (ankles_m[side] - last_m[side]) / dt_s);
            let mut evidence = 0.0;
            if let Some(ankle_m_s) = ankle_m_s {
                evidence += likelier(ankle_m_s.norm_squared(), SPEED_M_S, velocity_m2_s2);
            }
            if let Some(accel_m_s2) = legs.accels_m_s2[side] {
                evidence += likelier(accel_m_s2.norm_squared(), ACCEL_M_S2, 0.0);
            }
            let evidence = evidence.clamp(-MOST, MOST);
            // As far as this time alone shows: a foot that has just left its place still counts as standing.
            let now = 1.0 / (1.0 + libm::exp(-evidence));
            let evidence = evidence * (dt_s / CORRELATED_S).min(1.0);
            let before = self.contacts[side];
            let stood =
                before + (dt_s / SWINGS_S).min(0.5) * (1.0 - before) - (dt_s / STANDS_S).min(0.5) * before;
            let odds = stood / (1.0 - stood) * libm::exp(evidence);
            self.contacts[side] = odds / (1.0 + odds);
            if self.contacts[side] > STANDS {
                if before <= STANDS {
                    self.step_down(side, &ankles_m[side]);
                }
                let before_s = self.stood_s[side];
                self.stood_s[side] += dt_s;
                if before_s < LANDED_S && self.stood_s[side] >= LANDED_S {
                    self.level(side);
                }
                let loose_m = LOOSE_S * ankle_m_s.map_or(0.0, |speed| speed.norm());
                let noise_m2 = (ANKLE_M * ANKLE_M + loose_m * loose_m) / (self.contacts[side] * now);
                for (k, axis) in self.axes.iter_mut().enumerate() {
                    axis.hold(FEET[side], ankles_m[side][k], noise_m2);
                }
            }
        }
        let aloft = self.contacts.iter().all(|contact| *contact <= STANDS);
        self.aloft_s = if aloft { self.aloft_s + dt_s } else { 0.0 };
        if self.aloft_s > JUMP_S {
            self.land(&ankles_m);
        }
        let pelvis_m = self.sensor_m() - legs.sensor_m;
        Travel { pelvis_m, sigma_m: self.sigma_m(&pelvis_m, heading_rad), contacts: Some(self.contacts) }
    }

    /// Of a place that feet have brought the hips to: a random walk of steps, and a way whose length and direction are a little wrong. What of these goes
    /// round comes back.
    fn sigma_m(&self, pelvis_m: &Vector3<f64>, heading_rad: f64) -> f64 {
        let away_m = (pelvis_m - self.placed_m).xy().norm();
        let way_m2 = (LENGTHS * LENGTHS + heading_rad * heading_rad) * away_m * away_m;
        (PLACED_M * PLACED_M + self.steps * PER_STEP_M * PER_STEP_M + way_m2).sqrt()
    }

    /// Something else says where the hips' mid-point is, room, m; `sensor_m` from there to the pelvis's sensor.
    pub(super) fn place_at(&mut self, pelvis_m: Vector3<f64>, sensor_m: Vector3<f64>) {
        let moved_m = pelvis_m + sensor_m - self.sensor_m();
        for (k, axis) in self.axes.iter_mut().enumerate() {
            [POSITION, FEET[0], FEET[1]].into_iter().for_each(|state| axis.state[state] += moved_m[k]);
        }
        if self.begun {
            self.floor_m += moved_m.z;
        }
        self.begun = true;
        self.sensor_from_hips_m = sensor_m;
        (self.placed_m, self.steps) = (pelvis_m, 0.0);
    }

    /// A segment of the legs is not known at this time: the body stays where it is, and begins anew from there. `None` before it has begun.
    pub(super) fn pause(&mut self, heading_rad: f64) -> Option<Travel> {
        if self.ankles_m.take().is_some() {
            let at_m = self.sensor_m();
            self.axes = [0, 1, 2].map(|k| Axis::new(at_m[k]));
            self.contacts = [0.5; 2];
        }
        let pelvis_m = self.sensor_m() - self.sensor_from_hips_m;
        self.begun.then(|| Travel { pelvis_m, sigma_m: self.sigma_m(&pelvis_m, heading_rad), contacts: None })
    }

    fn sensor_m(&self) -> Vector3<f64> {
        Vector3::from_fn(|k, _| self.axes[k].state[POSITION])
    }

    /// A foot stands from now on, its ankle there from the pelvis's sensor, m.
    fn step_down(&mut self, side: usize, ankle_m: &Vector3<f64>) {
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.begin(FEET[side], ankle_m[k]);
        }
        self.stood_s[side] = 0.0;
        self.steps += 1.0;
    }

    /// No foot has stood for longer than anybody jumps: who sits on wheels, or whose feet are not seen to stand, is about where and as high as before.
    fn land(&mut self, ankles_m: &[Vector3<f64>; 2]) {
        for axis in &mut self.axes {
            axis.observe(VELOCITY, 0.0, ROLLS_M_S * ROLLS_M_S);
        }
        let height_m = self.floor_m + self.foot_m - lower_m(ankles_m);
        self.axes[2].observe(POSITION, height_m, FLOOR_M * FLOOR_M);
    }

    /// A foot has stood for a while: its foothold is as high as the one before, unless it clearly is not.
    fn level(&mut self, side: usize) {
        let height = &mut self.axes[2];
        let floor_m = height.state[FEET[side]] - self.foot_m;
        let risen_m = floor_m - self.floor_m;
        if risen_m.abs() < STEP_M {
            height.observe(FEET[side], self.floor_m + self.foot_m, LEVEL_M * LEVEL_M);
            self.risen_m = 0.0;
        } else if risen_m * self.risen_m > 0.0 {
            (self.floor_m, self.risen_m) = (floor_m, risen_m);
        } else {
            // One alone may be a stone, or wrong.
            self.risen_m = risen_m;
        }
    }
}

/// Height of the lower ankle, m.
fn lower_m([right, left]: &[Vector3<f64>; 2]) -> f64 {
    right.z.min(left.z)
}

/// By how much likelier a vector of this squared length is in what stands than in what does not, natural logarithm; `known` is the variance of
/// an axis that both have beside their own.
fn likelier(squared: f64, sigmas: [f64; 2], known: f64) -> f64 {
    let [stands, moves] = sigmas.map(|sigma| sigma * sigma + known);
    1.5 * libm::log(moves / stands) - 0.5 * squared * (1.0 / stands - 1.0 / moves)
}

impl Axis {
    fn new(at_m: f64) -> Self {
        let mut state = SVector::zeros();
        state[POSITION] = at_m;
        let sigmas = SVector::from([1e-3, START_M_S, LASTING_M_S2, 1.0, 1.0]);
        Self { state, covariance: SMatrix::from_diagonal(&sigmas.component_mul(&sigmas)) }
    }

    /// Goes on by this acceleration, m/s²; without one as fast as before.
    fn predict(&mut self, accel_m_s2: Option<f64>, dt_s: f64) {
        let (used, noise_m_s2) = match accel_m_s2 {
            Some(accel_m_s2) => (accel_m_s2 - self.state[ERROR], NOISE_M_S2),
            None => (0.0, 1.0),
        };
        self.state[POSITION] += dt_s * (self.state[VELOCITY] + 0.5 * dt_s * used);
        self.state[VELOCITY] += dt_s * used;
        let keep = 1.0 - (dt_s / LASTING_S).min(1.0);
        self.state[ERROR] *= keep;
        let mut f = SMatrix::<f64, STATES, STATES>::identity();
        f[(POSITION, VELOCITY)] = dt_s;
        if accel_m_s2.is_some() {
            f[(POSITION, ERROR)] = -0.5 * dt_s * dt_s;
            f[(VELOCITY, ERROR)] = -dt_s;
        }
        f[(ERROR, ERROR)] = keep;
        self.covariance = f * self.covariance * f.transpose();
        self.covariance[(VELOCITY, VELOCITY)] += noise_m_s2 * noise_m_s2 * dt_s;
        self.covariance[(ERROR, ERROR)] += LASTING_M_S2 * LASTING_M_S2 * (1.0 - keep * keep);
    }

    /// A foothold begins, so far from the pelvis's sensor, m: as well known as that sensor is.
    fn begin(&mut self, foot: usize, ankle_m: f64) {
        self.state[foot] = self.state[POSITION] + ankle_m;
        let row = self.covariance.row(POSITION).clone_owned();
        self.covariance.set_row(foot, &row);
        self.covariance.set_column(foot, &row.transpose());
        self.covariance[(foot, foot)] = row[POSITION] + ANKLE_M * ANKLE_M;
    }

    /// The foothold is this far from the pelvis's sensor, m.
    fn hold(&mut self, foot: usize, ankle_m: f64, noise_m2: f64) {
        let mut h = SVector::<f64, STATES>::zeros();
        (h[foot], h[POSITION]) = (1.0, -1.0);
        self.update(&h, ankle_m, noise_m2);
    }

    /// A state is this.
    fn observe(&mut self, state: usize, value: f64, variance: f64) {
        let mut h = SVector::<f64, STATES>::zeros();
        h[state] = 1.0;
        self.update(&h, value, variance);
    }

    fn update(&mut self, h: &SVector<f64, STATES>, measured: f64, noise: f64) {
        let cross = self.covariance * h;
        let variance = h.dot(&cross) + noise;
        let gain = cross / variance;
        self.state += gain * (measured - h.dot(&self.state));
        self.covariance -= gain * cross.transpose();
        // Exactly symmetric, whatever was rounded.
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
    }
}

/// Acceleration, room, m/s², of a point so far from a sensor, m, sensor axes, on one rigid body; `turns` are the angular velocities of this time and of one
/// `dt_s` before, rad/s.
pub(super) fn carried(
    q_room_sensor: &UnitQuaternion<f64>,
    specific_force_m_s2: &Vector3<f64>,
    turns: [&Vector3<f64>; 2],
    dt_s: f64,
    point_m: &Vector3<f64>,
) -> Vector3<f64> {
    let [now, before] = turns;
    let angular_m_s2 = ((now - before) / dt_s).cross(point_m) + now.cross(&now.cross(point_m));
    q_room_sensor * (specific_force_m_s2 + angular_m_s2) - Vector3::z() * GRAVITY_M_S2
}
