//! The body, live: from worn IMUs, from magnetic trackers, or from both.
//!
//! What comes in: closed frames and their estimates. What goes out: segments, joint angles and their health at the time of
//! the newest sample. IMUs alone go from above the room's origin to where their feet bring them; trackers on the same body say where it is, and trackers alone
//! show the whole figure. What it never does: publish a body before it knows how its sensors sit.

mod epochs;
#[cfg(test)]
mod tests;

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use posed_state::{Plain, State};

pub use self::epochs::ImuRecords;
use self::epochs::{Epoch, Epochs};
use super::PipelineError;
use crate::frame::Frame;
use posed_fusion::body::{
    Anchor, BodyFilter, BodyParams, BodySegment, DoubleTap, Figure, Follower, Heading, SEGMENTS, SensorMount,
    Skeleton, Tracked, angles,
};
use posed_fusion::faults::Cause;
use posed_geometry::{isometry, orientation_from_wxyz, orientation_to_wxyz};
use posed_stage::input::{MountedSensor, SensorIndex};
use posed_stage::layout::{Wearers, skeleton_of, start_of};
use posed_stage::output::{Body, Estimate, PoseEstimate, PositionSource, SegmentEstimate, SegmentState};
use posed_stage::{BodyIndex, Mounting, Stage};

/// Expected error of the hips' place by trackers alone, along an axis, m: what lies between is posture.
const TRACKED_M: f64 = 0.02;
/// Expected error of a segment that trackers show, and of one between them, rad.
const TRACKED_RAD: f64 = 0.05;
const BETWEEN_RAD: f64 = 0.15;
/// A tracker whose rotation is no better known measures none, rad.
const UNTURNED_RAD: f64 = 0.5;

#[derive(Clone, Debug, State)]
pub(super) struct BodyStage {
    #[state(keep)]
    skeleton: Skeleton,
    /// Whether a tracker's button means that headings begin anew.
    #[state(keep)]
    resets_by_button: bool,
    /// The segment whose sensor is tapped for the same, if any.
    #[state(keep)]
    tapped: Option<BodySegment>,
    taps: DoubleTap,
    /// The sensor that was tapped since somebody asked.
    tapped_now: Option<SensorIndex>,
    wearing: [Option<SensorIndex>; SEGMENTS],
    trackers: Vec<BodyTracker>,
    epochs: Epochs,
    solver: Solver,
    /// Where it stands at first, m; from there the feet bring it until trackers have seen it.
    #[state(keep)]
    start_m: Vector3<f64>,
    /// The hips' mid-point where trackers last saw it, m.
    pelvis_m: Option<Vector3<f64>>,
    tracked: Vec<Tracked>,
    anchors: Vec<Anchor>,
    out: Body,
}

/// A magnetic tracker on the body.
#[derive(Clone, Copy, Debug, Plain)]
struct BodyTracker {
    sensor: SensorIndex,
    segment: BodySegment,
    /// Sensor to segment.
    segment_from_sensor: Isometry3<f64>,
    /// Whether it is known how it is turned there; beside IMUs its place alone counts if it is not.
    is_turn_known: bool,
}

/// How the body is found.
#[derive(Clone, Debug, Plain)]
enum Solver {
    /// It is not known how the sensors sit.
    Waiting,
    Imus(Box<BodyFilter>),
    Trackers(Box<Follower>),
}

