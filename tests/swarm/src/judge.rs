//! Holds what is published as good against the truth.
//!
//! The truth is the motion itself, at the very time that a frame states: a stale value is off by as far as its body has moved.

use std::path::Path;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_geometry::orientation_from_wxyz;
use posed_rig::Said;
use posed_simulator::faults::Fault;
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{Body, Motion};
use posed_stage::output::{Estimate, PoseEstimate, SensorState};
use posed_stage::{Driver, Stage};

use crate::plan::{BLIND_S, Plan, Span};
use crate::trouble::LEAD_S;

/// A pose this far off, and further than its noise and its time explain, is wrong.
const WRONG_M: f64 = 0.02;
const WRONG_DEG: f64 = 5.0;
/// The same of an IMU, whose filter is not the better part of a second old, and without sight of where north is.
const WRONG_TILT_DEG: f64 = 8.0;
const WRONG_HEADING_DEG: f64 = 20.0;
/// Of a bare chip that nobody has calibrated and that has not rested: three deviations of its gyroscope's bias, 7.5 degrees a second,
/// for the four seconds in which gravity brings a tilt back.
const BARE_TILT_DEG: f64 = 30.0;
/// A deviation that no noise explains, of what is simulated and of what is stated.
const SIGMAS: f64 = 6.0;
/// As much as a stated deviation may excuse: what says that it knows nothing should not be good.
const MOST_M: f64 = 0.1;
const MOST_DEG: f64 = 20.0;
/// What the clock of a device that has none may be off.
const TIME_S: f64 = 5e-3;

struct Rider {
    body: Body,
    device: usize,
    kind: Kind,
    /// What it is, for a reader.
    words: String,
    /// Whether its errors are those of a bare chip that nobody has calibrated, or of one that is read too seldom to follow a limb:
    /// a share of a compass, and a worse level.
    bare: bool,
    /// It lies still before a transmitter: if nobody saw it come to rest, its device may as well be stuck, until it moves.
    rests: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Magnetic,
    /// An IMU with a magnetometer.
    Compass,
    /// An IMU that knows where down is.
    Tilt,
}

pub(crate) struct Judge {
    riders: Vec<Rider>,
    sigma_signal: f64,
    /// Whether a device can still be compared.
    pub(crate) judged: Vec<bool>,
    blind: Vec<Span>,
    /// A sensor is on the other side of its transmitter.
    flips: Vec<Span>,
    /// A sensor repeats itself.
    repeats: Vec<Span>,
    /// Something is wrong with the device or its line.
    faults: Vec<Span>,
    /// The same, where a chain that is searched meanwhile gives its trackers other numbers.
    renumbered: Vec<Span>,
    /// By sensor, when it was good for the first time, s.
    begun_s: Vec<Option<f64>>,
    /// By sensor: it began on the other side of its transmitter. A pipeline that begins anew goes on with the side.
    mirrored: Vec<bool>,
    /// Where a model has put the transmitter, which stands at the room's origin.
    pub(crate) room_transmitter: Isometry3<f64>,
    /// A sensor whose good values are printed one by one, those that are not compared too.
    traced: Option<String>,
    /// Values that were good, and compared.
    pub(crate) compared: u64,
    /// How often the pipeline has begun anew.
    pub(crate) begun_anew: u64,
}

