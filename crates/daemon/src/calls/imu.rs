//! `imu.calibrate`: guides somebody who lays a unit down in all directions, and finds its intrinsics.
//!
//! In: what one IMU tells, from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's
//! message, and which directions were held, as its result; in the end a file of the unit and a model for the pipeline, through its
//! log. Intrinsics that are not good are neither kept nor used.

use std::io::Write;
use std::path::PathBuf;

use serde_json::{Value, json};

use super::super::fusion::{Command, FusionInbox};
use super::super::jobs::{Failure, Job};
use super::super::models::imu_file;
use super::super::observers::ImuSource;
use super::super::server::{Refusal, Reply};
use super::Calls;
use super::guided::{self, Guided};
use posed_fusion::ahrs::ImuSample;
use posed_fusion::intrinsics::{Ask, Guide, Progress};
use posed_fusion::intrinsics::{Intrinsics, SIDES};
use posed_protocol::RefusalReason;
use posed_recording::AtomicFile;
use posed_stage::Driver;
use posed_stage::input::{Model, SensorIndex};

impl Calls {
    /// Begins a calibration.
    pub(super) fn calibrate_imu(&self, sensor: Option<String>, reply: Reply) {
        match self.to_lay(sensor) {
            Ok(session) => self.jobs.run("imu.calibrate", reply, move |job| session.run(job)),
            Err(refusal) => reply.refuse(refusal),
        }
    }

    fn to_lay(&self, sensor: Option<String>) -> Result<Session, Refusal> {
        let imus: Vec<_> =
            (0..).zip(&self.stage.sensors).filter(|(_, known)| self.stage.is_imu(known)).collect();
        let names = || imus.iter().map(|(_, known)| known.name.as_str()).collect::<Vec<_>>().join(", ");
        let found = match (&sensor, imus.as_slice()) {
            (_, []) => {
                return Err(Refusal::bad_request("this stage has no IMU").because(RefusalReason::NoImu));
            }
            (None, [only]) => only,
            (None, _) => return Err(Refusal::bad_request(format!("sensor: name one of {}", names()))),
            (Some(name), _) => imus.iter().find(|(_, known)| known.name == *name).ok_or_else(|| {
                let names = names();
                Refusal::bad_request(format!("sensor: {name:?} is no IMU of this stage; it has {names}"))
            })?,
        };
        let (index, known) = *found;
        let measures_field = self.stage.driver_of(known).is_some_and(Driver::measures_field);
        Ok(Session {
            sensor: index,
            name: known.name.clone(),
            magnetometer: known.magnetometer && measures_field,
            folder: self.imus.clone(),
            inbox: self.inbox.clone(),
        })
    }
}

/// A calibration at work.
struct Session {
    sensor: SensorIndex,
    name: String,
    magnetometer: bool,
    folder: PathBuf,
    inbox: FusionInbox,
}

impl Session {
    fn run(self, job: &Job) -> Result<String, Failure> {
        let unit = self.unit()?;
        let mut guided = Imu { guide: Guide::new(self.magnetometer), name: &self.name };
        let source = ImuSource { sensor: self.sensor };
        guided::run(&mut guided, job, &self.inbox, source)?;
        let guide = guided.guide;
        // What is missing is said by whoever tries to solve it.
        let mut found = guide.solve()?;
        if self.unit()? != unit {
            return Err(format!(
                "{:?} is another unit now than at the beginning ({unit}); begin again",
                self.name
            )
            .into());
        }
        found.unit = Some(unit);
        self.keep(job, &guide, found)
    }

    /// Who is being calibrated.
    fn unit(&self) -> Result<String, Failure> {
        let unit = self.inbox.ask(|to| Command::Unit { sensor: self.sensor, to })?;
        unit.ok_or_else(|| "the sensor is gone".into())
    }

    /// Writes the unit's file and swaps the intrinsics in.
    fn keep(&self, job: &Job, guide: &Guide, found: Intrinsics) -> Result<String, Failure> {
        let unit = found.unit.clone().unwrap_or_default();
        let model = Model::Imu { unit: unit.clone(), intrinsics: Box::new(found.clone()) };
        model.check()?;
        let file = imu_file(&unit);
        let path = self.folder.join(&file);
        let text = serde_json::to_string_pretty(&found)?;
        let write = || {
            std::fs::create_dir_all(&self.folder)?;
            let mut out = AtomicFile::create(&path)?;
            writeln!(out, "{text}")?;
            out.commit()
        };
        write().map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        let mut result = emitted(&guide.progress());
        result["intrinsics"] = json!(found);
        result["file"] = json!(file);
        job.result(result);
        self.inbox.command(Command::load(model));
        let field =
            found.mag.map(|mag| format!(", field to {:.1} %", 100.0 * mag.residual)).unwrap_or_default();
        Ok(format!(
            "{} directions; gyro bias to {:.3} deg/s, force to {:.3} m/s²{field}; kept as {file} and in use",
            found.directions,
            found.gyro_bias_sigma_rad_s.to_degrees(),
            found.accel_residual_m_s2,
        ))
    }
}

/// What was held, and of which sensor.
struct Imu<'a> {
    guide: Guide,
    name: &'a str,
}

impl Guided for Imu<'_> {
    type Source = ImuSource;
    const NAME: &'static str = "calibration";
    const UNCHANGED: &'static str = "the unit counts as it did before";
    // Its guide counts itself: what there is may do.
    const LONGEST_S: f64 = f64::INFINITY;

    fn prompt(&self) -> Option<String> {
        self.guide.prompt()
    }

    fn report(&mut self, job: &Job, prompt: &str) {
        let progress = self.guide.progress();
        let mut result = emitted(&progress);
        result["asks"] = json!(self.guide.asks().map(Ask::name));
        job.progress_with(Some(share(&progress)), prompt.to_owned(), result);
    }

    fn time_s((t_s, _): &(f64, ImuSample)) -> f64 {
        *t_s
    }

    fn push(&mut self, (t_s, sample): (f64, ImuSample)) {
        self.guide.push(t_s, &sample);
    }

    fn silence(&self) -> String {
        format!("{:?} sends no angular velocity and specific force; see to the device", self.name)
    }

    fn is_left(&self) -> bool {
        let (since_s, idle_s) = self.guide.times_s();
        idle_s > Guide::PATIENCE_S || since_s > Guide::LONGEST_S
    }
}

/// What was held and what is missing, for programs.
fn emitted(progress: &Progress) -> Value {
    let which = |held: bool| {
        SIDES
            .iter()
            .zip(progress.sides)
            .filter(|(_, of)| *of == held)
            .map(|(name, _)| *name)
            .collect::<Vec<_>>()
    };
    json!({
        "directions": progress.directions,
        "wanted": progress.wanted,
        "held": which(true),
        "missing": which(false),
        "field": progress.field,
    })
}

/// From 0 to 1.
fn share(progress: &Progress) -> f64 {
    let directions = (progress.directions as f64 / progress.wanted as f64).min(1.0);
    progress.field.map_or(directions, |field| 0.8 * directions + 0.2 * field)
}