impl BodyStage {
    /// `None` where this body is no human one, or wears no sensor.
    pub(super) fn new(stage: &Stage, index: BodyIndex) -> Result<Option<Self>, PipelineError> {
        let body = &stage.bodies[usize::from(index)];
        if body.skeleton != posed_stage::Skeleton::Human {
            return Ok(None);
        }
        let wearers = Wearers::of(stage, index).map_err(|sensors| PipelineError::SameSegment { sensors })?;
        if wearers == Wearers::default() {
            return Ok(None);
        }
        let lacks = PipelineError::Value { key: "body.height_m", expected: "the person's height, m" };
        let skeleton = skeleton_of(body).ok_or(lacks)?;
        let [start_x_m, start_y_m] = start_of(stage, index);
        let given = body.mounting == Mounting::Given;
        let mut trackers = Vec::with_capacity(wearers.trackers.len());
        let mut rotations_known = true;
        for (index, segment) in &wearers.trackers {
            let sensor = &stage.sensors[usize::from(*index)];
            let rotation = sensor.mount_quat_wxyz.and_then(orientation_from_wxyz);
            rotations_known &= rotation.is_some();
            let position_m = sensor.offset_m.map_or_else(|| skeleton.usual_sensor_m(*segment), Vector3::from);
            let segment_from_sensor = Isometry3::from_parts(position_m.into(), rotation.unwrap_or_default());
            trackers.push(BodyTracker {
                sensor: *index,
                segment: *segment,
                segment_from_sensor,
                is_turn_known: rotation.is_some(),
            });
        }
        let segments = wearers.segments().len();
        let imus = wearers.imus;
        let field = all_have_field(stage, &imus);
        let solver = if imus.iter().any(Option::is_some) {
            if given {
                Solver::imus(&skeleton, &mounting(stage, &imus, &skeleton)?, field)
            } else {
                Solver::Waiting
            }
        } else if rotations_known {
            Solver::Trackers(Box::new(Follower::new(skeleton)))
        } else {
            Solver::Waiting
        };
        Ok(Some(Self {
            skeleton,
            resets_by_button: body.reset_by_button,
            tapped: body.reset_by_double_tap.as_deref().and_then(BodySegment::named),
            taps: DoubleTap::default(),
            tapped_now: None,
            wearing: wearing(&imus, &trackers),
            tracked: Vec::with_capacity(trackers.len()),
            anchors: Vec::with_capacity(trackers.len()),
            trackers,
            epochs: Epochs::new(imus, field),
            solver,
            start_m: Vector3::from([start_x_m, start_y_m, 0.0]),
            pelvis_m: None,
            out: Body::unknown(index, segments),
        }))
    }

    /// Takes a closed frame; the body, if there is news of it.
    pub(super) fn frame(&mut self, frame: &Frame, estimate: &Estimate) -> Option<&Body> {
        match &mut self.solver {
            Solver::Waiting => return None,
            Solver::Imus(filter) => {
                let mut t = None;
                let tapped = self.tapped.map(BodySegment::index);
                let mut is_tapped = false;
                self.epochs.frame(frame, |Epoch { t: at, dt_s, samples, ages_s }| {
                    filter.push_aged(samples, ages_s, *dt_s);
                    if let Some(sample) = tapped.and_then(|segment| samples[segment].as_ref()) {
                        is_tapped |= self.taps.push(sample, *dt_s);
                    }
                    t = Some(*at);
                });
                if is_tapped {
                    self.tapped_now = tapped.and_then(|segment| self.wearing[segment]);
                }
                self.out.t_valid = t?;
                self.wearing = wearing(&self.worn(), &self.trackers);
                self.place(estimate);
            }
            Solver::Trackers(follower) => {
                self.tracked.clear();
                for tracker in &self.trackers {
                    let Some(pose) = shown(estimate, tracker.sensor)
                        .and_then(|pose| isometry(pose.position_m?, pose.orientation_wxyz))
                    else {
                        continue;
                    };
                    let BodyTracker { segment, segment_from_sensor, .. } = *tracker;
                    self.tracked.push(Tracked { segment, room_from_sensor: pose, segment_from_sensor });
                }
                let figure = follower.push(&self.tracked)?;
                self.out.t_valid = estimate.t_valid;
                self.follow(&figure);
            }
        }
        Some(&self.out)
    }

