//! One limb of a body: begins an arm's or a leg's filter from its sensors' own orientations, and drives it.
//!
//! In: the trunk's motion, both sensors' samples and own orientations. Out: upper and lower segment to trunk. A limb
//! without two sensors it leaves alone: one sensor shows no joint.

use nalgebra::{SVector, UnitQuaternion, Vector3};
use posed_state::Plain;

use super::health::TOLD_S;
use super::skeleton::{BodySegment, Limb, SEGMENTS, Skeleton};
use super::{BodyParams, Sensor, SensorMount, joint_angles};
use crate::ahrs::ImuSample;
use crate::limb::{
    Arm, Axes, Ball, Base, FieldReference, Leg, LimbGeometry, LimbNoise, LimbSamples, LimbSpread,
    SensorReport,
};

/// Uncertainty of each angle at the start, rad.
const START_SIGMA_RAD: f64 = 0.2;
/// North, as [`Sensor::north`] gives it.
const NORTH: FieldReference =
    FieldReference { azimuth_rad: std::f64::consts::FRAC_PI_2, norm: 1.0, dip_rad: 0.0 };
/// A limb that differs by so much from what both of its sensors say, rad, for so long, s, began with orientations of chance: they were switched on in the
/// middle of a movement. It finds no way back, and begins anew.
const ASTRAY_RAD: f64 = 0.5;
const ASTRAY_S: f64 = 1.0;
/// A sensor that is said not to fit for so long, s, has slipped: three seconds longer than is said of what is over, such as a blow, or what a joint does that is no hinge.
const LOOSE_S: f64 = TOLD_S + 3.0;
/// What does not fit in the first seconds of a limb, s, is how it began, in the middle of a movement: after so long of it, s, it begins anew.
const YOUNG_S: f64 = 10.0;
const BEGUN_WRONG_S: f64 = 1.5;
/// Once one has slipped, so long is waited for what its movements show, s.
const PATIENCE_S: f64 = 20.0;
/// A mounting that is known so well again has been found, rad.
const FOUND_RAD: f64 = 0.12;
/// Elbow: flexion, pronation; knee: flexion; degrees. Some degrees beyond the anatomy of algorithms as written, because the
/// zero of a calibration is only as good as the pose that was held.
const ELBOW_DEG: [[f64; 2]; 2] = [[-8.0, -95.0], [158.0, 95.0]];
const KNEE_DEG: [f64; 2] = [-8.0, 155.0];

impl LimbGeometry {
    /// Of a limb of a skeleton; `mounts` by [`BodySegment::index`]. A segment without a sensor counts as if one sat at its
    /// usual place, turned as the segment is; a trunk without one has its origin where the segment has its own.
    pub fn of(limb: Limb, skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS]) -> Self {
        let [trunk, upper, lower] = limb.segments();
        let mount = |segment: BodySegment| {
            mounts[segment.index()].map_or_else(UnitQuaternion::identity, |mount| mount.q_segment_sensor)
        };
        let offset_m = |segment: BodySegment| {
            mounts[segment.index()].map_or_else(|| skeleton.usual_sensor_m(segment), |mount| mount.offset_m)
        };
        let trunk_m = mounts[trunk.index()].map_or_else(Vector3::zeros, |mount| mount.offset_m);
        Self {
            base_to_joint_m: skeleton.joint_in_parent_m(upper) - trunk_m,
            upper_imu_m: offset_m(upper),
            upper_to_lower_m: skeleton.joint_in_parent_m(lower),
            lower_imu_m: offset_m(lower),
            upper_mount: mount(upper),
            lower_mount: mount(lower),
            mount_sigma_rad: [upper, lower]
                .map(|segment| mounts[segment.index()].map_or_else(Vector3::zeros, |mount| mount.sigma_rad)),
        }
    }
}

