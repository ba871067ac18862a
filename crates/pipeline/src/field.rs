//! The field in the pipeline: correct between faults and fusion, watch for disturbances, collect a guided run.
//!
//! What comes in: measured poses in the transmitter frame, labelled by faults; requests and maps from the log. What goes
//! out: corrected poses with what the map leaves of them; warnings and progress. What it never does: solve (that is a
//! job of its own), or learn while the field is disturbed. Without a map and a watch it costs nothing.
//!
//! It and [`super::sensor`] use one another: a sensor has its poses corrected here, and the watch here asks the sensors for what they believe.

use nalgebra::{Isometry3, UnitQuaternion};
use posed_drivers::Timestamp;
use posed_state::{Plain, State};

use super::sensor::Sensor;
use posed_field::{Corrector, Guide, PoleRun, Prepared, Warning, Watch, WatchSettings, WatchedPosition};
use posed_fusion::faults::{MeasuredPose, Prediction};
use posed_stage::Stage;
use posed_stage::input::Request;
use posed_stage::output::{Estimate, FieldNews, Outcome, OutcomeKind, Output};

/// Frequency of the mains unless the stage file specifies otherwise, Hz.
const MAINS_HZ: f64 = 50.0;

/// A corrected pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corrected {
    pub(super) pose: MeasuredPose,
    /// What the map leaves of the position, 3-D rms, m.
    pub(super) sigma_m: f64,
    pub(super) extrapolated: bool,
}

#[derive(Clone, Debug, Plain)]
struct Collecting {
    /// Indices in the stage, in the order along the pole.
    sensors: Vec<usize>,
    guide: Guide,
}

/// State of the stage's field.
#[derive(Clone, Debug, State)]
pub(super) struct Field {
    #[state(keep)]
    map: Option<Prepared>,
    watch: Option<Watch>,
    collecting: Option<Collecting>,
}

impl Field {
    pub(super) fn new(stage: &Stage) -> Self {
        let index = |name: &String| stage.sensors.iter().position(|sensor| sensor.name == *name);
        let watch = stage.field.as_ref().map(|field| {
            let pair = |pair: &[String; 2]| Some([index(&pair[0])?, index(&pair[1])?]);
            Watch::new(&WatchSettings {
                reference_sensors: field.reference_sensors.iter().filter_map(index).collect(),
                pairs: field.rigid_pairs.iter().filter_map(pair).collect(),
                mains_hz: field.mains_hz.unwrap_or(MAINS_HZ),
            })
        });
        Self { map: None, watch, collecting: None }
    }

    /// Swaps the map in; the watch begins anew.
    pub(super) fn swap(&mut self, map: Option<Prepared>) {
        self.map = map;
        if let Some(watch) = &mut self.watch {
            watch.reset();
        }
    }

    fn corrector(&self) -> Option<&Corrector> {
        self.map.as_ref().map(Prepared::corrector)
    }

    /// Corrects a pose; one without a position, or without a map, stays as it is.
    pub(super) fn correct(&self, pose: &MeasuredPose) -> Corrected {
        let unchanged = Corrected { pose: *pose, sigma_m: 0.0, extrapolated: false };
        let (Some(corrector), Some(z)) = (self.corrector(), &pose.position_m) else { return unchanged };
        let corrected = corrector.correct(z);
        let orientation = pose.orientation.map(|orientation| corrector.orientation(z, &orientation));
        Corrected {
            pose: MeasuredPose { position_m: Some(corrected.position_m), orientation },
            sigma_m: corrected.map_sigma_m,
            extrapolated: corrected.extrapolated,
        }
    }

    /// What is expected of a measurement before its correction: faults look at what the device reports.
    pub(super) fn uncorrected(&self, expected: Prediction) -> Prediction {
        let Some(corrector) = self.corrector() else { return expected };
        let z = corrector.reading(&expected.position_m);
        let rotation = corrector.orientation(&z, &UnitQuaternion::identity());
        Prediction { position_m: z, orientation: rotation.inverse() * expected.orientation, ..expected }
    }