impl Judge {
    pub(crate) fn new(stage: &Stage, plan: &Plan) -> Self {
        let scenario = &plan.scenario;
        let riders = stage.sensors.iter().map(|sensor| {
            let rides = scenario.sensors.iter().find(|rides| rides.name == sensor.name).expect("all ride");
            let body = scenario.bodies.iter().find(|body| body.name == rides.body).expect("a body");
            let device = stage.devices.iter().position(|device| device.name == sensor.device).expect("known");
            let driver = &stage.devices[device].driver;
            let kind = match driver {
                Driver::FlockOfBirds(_)
                | Driver::MotionStar(_)
                | Driver::Fastrak(_)
                | Driver::Polhemus(_)
                | Driver::Vrpn(_) => Kind::Magnetic,
                driver if driver.measures_field() && sensor.magnetometer => Kind::Compass,
                _ => Kind::Tilt,
            };
            Rider {
                rests: kind == Kind::Magnetic && matches!(body.motion, Motion::Still(_)),
                body: Body::new(body.motion.clone(), Path::new(".")).expect("a motion without a file"),
                device,
                words: format!("{} ({})", sensor.name, driver.word()),
                bare: scenario.devices[device].imu == ImuClass::Mpu || plan.devices[device].seldom,
                kind,
            }
        });
        let devices = scenario.devices.iter().enumerate();
        let faults = devices.flat_map(|(at, device)| device.faults.iter().map(move |fault| (at, fault)));
        let span = |(at, fault): (usize, &Fault)| {
            let (from_s, until_s) = fault.span_s();
            Span { device: at, from_s, until_s }
        };
        let renumbers = |(at, fault): &(usize, &Fault)| {
            matches!(fault, Fault::BirdDies { .. }) && matches!(stage.devices[*at].driver, Driver::Xbus(_))
        };
        Self {
            riders: riders.collect(),
            sigma_signal: scenario.sigma_signal_per_m3,
            judged: plan.devices.iter().map(|device| device.judged).collect(),
            blind: plan.blind.clone(),
            flips: plan.flips.clone(),
            repeats: faults
                .clone()
                .filter(|(_, fault)| matches!(fault, Fault::OutOfRange { .. }))
                .map(span)
                .collect(),
            renumbered: faults.clone().filter(renumbers).map(span).collect(),
            faults: faults.map(span).collect(),
            traced: plan.traced.clone(),
            begun_s: vec![None; stage.sensors.len()],
            mirrored: vec![false; stage.sensors.len()],
            room_transmitter: Isometry3::identity(),
            compared: 0,
            begun_anew: 0,
        }
    }

    /// Whether a sensor may stay doubtful for ever, for it does not move.
    pub(crate) fn may_stay_doubtful(&self, sensor: usize) -> bool {
        self.riders[sensor].rests
    }

    /// The pipeline sets its devices up: what goes wrong meanwhile is as if it did before the first fault may begin.
    pub(crate) fn begin_anew(&mut self, times: u64, t_s: f64) {
        self.begun_anew = times;
        self.begun_s.fill(None);
        let is_now = |span: &&Span| span.from_s < t_s + LEAD_S && span.until_s > t_s;
        for span in self.renumbered.iter().filter(is_now) {
            self.judged[span.device] = false;
        }
        let meanwhile = self.faults.iter().filter(is_now);
        self.blind.extend(meanwhile.map(|fault| Span {
            from_s: t_s,
            until_s: fault.until_s.min(t_s + LEAD_S) + BLIND_S,
            ..*fault
        }));
    }