/// An elbow at rest that holds `forearm` rotated by `rotation` (forearm to upper arm): flexion about z and pronation about y (by
/// side; the carrying angle is dropped); and the least and the largest angles that it may have, rad: -8 to 158 and -95 to 95
/// degrees.
pub fn elbow(forearm: BodySegment, rotation: &UnitQuaternion<f64>) -> (Axes<2>, [SVector<f64, 2>; 2]) {
    let mut axes = Axes::new([Vector3::z(), Vector3::y() * forearm.side()]);
    let [flexion, pronation, ..] = joint_angles(forearm, rotation);
    axes.angle_rad = SVector::<f64, 2>::new(flexion, pronation);
    (axes, ELBOW_DEG.map(|row| SVector::from(row.map(f64::to_radians))))
}

/// A knee at rest that holds `shank` rotated by `rotation` (shank to thigh): flexion about -z, the rest is dropped; and the least
/// and the largest angle that it may have, rad: -8 to 155 degrees.
pub fn knee(shank: BodySegment, rotation: &UnitQuaternion<f64>) -> (Axes<1>, [SVector<f64, 1>; 2]) {
    let mut axes = Axes::new([-Vector3::z()]);
    axes.angle_rad = SVector::<f64, 1>::new(joint_angles(shank, rotation)[0]);
    (axes, KNEE_DEG.map(|limit| SVector::from([limit.to_radians()])))
}

/// The filter of one limb, once it has begun.
#[derive(Clone, Debug, PartialEq, Plain)]
#[expect(clippy::large_enum_variant, reason = "four of them, made once; no box, so that a copy is a copy")]
enum Filter {
    Waiting,
    Arm(Arm),
    Leg(Leg),
}

/// The same for whichever filter it is.
macro_rules! with_limb {
    ($filter:expr, $waiting:expr, $limb:ident => $value:expr) => {
        match $filter {
            Filter::Waiting => $waiting,
            Filter::Arm($limb) => $value,
            Filter::Leg($limb) => $value,
        }
    };
}

/// A strap was taken for slipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
struct Mending {
    /// So long ago, s.
    for_s: f64,
    /// Whether it was found once how the sensors sit, and is found anew from there.
    once: bool,
}

/// One limb.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct LimbFilter {
    limb: Limb,
    geometry: LimbGeometry,
    noise: LimbNoise,
    /// Whether upper and lower segment wear a sensor, both.
    whole: bool,
    /// Bias of both gyros of units that nobody has calibrated, as a rest has proven it, rad/s.
    offsets_rad_s: [Vector3<f64>; 2],
    /// For so long both of its sensors have said otherwise, s.
    astray_s: f64,
    /// For so long the sensor of the upper and of the lower segment has not fitted, s.
    loose_s: [f64; 2],
    /// How long ago it began, s, as long as that is not long ago.
    young_s: Option<f64>,
    /// From when a strap was taken for slipped until it is known again how both sensors sit.
    mending: Option<Mending>,
    /// Whether a strap was ever taken for slipped: what is learnt since is no error of the pose.
    slipped: bool,
    filter: Filter,
}

impl LimbFilter {
    pub(super) fn new(
        limb: Limb,
        skeleton: &Skeleton,
        mounts: &[Option<SensorMount>; SEGMENTS],
        params: &BodyParams,
    ) -> Self {
        let [_, upper, lower] = limb.segments();
        Self {
            limb,
            geometry: LimbGeometry::of(limb, skeleton, mounts),
            noise: params.limb,
            whole: [upper, lower].iter().all(|segment| mounts[segment.index()].is_some()),
            offsets_rad_s: [Vector3::zeros(); 2],
            astray_s: 0.0,
            loose_s: [0.0; 2],
            young_s: None,
            mending: None,
            slipped: false,
            filter: Filter::Waiting,
        }
    }