    /// What a disturbance may do to a sensor, per axis, m^2; `None` while there is none.
    pub(super) fn doubt_m2(&self, range_m: f64) -> Option<f64> {
        let watch = self.watch.as_ref().filter(|watch| watch.is_disturbed())?;
        Some(watch.doubt_m2(range_m))
    }

    /// Carries out a request about the field; the end of a run hands its recording out. False for any other request, and
    /// for a pole that this stage does not have.
    pub(super) fn request<'a>(
        &mut self,
        request: &Request,
        t: Timestamp,
        names: impl Iterator<Item = &'a str> + Clone,
        emit: &mut dyn FnMut(Output<'_>),
    ) -> bool {
        match request {
            Request::FieldStart { sensors, spacing_m } => {
                let index = |name: &String| names.clone().position(|known| known == name);
                let Some(indices) = sensors.iter().map(index).collect::<Option<Vec<usize>>>() else {
                    return false;
                };
                if !(spacing_m.is_finite() && *spacing_m > 0.0) {
                    return false;
                }
                let mut guide = Guide::new(sensors.clone(), *spacing_m);
                report(t, FieldNews::Progress(guide.progress(true)), emit);
                self.collecting = Some(Collecting { sensors: indices, guide });
            }
            Request::FieldFinish {} => {
                let mut collected = self.collecting.take();
                if let Some(Collecting { guide, .. }) = &mut collected {
                    report(t, FieldNews::Progress(guide.progress(false)), emit);
                }
                let nothing = PoleRun { sensors: Vec::new(), spacing_m: 0.0, frames: Vec::new() };
                emit(Output::PoleRun(collected.as_ref().map_or(&nothing, |collected| collected.guide.run())));
            }
            Request::ExerciseSelect { .. }
            | Request::ExerciseReset { .. }
            | Request::HeadingReset { .. }
            | Request::Mark { .. } => return false,
        }
        true
    }

    /// Takes a closed frame, after all sensors were estimated.
    pub(super) fn frame(
        &mut self,
        estimate: &Estimate,
        sensors: &[Sensor],
        room: &Isometry3<f64>,
        emit: &mut dyn FnMut(Output<'_>),
    ) {
        let t = estimate.t_valid;
        let Self { watch, collecting, .. } = self;
        if let Some(watch) = watch {
            let seen = |index: usize| seen(index, estimate, sensors, room);
            watch.push(t.as_secs_f64(), seen, &mut |warning: Warning| {
                report(t, FieldNews::Warning(warning), emit);
            });
        }
        let disturbed = watch.as_ref().is_some_and(Watch::is_disturbed);
        if let Some(Collecting { sensors: along, guide }) = collecting
            && !disturbed
        {
            let reading = |slot: usize| sensors.get(along[slot])?.pole_reading(t);
            guide.push(t.as_secs_f64(), reading, &mut |progress| {
                report(t, FieldNews::Progress(progress), emit);
            });
        }
    }
}

fn report(t: Timestamp, news: FieldNews, emit: &mut dyn FnMut(Output<'_>)) {
    let what = OutcomeKind::Field(news);
    emit(Output::Outcome(&Outcome { t_valid: t, t_decided: t, what }));
}

/// Where the watch sees a sensor: in the transmitter frame, where the map is.
fn seen(index: usize, estimate: &Estimate, sensors: &[Sensor], room: &Isometry3<f64>) -> WatchedPosition {
    let Some(sensor) = sensors.get(index) else { return WatchedPosition::default() };
    let pose = estimate.sensors.get(index).and_then(|estimate| estimate.pose.as_ref());
    let placed = pose.and_then(|pose| pose.position_m);
    let tracked = placed.map(|position_m| room.inverse_transform_point(&position_m.into()).coords);
    WatchedPosition {
        measured_m: sensor.corrected_m(),
        tracked_m: tracked.filter(|_| sensor.corrected_m().is_some()),
        sigma_m: pose.and_then(|pose| pose.sigma_m).unwrap_or(0.0),
    }
}

/// The time between a record and a frame over which a reading is carried along, s.
pub(super) fn ahead_s(from: Timestamp, to: Timestamp) -> f64 {
    to.seconds_since(from).clamp(-0.05, 0.05)
}