    /// Takes how the sensors sit, and where; `index` finds one by its name. False where one of them is not on the body, one of the
    /// body is left out, two IMUs are on one segment, or a segment that wore none has one.
    pub(super) fn mount(
        &mut self,
        sensors: &[MountedSensor],
        index: impl Fn(&str) -> Option<SensorIndex>,
    ) -> bool {
        let mut all = [None; SEGMENTS];
        let mut imus = [None; SEGMENTS];
        let mut trackers = self.trackers.clone();
        let mut tracked = 0;
        for mounted in sensors {
            let (Some(sensor), Some(pose)) =
                (index(&mounted.sensor), isometry(mounted.offset_m, mounted.mount_quat_wxyz))
            else {
                return false;
            };
            let was = self.epochs.imus().iter().position(|imu| *imu == Some(sensor));
            let found = mounted.segment.as_deref().and_then(BodySegment::named);
            let mut trackers = trackers.iter_mut();
            let tracker = trackers.find(|tracker| {
                tracker.sensor == sensor && found.is_none_or(|found| found == tracker.segment)
            });
            if let Some(was) = was {
                let segment = found.map_or(was, BodySegment::index);
                let offset_m = pose.translation.vector;
                let sigma_rad = mounted
                    .sigma_deg
                    .map_or_else(Vector3::zeros, |sigma_deg| Vector3::from(sigma_deg).map(f64::to_radians));
                all[segment] = Some(SensorMount { sigma_rad, ..SensorMount::exact(pose.rotation, offset_m) });
                if imus[segment].replace(sensor).is_some() {
                    return false;
                }
            } else if let Some(tracker) = tracker {
                tracker.segment_from_sensor = pose;
                tracker.is_turn_known = true;
                tracked += 1;
            } else {
                return false;
            }
        }
        // The same sensors on the same segments, if in another order.
        let mut known = self.epochs.imus().iter().zip(&imus);
        if known.any(|(was, is)| was.is_some() != is.is_some() || (was.is_some() && !imus.contains(was))) {
            return false;
        }
        if imus.iter().any(Option::is_some) {
            self.epochs.wear(imus);
            self.solver = Solver::imus(&self.skeleton, &all, self.epochs.field());
        } else if tracked == trackers.len() {
            self.solver = Solver::Trackers(Box::new(Follower::new(self.skeleton)));
        } else {
            return false;
        }
        self.wearing = wearing(&imus, &trackers);
        self.trackers = trackers;
        self.pelvis_m = None;
        true
    }

    /// A sensor's samples are corrected otherwise from now on: a body that wears it begins anew.
    pub(super) fn restart(&mut self, sensor: SensorIndex) {
        if let Solver::Imus(filter) = &self.solver
            && self.epochs.imus().contains(&Some(sensor))
        {
            self.solver = Solver::imus(&self.skeleton, &filter.mounts(), self.epochs.field());
        }
    }

    /// Whether the heading of this IMU, or of any, is held by gyros alone.
    pub(super) fn drifts(&self, sensor: Option<SensorIndex>) -> bool {
        let Solver::Imus(filter) = &self.solver else { return false };
        self.on_body(sensor).any(|segment| filter.drifts(segment))
    }

    /// Whether a tracker's button means that headings begin anew.
    pub(super) fn resets_by_button(&self) -> bool {
        self.resets_by_button
    }

    /// The sensor that was tapped twice since this was asked last, if any.
    pub(super) fn take_tapped(&mut self) -> Option<SensorIndex> {
        self.tapped_now.take()
    }

    /// The person looks so far to the left of the room's x, rad: the headings of this IMU, or of all, that no field identifies begin anew. False where there is none.
    pub(super) fn reset_heading(&mut self, sensor: Option<SensorIndex>, heading_rad: f64) -> bool {
        let mut only = [false; SEGMENTS];
        self.on_body(sensor).for_each(|segment| only[segment.index()] = true);
        let Solver::Imus(filter) = &mut self.solver else { return false };
        filter.reset_heading(&only, heading_rad)
    }

    /// The IMU on each segment, as movements have shown it: another one than was said where two were swapped.
    fn worn(&self) -> [Option<SensorIndex>; SEGMENTS] {
        let imus = self.epochs.imus();
        match &self.solver {
            Solver::Imus(filter) => filter.taken_from().map(|from| imus[from]),
            _ => *imus,
        }
    }

    /// Segments that wear this IMU, or any.
    fn on_body(&self, sensor: Option<SensorIndex>) -> impl Iterator<Item = BodySegment> + use<> {
        let imus = self.worn();
        BodySegment::ALL.into_iter().filter(move |segment| match (imus[segment.index()], sensor) {
            (Some(worn), Some(asked)) => worn == asked,
            (worn, _) => worn.is_some(),
        })
    }

