//! `body.calibrate`: guides a person through poses and movements, and finds how the sensors sit.
//!
//! In: samples from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's message; in
//! the end a mounting for the pipeline, with who sits where if that was asked too, or one sentence about what to repeat. A mounting
//! that is not good is not used.

use serde_json::{Map, Value, json};

use super::super::fusion::{Command, FusionInbox};
use super::super::jobs::{Failure, Job};
use super::super::observers::BodySource;
use super::super::server::{Refusal, Reply};
use super::Calls;
use super::guided::{self, Guided};
use posed_fusion::body::assign;
use posed_fusion::body::{Block, BlockKind, Calibrated, CalibrationError, Recorded, calibrate};
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton};
use posed_fusion::body::{Guide, Places, Thoroughness, Trackers};
use posed_geometry::orientation_to_wxyz;
use posed_pipeline::all_have_field;
use posed_protocol::RefusalReason;
use posed_stage::input::{Model, MountedSensor, SensorIndex};
use posed_stage::layout::{ChainLayout, Wearers, offset_on, segment_of, skeleton_of};
use posed_stage::{BodyIndex, Stage, body_named};

impl Calls {
    /// Begins a calibration.
    pub(super) fn calibrate_body(&self, body: Option<&str>, how: Thoroughness, reply: Reply) {
        let index = match self.body(body) {
            Ok(index) => index,
            Err(refusal) => return reply.refuse(refusal),
        };
        if let Some(layout) = ChainLayout::of(&self.stage, index) {
            return self.calibrate_chain(self.one_of_several(index), layout, reply);
        }
        match self.wearer(index, how) {
            Ok(session) => self.jobs.run("body.calibrate", reply, move |job| session.run(job)),
            Err(refusal) => reply.refuse(refusal),
        }
    }

    /// The body of that name, or the only one.
    pub(super) fn body(&self, name: Option<&str>) -> Result<BodyIndex, Refusal> {
        let names = self.stage.body_names();
        body_named(names.clone(), name).map_err(|_| match self.stage.bodies.is_empty() {
            true => Refusal::new("no_body", "this stage has no [[body]]").because(RefusalReason::NoBody),
            false => {
                Refusal::bad_request(format!("body: name one of {}", names.collect::<Vec<_>>().join(", ")))
            }
        })
    }

    /// A body's name where models must name it.
    fn one_of_several(&self, body: BodyIndex) -> Option<String> {
        let bodies = &self.stage.bodies;
        (bodies.len() > 1).then(|| bodies[usize::from(body)].name.clone())
    }

    /// Who wears IMUs; a sentence where there is nobody to calibrate.
    fn wearer(&self, index: BodyIndex, how: Thoroughness) -> Result<Session, Refusal> {
        let body = self.stage.bodies.get(usize::from(index));
        let body = body.filter(|body| body.skeleton == posed_stage::Skeleton::Human);
        let no_body = |reason| Refusal::new("no_body", reason);
        let skeleton = body.and_then(skeleton_of);
        let skeleton = skeleton.ok_or_else(|| no_body("this stage has no human [[body]] with `height_m`"))?;
        let wearers = Wearers::of(&self.stage, index).unwrap_or_default();
        if wearers.imus.iter().all(Option::is_none) {
            return Err(no_body("this stage has no IMU on a segment of the body"));
        }
        let magnetic = all_have_field(&self.stage, &wearers.imus);
        let mut trackers = [None; SEGMENTS];
        for (tracker, segment) in wearers.trackers {
            trackers[segment.index()].get_or_insert(tracker);
        }
        let (stage, inbox) = (self.stage.clone(), self.inbox.clone());
        let name = self.one_of_several(index);
        Ok(Session { stage, index, name, skeleton, magnetic, how, trackers, inbox })
    }
}

/// The IMU on each segment.
type BodyImus = [Option<SensorIndex>; SEGMENTS];

/// A calibration at work.
struct Session {
    stage: Stage,
    index: BodyIndex,
    /// Its name, where there are several.
    name: Option<String>,
    skeleton: Skeleton,
    magnetic: bool,
    how: Thoroughness,
    /// The magnetic tracker on each segment.
    trackers: [Option<SensorIndex>; SEGMENTS],
    inbox: FusionInbox,
}

