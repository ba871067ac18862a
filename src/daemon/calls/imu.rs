//! `imu.calibrate`: guides somebody who lays a unit down in all directions, and finds its intrinsics.
//!
//! In: what one IMU tells, from the fusion thread, while the job runs on a thread of its own. Out: what to do next, as the job's
//! message, and which directions were held, as its result; in the end a file of the unit and a model for the pipeline, through its
//! log. Intrinsics that are not good are neither kept nor used.

use std::io::Write;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use serde_json::{Value, json};

use super::super::fusion::{Command, FusionInbox};
use super::super::inbox::Event;
use super::super::jobs::Job;
use super::super::laid::Told;
use super::super::models::imu_file;
use super::super::server::Reply;
use super::Calls;
use crate::atomic_file::AtomicFile;
use crate::fusion::intrinsics::guide::{Guide, LONGEST_S, PATIENCE_S, Progress};
use crate::fusion::intrinsics::{Intrinsics, SIDES};
use crate::input::{Model, SensorIndex};
use crate::stage::Driver;

/// Samples that may wait for the thread: ten seconds at 100 Hz.
const WAITING: usize = 1024;
/// Distance of two looks at whether the job was cancelled.
const LOOK_INTERVAL: Duration = Duration::from_millis(500);
/// Without a sample for so many looks the unit is silent.
const SILENT_LOOKS: u32 = 10;

impl Calls {
    /// Begins a calibration.
    pub(super) fn calibrate_imu(&self, sensor: Option<String>, reply: Reply) {
        match self.to_lay(sensor) {
            Ok(session) => self.jobs.run("imu.calibrate", reply, move |job| session.run(job)),
            Err(sentence) => reply.error("bad_request", sentence),
        }
    }

    fn to_lay(&self, sensor: Option<String>) -> Result<Session, String> {
        let imus: Vec<_> =
            (0..).zip(&self.stage.sensors).filter(|(_, known)| self.stage.is_imu(known)).collect();
        let names = || imus.iter().map(|(_, known)| known.name.as_str()).collect::<Vec<_>>().join(", ");
        let found = match (&sensor, imus.as_slice()) {
            (_, []) => return Err("this stage has no IMU".into()),
            (None, [only]) => only,
            (None, _) => return Err(format!("sensor: name one of {}", names())),
            (Some(name), _) => imus
                .iter()
                .find(|(_, known)| known.name == *name)
                .ok_or_else(|| format!("sensor: {name:?} is no IMU of this stage; it has {}", names()))?,
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
    fn run(self, job: &Job) -> Result<String, String> {
        let unit = self.unit()?;
        let (to, samples) = sync_channel(WAITING);
        self.inbox.push(Event::Command(Command::WatchImu { sensor: self.sensor, to }));
        let mut guide = Guide::new(self.magnetometer);
        self.guided(job, &samples, &mut guide)?;
        let mut found = guide.solve().map_err(|error| error.to_string())?;
        if self.unit()? != unit {
            return Err(format!(
                "{:?} is another unit now than at the beginning ({unit}); begin again",
                self.name
            ));
        }
        found.unit = Some(unit);
        self.keep(job, &guide, found)
    }

    /// Who is being calibrated.
    fn unit(&self) -> Result<String, String> {
        let unit = self.inbox.ask(|to| Command::Unit { sensor: self.sensor, to })?;
        unit.ok_or_else(|| "the sensor is gone".to_owned())
    }

    /// Until everything was done, or until there is enough to go by and nobody does more.
    fn guided(&self, job: &Job, samples: &Receiver<Told>, guide: &mut Guide) -> Result<(), String> {
        let mut silent = 0;
        while let Some(prompt) = guide.prompt() {
            let progress = guide.progress();
            job.result(said(&progress));
            job.progress(Some(share(&progress)), Some(prompt));
            if job.is_cancelled() {
                return Err("cancelled; the unit counts as it did before".into());
            }
            match samples.recv_timeout(LOOK_INTERVAL) {
                Ok((t_s, sample)) => {
                    silent = 0;
                    guide.push(t_s, &sample);
                }
                Err(RecvTimeoutError::Timeout) => {
                    silent += 1;
                    if silent > SILENT_LOOKS {
                        return Err(format!(
                            "{:?} tells no rates and forces; see to the device and begin again",
                            self.name
                        ));
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err("another calibration was begun".into());
                }
            }
            let (since_s, idle_s) = guide.times_s();
            if idle_s > PATIENCE_S || since_s > LONGEST_S {
                // What is missing is said by whoever tries to solve it.
                return if guide.would_do() {
                    Ok(())
                } else {
                    guide.solve().map(drop).map_err(|e| e.to_string())
                };
            }
        }
        Ok(())
    }

    /// Writes the unit's file and swaps the intrinsics in.
    fn keep(&self, job: &Job, guide: &Guide, found: Intrinsics) -> Result<String, String> {
        let unit = found.unit.clone().unwrap_or_default();
        let model = Model::Imu { unit: unit.clone(), intrinsics: Box::new(found.clone()) };
        model.check()?;
        let file = imu_file(&unit);
        let path = self.folder.join(&file);
        let text = serde_json::to_string_pretty(&found).map_err(|error| error.to_string())?;
        let write = || {
            std::fs::create_dir_all(&self.folder)?;
            let mut out = AtomicFile::create(&path)?;
            writeln!(out, "{text}")?;
            out.commit()
        };
        write().map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        let mut result = said(&guide.progress());
        result["intrinsics"] = json!(found);
        result["file"] = json!(file);
        job.result(result);
        self.inbox.push(Event::Command(Command::LoadModel(model)));
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

/// What was held and what is missing, for programs.
fn said(progress: &Progress) -> Value {
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