    /// Where the feet have brought the trackers that the body wears since those were heard, room, m, as of the latest body: empty while they say where it is,
    /// and before they ever have.
    pub(super) fn brought_by_feet(&self) -> impl Iterator<Item = (SensorIndex, Vector3<f64>)> {
        let goes = self.pelvis_m.is_some() && self.out.position_source == PositionSource::Feet;
        self.trackers.iter().filter(move |_| goes).filter_map(|tracker| {
            let segment = &self.out.segments[tracker.segment.index()];
            let at = isometry(segment.position_m?, segment.orientation_wxyz?)?;
            Some((tracker.sensor, (at * tracker.segment_from_sensor).translation.vector))
        })
    }

    /// The latest body; none before the first.
    pub(super) fn latest(&self) -> Option<&Body> {
        (self.out.segments.iter().any(|segment| segment.state != SegmentState::Missing)).then_some(&self.out)
    }

    /// The segments that its bodies have, in their order.
    pub(super) fn segments(&self) -> &'static [BodySegment] {
        &BodySegment::ALL[..self.out.segments.len()]
    }

    /// The IMU on each segment, as far as it is known by now.
    pub(super) fn imus(&self) -> &[Option<SensorIndex>; SEGMENTS] {
        self.epochs.imus()
    }

    /// Whether it is known how the sensors sit.
    pub(super) fn is_mounted(&self) -> bool {
        !matches!(self.solver, Solver::Waiting)
    }

    /// What is wrong with the sensors on it.
    pub(super) fn faults(&self) -> impl Iterator<Item = (SensorIndex, &'static str, Cause)> {
        let ill = |segment: BodySegment| {
            let fault = self.out.segments.get(segment.index())?.fault?;
            Some((self.wearing[segment.index()]?, segment.name(), fault))
        };
        BodySegment::ALL.into_iter().filter_map(ill)
    }

    /// Fills in what IMUs show, and trackers beside them.
    fn place(&mut self, estimate: &Estimate) {
        let Solver::Imus(filter) = &mut self.solver else { return };
        self.anchors.clear();
        self.anchors.extend(self.trackers.iter().filter_map(|tracker| {
            let pose = shown(estimate, tracker.sensor)?;
            let sits = &tracker.segment_from_sensor;
            let [sigma_m, sigma_rad] = sigmas(pose);
            let turned = orientation_from_wxyz(pose.orientation_wxyz).filter(|_| tracker.is_turn_known);
            Some(Anchor {
                segment: tracker.segment,
                offset_m: sits.translation.vector,
                position_m: Vector3::from(pose.position_m?),
                sigma_m,
                orientation: turned
                    .filter(|_| sigma_rad < UNTURNED_RAD)
                    .map(|turned| (turned * sits.rotation.inverse(), sigma_rad)),
            })
        }));
        let anchored = filter.anchor(&self.anchors);
        let (found, learnt, skeleton) = (filter.estimate(), filter.learnt(), filter.skeleton());
        let all = found.posture;
        let from_hips = skeleton.origins_m(&all, Vector3::zeros());
        if let Some((pelvis_m, _)) = anchored {
            self.pelvis_m = Some(pelvis_m);
        }
        let begun_m = if self.pelvis_m.is_none() { self.start_m } else { Vector3::zeros() };
        let (pelvis_m, position_source) = match (self.pelvis_m, found.travel) {
            (Some(pelvis_m), _) if anchored.is_some() => (pelvis_m, PositionSource::Trackers),
            (_, Some(travel)) if travel.contacts.is_some() => {
                (begun_m + travel.pelvis_m, PositionSource::Feet)
            }
            (_, Some(travel)) => (begun_m + travel.pelvis_m, PositionSource::Held),
            (Some(pelvis_m), None) => (pelvis_m, PositionSource::Held),
            (None, None) => (begun_m + found.pelvis_m(skeleton), PositionSource::Origin),
        };
        self.out.position_source = position_source;
        self.out.position_sigma_m = match position_source {
            PositionSource::Trackers => anchored.map(|(_, sigma_m)| sigma_m),
            PositionSource::Feet => found.travel.map(|travel| travel.sigma_m),
            PositionSource::Held | PositionSource::Origin => None,
        };
        self.out.contacts = found.travel.and_then(|travel| travel.contacts);
        self.out.heading = found.heading;
        let is_known = found.heading != Heading::Unknown;
        self.out.heading_sigma_rad = is_known.then_some(found.heading_sigma_rad);
        self.out.angles_rad = found.angles_rad;
        self.out.spread = found.spread;
        for (segment, out) in BodySegment::ALL.into_iter().zip(&mut self.out.segments) {
            let index = segment.index();
            let inferred = is_inferred(segment, &self.wearing, &found.orientations);
            let shown = found.orientations[index].or(inferred.then_some(all[index]));
            let fault = found.faults[index];
            let state = match (shown, fault) {
                (None, _) => SegmentState::Missing,
                // It counts where it sits.
                (Some(_), Some(Cause::Swapped)) => SegmentState::Ok,
                (Some(_), Some(_)) => SegmentState::Suspect,
                (Some(_), None) if self.wearing[index].is_none() => SegmentState::Inferred,
                (Some(_), None) => SegmentState::Ok,
            };
            *out = SegmentEstimate {
                state,
                fault,
                sensor: self.wearing[index],
                position_m: shown.map(|_| (pelvis_m + from_hips[index]).into()),
                orientation_wxyz: shown.as_ref().map(orientation_to_wxyz),
                sigma_rad: found.sigma_rad[index],
                learnt: learnt[index],
            };
        }
    }

    /// Fills in what trackers alone show.
    fn follow(&mut self, figure: &Figure) {
        let origins = self.skeleton.origins_m(&figure.orientations, figure.pelvis_m);
        self.out.position_source = PositionSource::Trackers;
        self.out.position_sigma_m = Some(TRACKED_M);
        self.out.contacts = None;
        self.out.heading = Heading::Field;
        self.out.heading_sigma_rad = Some(TRACKED_RAD);
        self.out.angles_rad = angles(&figure.orientations.map(Some));
        for (segment, out) in BodySegment::ALL.into_iter().zip(&mut self.out.segments) {
            let index = segment.index();
            let seen = self.tracked.iter().any(|tracked| tracked.segment == segment);
            let tracked = self.trackers.iter().any(|tracker| tracker.segment == segment);
            let (state, fault) = match (seen, tracked) {
                (true, _) => (SegmentState::Ok, None),
                (false, true) => (SegmentState::Suspect, Some(Cause::Missing)),
                (false, false) => (SegmentState::Inferred, None),
            };
            *out = SegmentEstimate {
                state,
                fault,
                sensor: self.wearing[index],
                position_m: Some(origins[index].into()),
                orientation_wxyz: Some(orientation_to_wxyz(&figure.orientations[index])),
                sigma_rad: if seen { TRACKED_RAD } else { BETWEEN_RAD },
                learnt: None,
            };
        }
        for segment in BodySegment::ALL.into_iter().take(self.out.segments.len()) {
            let Some(parent) = segment.parent() else { continue };
            let of = |segment: BodySegment| self.out.segments[segment.index()].sigma_rad.powi(2);
            let [above, q] = [parent, segment].map(|of| figure.orientations[of.index()]);
            let rotation_rad2 = Matrix3::identity() * (of(parent) + of(segment));
            self.out.spread.set(segment, &(above.inverse() * q), &rotation_rad2);
        }
    }
}