impl Session {
    fn run(self, job: &Job) -> Result<String, Failure> {
        let imus = self.inbox.ask(|to| Command::BodyImus { body: self.index, to })?;
        let offsets_m = BodySegment::ALL.map(|segment| {
            let tracker = self.trackers[segment.index()]?;
            let known_m = offset_on(&self.stage.sensors[usize::from(tracker)], segment);
            Some(known_m.unwrap_or_else(|| self.skeleton.usual_sensor_m(segment)))
        });
        let guide = Guide::new(imus.map(|imu| imu.is_some()), self.magnetic, self.how)
            .with_trackers(Trackers::new(self.skeleton, offsets_m));
        let names = imus.map(|imu| imu.map(|imu| self.name(imu).to_owned()));
        let mut guided = Body { guide, names, reported: None };
        let source = BodySource::new(imus, self.trackers, self.magnetic);
        guided::run(&mut guided, job, &self.inbox, source)?;
        self.solve(job, imus, &guided.guide)
    }

    fn solve(&self, job: &Job, taken_for: BodyImus, guide: &Guide) -> Result<String, Failure> {
        let (recording, blocks) = guide.recorded();
        let again = |error: &dyn std::fmt::Display| Failure::from(format!("{error}; begin again"));
        let mut imus = taken_for;
        let found = if self.how == Thoroughness::Assign {
            let assignment = assign(recording, blocks).map_err(|error| again(&error))?;
            imus = assignment.place(&taken_for);
            self.calibrate(&assignment.placed(recording), blocks, &imus)
        } else {
            self.calibrate(recording, blocks, &imus)
        };
        let found = found.map_err(|error| again(&error))?;
        let has_mounting =
            |imu| imus.iter().zip(&found.mounts).any(|(at, sits)| *at == Some(imu) && sits.is_some());
        if let Some(lost) = taken_for.into_iter().flatten().find(|imu| !has_mounting(*imu)) {
            return Err(again(&format!("{} sent nothing; see to it", self.name(lost))));
        }
        let quality = self.by_segment(|segment| json!(found.quality_deg[segment.index()]));
        let sensors = self.by_segment(|segment| json!(imus[segment.index()].map(|imu| self.name(imu))));
        job.result(json!({ "quality_deg": quality, "sensors": sensors }));
        if !found.warnings.is_empty() {
            return Err(again(&found.warnings.join("; ")));
        }
        let worst = BodySegment::ALL
            .into_iter()
            .filter_map(|segment| Some((segment, found.quality_deg[segment.index()]?)))
            .max_by(|(_, a), (_, b)| a.total_cmp(b));
        let sensors = self.mounted(&imus, &found);
        self.inbox.command(Command::load(Model::Mounting { body: self.name.clone(), sensors }));
        let worst = worst.map_or_else(String::new, |(segment, quality_deg)| {
            format!("; the worst is {} with {quality_deg:.1} degrees", segment.name())
        });
        Ok(format!("the sensors' mounting is known{worst}{}", self.reported(&imus)))
    }

    fn calibrate(
        &self,
        recording: &[Recorded],
        blocks: &[Block],
        imus: &BodyImus,
    ) -> Result<Calibrated, CalibrationError> {
        let offsets_m = BodySegment::ALL
            .map(|segment| offset_on(&self.stage.sensors[usize::from(imus[segment.index()]?)], segment));
        calibrate(recording, blocks, &self.skeleton, &offsets_m)
    }

    fn name(&self, imu: SensorIndex) -> &str {
        &self.stage.sensors[usize::from(imu)].name
    }

    /// What there is to say of each segment.
    fn by_segment(&self, emit: impl Fn(BodySegment) -> Value) -> Map<String, Value> {
        let emitted = BodySegment::ALL.into_iter().map(|segment| (segment.name().to_owned(), emit(segment)));
        emitted.filter(|(_, value)| !value.is_null()).collect()
    }