    /// Takes the samples of one time and returns what became of them. `own` are the segments' orientations by their sensors
    /// alone.
    pub(super) fn push(
        &mut self,
        base: &Base,
        sensors: [&Option<Sensor>; 2],
        own: [Option<UnitQuaternion<f64>>; 2],
        samples: [Option<ImuSample>; 2],
        dt_s: f64,
    ) -> [SensorReport; 2] {
        let offsets_rad_s =
            sensors.map(|sensor| sensor.as_ref().map_or_else(Vector3::zeros, |s| s.ahrs.offset_rad_s()));
        if offsets_rad_s != self.offsets_rad_s {
            self.offsets_rad_s = offsets_rad_s;
            self.filter = Filter::Waiting;
        }
        self.astray_s = if self.is_astray(base, sensors, own) { self.astray_s + dt_s } else { 0.0 };
        if self.astray_s > ASTRAY_S {
            self.restart();
        }
        if matches!(self.filter, Filter::Waiting) {
            self.begin(base, own);
            return [SensorReport::default(); 2];
        }
        // What the sensor's own filter makes of bias and field takes the place of both.
        let corrected = |which: usize| {
            let (sample, sensor) = (samples[which]?, sensors[which].as_ref()?);
            Some(ImuSample {
                gyro_rad_s: sample.gyro_rad_s - sensor.ahrs.bias_rad_s(),
                mag: sensor.north(),
                ..sample
            })
        };
        let samples = LimbSamples { upper: corrected(0), lower: corrected(1) };
        let at_rest = sensors.iter().all(|sensor| sensor.as_ref().is_none_or(|s| s.ahrs.at_rest()));
        let rests = at_rest && base.angular_velocity_rad_s.norm() < 0.05;
        with_limb!(&mut self.filter, [SensorReport::default(); 2], limb => {
            let reports = limb.push(base, Some(&NORTH), &samples, dt_s);
            if rests {
                limb.observe_rest();
            }
            self.geometry = *limb.geometry();
            reports
        })
    }

    /// How the sensor of the upper (0) or lower (1) segment sits, as far as the limb's movements have shown it; what was given as exact stays.
    pub(super) fn refine(&self, which: usize, mount: &mut SensorMount) {
        let g = &self.geometry;
        let (q_segment_sensor, offset_m) =
            [(g.upper_mount, g.upper_imu_m), (g.lower_mount, g.lower_imu_m)][which];
        if mount.sigma_rad != Vector3::zeros() {
            *mount =
                SensorMount { q_segment_sensor, offset_m, sigma_rad: g.mount_sigma_rad[which], ..*mount };
        }
    }

    /// The sensor of the upper (0) or lower (1) segment does not fit, or does, for `dt_s`.
    pub(super) fn watch(&mut self, which: usize, misfit: bool, dt_s: f64) {
        let loose_s = &mut self.loose_s[which];
        *loose_s = if misfit { *loose_s + dt_s } else { 0.0 };
        let loose_s = *loose_s;
        // This is called for each of two sensors.
        self.young_s = self.young_s.map(|ago_s| ago_s + 0.5 * dt_s).filter(|ago_s| *ago_s < YOUNG_S);
        if self.young_s.is_some() && self.mending.is_none() && loose_s > BEGUN_WRONG_S {
            self.loose_s = [0.0; 2];
            self.restart();
            return;
        }
        let slipped = loose_s > LOOSE_S || with_limb!(&self.filter, false, limb => limb.slipped());
        let is_found = self.is_found();
        match &mut self.mending {
            None if slipped => self.loosen(),
            None => {}
            // What it showed before it was found how the sensors sit now, the limb finds no way back from.
            Some(Mending { once: true, .. }) if is_found => {
                self.mending = None;
                self.restart();
            }
            Some(mending) if is_found => {
                mending.for_s += dt_s;
                mending.once = true;
                self.geometry = with_limb!(&self.filter, self.geometry, limb => limb.found_once());
                self.restart();
            }
            Some(mending) => {
                mending.for_s += dt_s;
                if slipped && mending.for_s > PATIENCE_S {
                    self.loosen();
                }
            }
        }
    }

    /// A strap was taken for slipped.
    fn loosen(&mut self) {
        (self.loose_s, self.mending, self.slipped) = ([0.0; 2], Some(Mending::default()), true);
        with_limb!(&mut self.filter, (), limb => limb.loosen());
        with_limb!(&self.filter, (), limb => self.geometry = *limb.geometry());
    }