impl Solver {
    fn imus(skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS], field: bool) -> Self {
        let mut filter = BodyFilter::new(skeleton, mounts, &BodyParams::default());
        if field {
            filter.await_field();
        }
        Self::Imus(Box::new(filter))
    }
}

/// Whether a segment without a sensor follows from what is known: a limb of which no segment wears one does not.
fn is_inferred(
    segment: BodySegment,
    wearing: &[Option<SensorIndex>; SEGMENTS],
    known: &[Option<UnitQuaternion<f64>>; SEGMENTS],
) -> bool {
    let worn = |segment: &BodySegment| wearing[segment.index()].is_some();
    let mut limbs = [BodySegment::ARMS, BodySegment::LEGS].into_iter().filter(|limb| limb.contains(&segment));
    let hangs = limbs.all(|limb| limb.iter().any(|of| of.side() == segment.side() && worn(of)));
    !worn(&segment) && hangs && known.iter().any(Option::is_some)
}

/// The sensor of each segment that is asked first: an IMU, else a tracker.
fn wearing(
    imus: &[Option<SensorIndex>; SEGMENTS],
    trackers: &[BodyTracker],
) -> [Option<SensorIndex>; SEGMENTS] {
    BodySegment::ALL.map(|segment| {
        let tracker = trackers.iter().find(|tracker| tracker.segment == segment);
        imus[segment.index()].or(tracker.map(|tracker| tracker.sensor))
    })
}