    /// Who does not sit where the stage file has it.
    fn reported(&self, imus: &BodyImus) -> String {
        let elsewhere: Vec<String> = BodySegment::ALL
            .into_iter()
            .filter_map(|segment| {
                let sensor = &self.stage.sensors[usize::from(imus[segment.index()]?)];
                let moved = segment_of(sensor) != Some(segment);
                moved.then(|| format!("{} sits on {}", sensor.name, segment.name()))
            })
            .collect();
        match (elsewhere.is_empty(), self.how) {
            (false, _) => format!("; {}: the stage file has another segment", elsewhere.join(", ")),
            (true, Thoroughness::Movement) => {
                "; to some degrees as yet, as `learnt` of the body says: it gets better as you move".into()
            }
            (true, Thoroughness::Assign) => "; every sensor sits where the stage file has it".into(),
            (true, Thoroughness::Quick) => {
                "; which sensor sits where was taken from the stage file, as two poses do not show it".into()
            }
            (true, _) => String::new(),
        }
    }

    fn mounted(&self, imus: &BodyImus, found: &Calibrated) -> Vec<MountedSensor> {
        let mounted = |segment: BodySegment| {
            let mounting = found.mounts[segment.index()]?;
            Some(MountedSensor {
                sensor: self.name(imus[segment.index()]?).to_owned(),
                segment: Some(segment.name().to_owned()),
                mount_quat_wxyz: orientation_to_wxyz(&mounting.q_segment_sensor),
                offset_m: mounting.offset_m.into(),
                // To a thousandth: it is written into the log.
                sigma_deg: Some(
                    mounting.sigma_rad.map(|sigma| (sigma.to_degrees() * 1e3).round() / 1e3).into(),
                ),
            })
        };
        BodySegment::ALL.into_iter().filter_map(mounted).collect()
    }
}

/// What is done, and the step that was reported last, with the objections by then and who was silent.
struct Body {
    guide: Guide,
    /// Names of the IMUs, by the segments that they were taken to sit on.
    names: [Option<String>; SEGMENTS],
    reported: Option<(usize, usize, String)>,
}

impl Guided for Body {
    type Source = BodySource;
    const NAME: &'static str = "calibration";
    const UNCHANGED: &'static str = "the sensors count as they did before";
    const LONGEST_S: f64 = Guide::LONGEST_S;

    fn prompt(&self) -> Option<String> {
        self.guide.prompt().map(str::to_owned)
    }

    fn report(&mut self, job: &Job, prompt: &str) {
        let (done, steps) = self.guide.progress();
        let (objections, objection) = self.guide.objection();
        let name = |segment: BodySegment| self.names[segment.index()].as_deref().unwrap_or(segment.name());
        let silent = self.guide.silent().map(name).collect::<Vec<_>>().join(", ");
        let now = (done, objections, silent);
        if self.reported.as_ref() != Some(&now) {
            // For who says it in another language: what is asked for, the how-manieth, who sends nothing, why once more.
            let result = json!({
                "asks": self.guide.step().map(BlockKind::name), "step": done + 1, "steps": steps, "silent": now.2,
                "objection": objection,
            });
            let again = objection.map_or_else(String::new, |objection| format!("{objection}. Once more: "));
            let silent = match &*now.2 {
                "" => String::new(),
                silent => format!("{silent}: nothing comes; see to it. "),
            };
            let message = format!("{} of {steps}: {silent}{again}{prompt}", done + 1);
            self.reported = Some(now);
            job.progress_with(Some(done as f64 / steps as f64), message, result);
        }
    }

    fn time_s(((t_s, _), _): &(Recorded, Places)) -> f64 {
        *t_s
    }

    fn push(&mut self, ((t_s, samples), places): (Recorded, Places)) {
        self.guide.push_places(&places);
        self.guide.push(t_s, &samples);
    }

    fn silence(&self) -> String {
        "no sensor sends anything; see to the devices".to_owned()
    }

    fn step(&self, prompt: &str) -> String {
        format!("step {}, \"{prompt}\",", self.guide.progress().0 + 1)
    }
}