    /// A sentence about the first value that is published as good and is not.
    pub(crate) fn frame(&mut self, estimate: &Estimate) -> Result<(), String> {
        let t_s = estimate.t_valid.as_secs_f64();
        for (at, (sensor, rider)) in estimate.sensors.iter().zip(&self.riders).enumerate() {
            let Some(pose) = sensor.usable_pose() else { continue };
            if self.traced.as_ref().is_some_and(|name| rider.words.starts_with(&format!("{name} "))) {
                self.trace(estimate, sensor.state, pose, rider);
            }
            let begun_s = *self.begun_s[at].get_or_insert(t_s);
            // Nobody can know that it began on the other side.
            let device = rider.device;
            self.mirrored[at] |= self.flips.iter().any(|span| span.holds(device, begun_s));
            if self.mirrored[at] {
                continue;
            }
            // Nor that it repeats itself from its first record on, until it changes: it may as well lie still.
            if self.repeats.iter().any(|span| span.holds(device, begun_s) && t_s < span.until_s + BLIND_S) {
                continue;
            }
            if !self.judged[device] || self.blind.iter().any(|span| span.holds(device, t_s)) {
                continue;
            }
            // Who could not tell damaged bytes from good ones may be wrong about the side of a sensor for ever after, and says that
            // it repairs.
            let was_blind = self.blind.iter().any(|span| span.device == device && span.from_s < t_s);
            let any_side = was_blind && sensor.state == SensorState::Repaired;
            self.compared += 1;
            let truth = rider.body.pose(0, t_s);
            let twist = rider.body.twist(0, t_s);
            let late_s = TIME_S.max(SIGMAS * estimate.sigma_t_s);
            let turned_deg = (twist.angular_rad_s.norm() * late_s).to_degrees();
            let off = match rider.kind {
                Kind::Magnetic => {
                    let r = truth.translation.vector.norm();
                    let moved_m = twist.linear_m_s.norm() * late_s;
                    let held = |truth| self.magnetic(pose, truth, r, moved_m, turned_deg);
                    let mirrored = Isometry3 { translation: truth.translation.inverse(), ..truth };
                    held(&truth).filter(|_| !any_side || held(&mirrored).is_some())
                }
                Kind::Compass if !rider.bare => {
                    inertial(pose, &truth.rotation, turned_deg, WRONG_TILT_DEG, true)
                }
                _ => {
                    let tilt_deg = if rider.bare { BARE_TILT_DEG } else { WRONG_TILT_DEG };
                    inertial(pose, &truth.rotation, turned_deg, tilt_deg, false)
                }
            };
            if let Some(off) = off {
                return Err(format!(
                    "frame {} at {t_s:.4} s: {} is {:?} and {off}, as it was {:.3} s before (sigma {:.1} mm, of time {:.1} ms)",
                    estimate.frame,
                    rider.words,
                    sensor.state,
                    self.age_s(rider, pose, t_s),
                    pose.sigma_m.unwrap_or_default() * 1e3,
                    estimate.sigma_t_s * 1e3
                ));
            }
        }
        Ok(())
    }

    /// Prints what a device reports of itself, where one sensor is looked at.
    #[expect(clippy::print_stdout, reason = "for whoever looks at one seed")]
    pub(crate) fn trace_said(&self, t: Timestamp, said: &Said) {
        if self.traced.is_some() {
            println!("{:.4} s: {said:?}", t.as_secs_f64());
        }
    }

    #[expect(clippy::print_stdout, reason = "for whoever looks at one seed")]
    fn trace(&self, estimate: &Estimate, state: SensorState, pose: &PoseEstimate, rider: &Rider) {
        let t_s = estimate.t_valid.as_secs_f64();
        let truth = self.room_transmitter * rider.body.pose(0, t_s);
        let off_m = pose.position_m.map(|p| (Vector3::from(p) - truth.translation.vector).norm());
        let reported = orientation_from_wxyz(pose.orientation_wxyz).unwrap_or_default();
        println!(
            "{t_s:.4} s, closed {:.1} ms later: {state:?}, {:.1} mm, {:.2} degrees (tilt {:.2}, says {:.2}) off, as {:.3} s before, sigma of time {:.1} ms",
            1e3 * estimate.t_closed.seconds_since(estimate.t_valid),
            1e3 * off_m.unwrap_or_default(),
            reported.angle_to(&truth.rotation).to_degrees(),
            tilt_deg(&reported, &truth.rotation),
            sigma_deg(pose),
            self.age_s(rider, pose, t_s),
            1e3 * estimate.sigma_t_s,
        );
    }