/// How a sensor sits on `segment`, as the stage file specifies: `mount_quat_wxyz`, sensor to segment, and `offset_m`, segment
/// frame, m; where that is absent, the usual place on a segment of this skeleton ([`Skeleton::usual_sensor_m`]). It does not look
/// whether the sensor sits on that segment. `None` where the file does not say how it is turned.
pub fn sensor_mount(
    sensor: &posed_stage::Sensor,
    segment: BodySegment,
    skeleton: &Skeleton,
) -> Option<SensorMount> {
    let q_segment_sensor: UnitQuaternion<f64> = orientation_from_wxyz(sensor.mount_quat_wxyz?)?;
    let offset_m = sensor.offset_m.map_or_else(|| skeleton.usual_sensor_m(segment), Vector3::from);
    Some(SensorMount::exact(q_segment_sensor, offset_m))
}

/// The mountings that a stage file gives.
fn mounting(
    stage: &Stage,
    imus: &[Option<SensorIndex>; SEGMENTS],
    skeleton: &Skeleton,
) -> Result<[Option<SensorMount>; SEGMENTS], PipelineError> {
    let mut all = [None; SEGMENTS];
    for segment in BodySegment::ALL {
        let Some(index) = imus[segment.index()] else { continue };
        let mount = sensor_mount(&stage.sensors[usize::from(index)], segment, skeleton);
        let lacks = PipelineError::Value {
            key: "sensor.mount_quat_wxyz",
            expected: "a quaternion for each sensor on the body, since its mounting is given",
        };
        all[segment.index()] = Some(mount.ok_or(lacks)?);
    }
    Ok(all)
}

/// Whether all of these sensors measure a field that their heading may follow: their driver sends one, and `magnetometer` of the
/// stage file is not false. True where there is no sensor.
///
/// # Panics
/// An index is that of no sensor of the stage.
pub fn all_have_field(stage: &Stage, imus: &[Option<SensorIndex>; SEGMENTS]) -> bool {
    imus.iter().flatten().all(|index| has_field(stage, *index))
}

/// Standard deviations of a pose along an axis, m, and about an axis, rad.
fn sigmas(pose: &PoseEstimate) -> [f64; 2] {
    // The diagonal of an upper triangle of six rows.
    let of = |diagonal: [usize; 3]| (diagonal.map(|at| pose.covariance[at]).iter().sum::<f64>() / 3.0).sqrt();
    [of([0, 6, 11]), of([15, 18, 20])]
}

/// The pose of a tracker that may be used, or that its IMU carries on.
fn shown(estimate: &Estimate, sensor: SensorIndex) -> Option<&PoseEstimate> {
    let sensor = estimate.sensors.get(usize::from(sensor))?;
    sensor.pose.as_ref().filter(|_| sensor.state.is_usable() || sensor.coasted)
}

fn has_field(stage: &Stage, index: SensorIndex) -> bool {
    let sensor = &stage.sensors[usize::from(index)];
    let device = stage.devices.iter().find(|device| device.name == sensor.device);
    sensor.magnetometer && device.is_some_and(|device| device.driver.measures_field())
}