    /// Whether it is known again how both sensors sit. How one is turned about the forearm never shows.
    fn is_found(&self) -> bool {
        let arm = matches!(self.limb, Limb::ArmR | Limb::ArmL);
        let [upper, mut lower] = self.geometry.mount_sigma_rad;
        if arm {
            lower.y = 0.0;
        }
        upper.norm().max(lower.norm()) < FOUND_RAD
    }

    /// Its sensors sit otherwise than was said: begins anew.
    pub(super) fn remount(&mut self, skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS]) {
        self.geometry = LimbGeometry::of(self.limb, skeleton, mounts);
        (self.loose_s, self.mending) = ([0.0; 2], None);
        self.slipped = false;
        self.restart();
    }

    /// Whether no strap of it was ever taken for slipped.
    pub(super) fn holds(&self) -> bool {
        !self.slipped
    }

    /// Begins anew from its sensors' own orientations.
    pub(super) fn restart(&mut self) {
        self.astray_s = 0.0;
        self.filter = Filter::Waiting;
    }

    /// Turns it against the trunk, `rotation` in the trunk's axes.
    pub(super) fn turn(&mut self, rotation: &UnitQuaternion<f64>) {
        with_limb!(&mut self.filter, (), limb => limb.turn(rotation));
    }

    /// Whether both sensors, by a field that is believed, say otherwise than the limb.
    fn is_astray(
        &self,
        base: &Base,
        sensors: [&Option<Sensor>; 2],
        own: [Option<UnitQuaternion<f64>>; 2],
    ) -> bool {
        let limb = self.orientations();
        (0..2).all(|which| {
            let (Some(sensor), Some(own), Some(relative)) = (sensors[which], own[which], limb[which]) else {
                return false;
            };
            let found = base.q_room_base * relative;
            sensor.magnetometer && !sensor.ahrs.magnetic_disturbance() && own.angle_to(&found) > ASTRAY_RAD
        })
    }

    /// Begins as soon as both sensors have an orientation.
    fn begin(&mut self, base: &Base, own: [Option<UnitQuaternion<f64>>; 2]) {
        let [Some(upper), Some(lower)] = own else { return };
        self.young_s.get_or_insert(0.0);
        let [_, _, segment] = self.limb.segments();
        let rotation = upper.inverse() * lower;
        let q = base.q_room_base.inverse() * upper;
        let ball = Ball { q, angular_velocity_rad_s: Vector3::zeros(), accel_rad_s2: Vector3::zeros() };
        let (geometry, noise) = (self.geometry, self.noise);
        self.filter = match self.limb {
            Limb::ArmR | Limb::ArmL => {
                let (elbow, limits) = elbow(segment, &rotation);
                Filter::Arm(Arm::new(geometry, noise, ball, elbow, limits, START_SIGMA_RAD))
            }
            Limb::LegR | Limb::LegL => {
                let (knee, limits) = knee(segment, &rotation);
                Filter::Leg(Leg::new(geometry, noise, ball, knee, limits, START_SIGMA_RAD))
            }
        };
    }

    /// From the trunk's sensor to the limb's joint as the movements have shown it, trunk's axes, m.
    pub(super) fn base_to_joint_m(&self) -> Vector3<f64> {
        self.geometry.base_to_joint_m
    }

    /// Whether both of its segments wear a sensor.
    pub(super) fn is_whole(&self) -> bool {
        self.whole
    }

    /// Upper and lower segment to trunk; `None` before it has begun.
    pub(super) fn orientations(&self) -> [Option<UnitQuaternion<f64>>; 2] {
        with_limb!(&self.filter, [None; 2], limb => limb.orientations().map(Some))
    }

    /// How uncertain it is; `None` before it has begun.
    pub(super) fn spread(&self) -> Option<LimbSpread> {
        with_limb!(&self.filter, None, limb => Some(limb.spread()))
    }

    /// Length of the upper segment as far as its movements have shown it, and its standard deviation, m; `None` before it has begun, and where it was given as
    /// exact.
    pub(super) fn upper_length_m(&self) -> Option<[f64; 2]> {
        let sigma_m = with_limb!(&self.filter, None, limb => limb.length_sigma_m())?;
        Some([self.geometry.upper_to_lower_m.norm(), sigma_m])
    }
}