    /// How old the value looks, s: the age at which it would be nearest to the truth, within a second.
    fn age_s(&self, rider: &Rider, pose: &PoseEstimate, t_s: f64) -> f64 {
        let down = orientation_from_wxyz(pose.orientation_wxyz).map(|q| q.inverse() * Vector3::z());
        let off = |age_ms: i32| {
            let truth = self.room_transmitter * rider.body.pose(0, t_s - f64::from(age_ms) * 1e-3);
            match (pose.position_m, down) {
                (Some(p), _) => (Vector3::from(p) - truth.translation.vector).norm(),
                (None, Some(down)) => down.angle(&(truth.rotation.inverse() * Vector3::z())),
                (None, None) => 0.0,
            }
        };
        let nearest = (-200..1000).min_by(|a, b| off(*a).total_cmp(&off(*b)));
        f64::from(nearest.unwrap_or(0)) * 1e-3
    }

    fn magnetic(
        &self,
        pose: &PoseEstimate,
        truth: &Isometry3<f64>,
        r: f64,
        moved_m: f64,
        turned_deg: f64,
    ) -> Option<String> {
        let truth = self.room_transmitter * truth;
        let stated_m = (SIGMAS * pose.sigma_m.unwrap_or(0.0)).min(MOST_M);
        let stated_deg = (SIGMAS * sigma_deg(pose)).min(MOST_DEG);
        let limit_m = WRONG_M.max(stated_m) + moved_m + SIGMAS * self.sigma_signal * r.powi(4);
        let limit_deg = WRONG_DEG.max(stated_deg)
            + turned_deg
            + (SIGMAS * 2.2 * self.sigma_signal * r.powi(3)).to_degrees();
        let off_m = pose.position_m.map_or(0.0, |p| (Vector3::from(p) - truth.translation.vector).norm());
        let known = pose.covariance[15] < 1.0;
        let turn = orientation_from_wxyz(pose.orientation_wxyz)?.angle_to(&truth.rotation).to_degrees();
        let off_deg = if known { turn } else { 0.0 };
        let is_good = off_m <= limit_m && off_deg <= limit_deg;
        (!is_good).then(|| {
            format!(
                "{:.1} mm and {off_deg:.1} degrees off, more than {:.1} and {limit_deg:.1}",
                off_m * 1e3,
                limit_m * 1e3
            )
        })
    }
}

fn inertial(
    pose: &PoseEstimate,
    truth: &UnitQuaternion<f64>,
    turned_deg: f64,
    wrong_tilt_deg: f64,
    heading: bool,
) -> Option<String> {
    let reported = orientation_from_wxyz(pose.orientation_wxyz)?;
    let tilt_deg = tilt_deg(&reported, truth);
    // What is left when both stand upright.
    let turn = reported * truth.inverse();
    let heading_deg = (2.0 * libm::atan2(turn.k, turn.w)).to_degrees();
    let heading_deg = (heading_deg + 540.0).rem_euclid(360.0) - 180.0;
    let stated_deg = SIGMAS * sigma_deg(pose);
    let tilt_limit_deg = wrong_tilt_deg.max(stated_deg.min(MOST_DEG)) + turned_deg;
    let heading_limit_deg = WRONG_HEADING_DEG.max(stated_deg) + turned_deg;
    let is_good = tilt_deg <= tilt_limit_deg && (!heading || heading_deg.abs() <= heading_limit_deg);
    (!is_good).then(|| {
        format!(
            "tilts {tilt_deg:.1} and heads {heading_deg:.1} degrees off (says sigma {:.1})",
            sigma_deg(pose)
        )
    })
}

/// Angle between what two orientations take for down.
fn tilt_deg(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    (a.inverse() * Vector3::z()).angle(&(b.inverse() * Vector3::z())).to_degrees()
}

/// Root mean square of the stated rotation error: the diagonal's places in the upper triangle of six rows.
fn sigma_deg(pose: &PoseEstimate) -> f64 {
    let variance: f64 = [15, 18, 20].iter().map(|&at| pose.covariance[at]).sum();
    variance.sqrt().to_degrees()
}
