//! `stage.align`: guides somebody through anchors and waving, and finds how the transmitter stands and how an IMU sits.
//!
//! In: records of one magnetic sensor and its IMU from the fusion thread, while the job runs on a thread of its own. Out: what to do
//! next, as the job's message; in the end models for the pipeline, through its log, and the same as keys of the stage file. An alignment
//! that is not good is not used.

use nalgebra::{Isometry3, Vector3};
use serde_json::json;

use super::super::fusion::{Command, FusionInbox};
use super::super::jobs::{Failure, Job};
use super::super::observers::{AlignmentSample, AlignmentSource};
use super::super::server::{Refusal, Reply};
use super::Calls;
use super::guided::{self, Guided};
use posed_fusion::align::{Ask, Found, Guide, align_recording, stand};
use posed_geometry::orientation_to_wxyz;
use posed_protocol::{RefusalReason, RoomPoint};
use posed_stage::input::{Model, SensorIndex};

/// What a good alignment leaves at most: of the rotations, degrees; of the second differences and of the anchors, m.
const GOOD_DEG: f64 = 3.0;
const GOOD_M: f64 = 0.03;

impl Calls {
    /// Begins an alignment.
    pub(super) fn align_stage(&self, sensor: Option<String>, anchors: Vec<RoomPoint>, reply: Reply) {
        match self.to_align(sensor, anchors) {
            Ok(session) => self.jobs.run("stage.align", reply, move |job| session.run(job)),
            Err(refusal) => reply.refuse(refusal),
        }
    }

    fn to_align(&self, sensor: Option<String>, anchors: Vec<RoomPoint>) -> Result<Session, Refusal> {
        let magnetic = self.stage.magnetic_sensors();
        let wears_imu = |name: &&str| self.stage.sensors.iter().any(|s| s.name == **name && s.imu.is_some());
        let name = match &sensor {
            Some(name) if magnetic.contains(&name.as_str()) => name.as_str(),
            Some(name) => {
                let sentence = format!("sensor: this stage has no magnetic sensor {name:?}");
                return Err(Refusal::bad_request(sentence)
                    .because(RefusalReason::NotMagnetic)
                    .with("name", name));
            }
            None => *magnetic.iter().find(|name| wears_imu(name)).or(magnetic.first()).ok_or_else(|| {
                Refusal::bad_request("this stage has no magnetic sensor").because(RefusalReason::NoMagnetic)
            })?,
        };
        let index = |name: &str| self.stage.sensors.iter().position(|sensor| sensor.name == name);
        let unknown = || Refusal::bad_request(format!("sensor: this stage has no sensor {name:?}"));
        let sensor = index(name).ok_or_else(unknown)?;
        let imu = self.stage.sensors[sensor].imu.as_ref().and_then(|imu| index(&imu.sensor));
        if imu.is_none() && anchors.len() < 3 {
            let sentence = format!(
                "anchors: no IMU is attached to {name:?}, so it takes three surveyed points or more; or write `imu` at it in the stage file"
            );
            return Err(Refusal::bad_request(sentence)
                .because(RefusalReason::NoAttachedImu)
                .with("name", name));
        }
        if anchors.iter().any(|anchor| anchor.position_m.iter().any(|value| !value.is_finite())) {
            return Err(Refusal::bad_request("anchors: give finite numbers"));
        }
        let place = |anchor: RoomPoint| (anchor.name, Vector3::from(anchor.position_m));
        Ok(Session {
            name: name.to_owned(),
            sensor: sensor as SensorIndex,
            imu: imu.map(|imu| imu as SensorIndex),
            attached: imu.map(|imu| self.stage.sensors[imu].name.clone()),
            magnetometer: imu.is_some_and(|imu| self.stage.sensors[imu].magnetometer),
            transmitter_m: self.stage.transmitter.pose_in_room.map_or([0.0; 3], |pose| pose.position_m),
            anchors: anchors.into_iter().map(place).collect(),
            inbox: self.inbox.clone(),
        })
    }
}

/// An alignment at work.
struct Session {
    name: String,
    sensor: SensorIndex,
    imu: Option<SensorIndex>,
    /// The IMU's name.
    attached: Option<String>,
    magnetometer: bool,
    /// Where the stage file has the transmitter; it stays there where no anchor specifies otherwise.
    transmitter_m: [f64; 3],
    anchors: Vec<(String, Vector3<f64>)>,
    inbox: FusionInbox,
}

impl Session {
    fn run(self, job: &Job) -> Result<String, Failure> {
        let guide = Guide::new(self.anchors.clone(), self.imu.is_some());
        let mut guided = Alignment { guide, name: &self.name };
        let source = AlignmentSource::new(self.sensor, self.imu);
        guided::run(&mut guided, job, &self.inbox, source)?;
        self.solve(job, &guided.guide)
    }

    fn solve(&self, job: &Job, guide: &Guide) -> Result<String, Failure> {
        let (recording, anchors) = guide.recorded();
        if self.imu.is_none() {
            let (room, left_m) = stand(anchors)?;
            job.result(json!({ "sensor": self.name, "transmitter": pose(&room), "anchors_m": left_m }));
            return self.use_it(&room, None, left_m);
        }
        let found = align_recording(recording, anchors, self.magnetometer)
            .map_err(|error| format!("{error}; begin again"))?;
        let Found { alignment, clock_offset_s, heading } = found;
        let mut room = alignment.room_from_transmitter;
        if anchors.is_empty() {
            room.translation.vector = self.transmitter_m.into();
        }
        job.result(json!({
            "sensor": self.name,
            "transmitter": pose(&room),
            "imu": {
                "sensor": self.attached,
                "quat_wxyz": orientation_to_wxyz(&alignment.q_sensor_imu),
                "offset_m": <[f64; 3]>::from(alignment.lever_m),
                "clock_offset_ms": 1e3 * clock_offset_s,
            },
            "heading": if heading { "field" } else if anchors.len() > 1 { "anchors" } else { "transmitter" },
            "residual_deg": alignment.residual_rad.to_degrees(),
            "residual_m": alignment.residual_m,
            "anchors_m": alignment.anchors_m,
        }));
        if alignment.residual_rad.to_degrees() > GOOD_DEG || alignment.residual_m > GOOD_M {
            return Err(format!(
                "the two do not move together ({:.1} degrees and {:.0} mm are left): attach the IMU to {:?}, and begin again",
                alignment.residual_rad.to_degrees(),
                1e3 * alignment.residual_m,
                self.name
            ).into());
        }
        self.use_it(&room, Some(&found), alignment.anchors_m)
    }

    /// Swaps it in, if it is good.
    fn use_it(&self, room: &Isometry3<f64>, imu: Option<&Found>, left_m: f64) -> Result<String, Failure> {
        if left_m > GOOD_M {
            return Err(format!(
                "the anchors do not agree: {:.0} mm are left; measure them anew",
                1e3 * left_m
            )
            .into());
        }
        let load = |model| self.inbox.command(Command::load(model));
        let position_m = room.translation.vector.into();
        load(Model::Transmitter { position_m, orientation_wxyz: orientation_to_wxyz(&room.rotation) });
        let mut emitted = "it is known how the transmitter stands".to_owned();
        if let Some(Found { alignment, clock_offset_s, .. }) = imu {
            load(Model::AttachedImu {
                sensor: self.name.clone(),
                quat_wxyz: orientation_to_wxyz(&alignment.q_sensor_imu),
                offset_m: alignment.lever_m.into(),
                clock_offset_s: *clock_offset_s,
            });
            emitted += &format!(
                ", and how the IMU sits on {:?}: {:.2} degrees and {:.1} mm are left",
                self.name,
                alignment.residual_rad.to_degrees(),
                1e3 * alignment.residual_m
            );
        }
        Ok(format!("{emitted}; write both into the stage file to keep them"))
    }
}

/// What is done, and by which sensor.
struct Alignment<'a> {
    guide: Guide,
    name: &'a str,
}

impl Guided for Alignment<'_> {
    type Source = AlignmentSource;
    const NAME: &'static str = "alignment";
    const UNCHANGED: &'static str = "the stage stands as it did before";
    const LONGEST_S: f64 = Guide::LONGEST_S;

    fn prompt(&self) -> Option<String> {
        self.guide.prompt()
    }

    fn report(&mut self, job: &Job, prompt: &str) {
        let asks = match self.guide.asks() {
            Some(Ask::Anchor { name, position_m }) => {
                json!({"asks": "anchor", "anchor": name, "position_m": position_m})
            }
            Some(Ask::Wave) => json!({"asks": "wave"}),
            Some(Ask::OtherAxis) => json!({"asks": "other_axis"}),
            None => json!({"asks": null}),
        };
        job.progress_with(Some(self.guide.progress()), prompt.to_owned(), asks);
    }

    fn time_s(sample: &AlignmentSample) -> f64 {
        let (AlignmentSample::Magnetic(t_s, _) | AlignmentSample::Imu(t_s, _)) = *sample;
        t_s
    }

    fn push(&mut self, sample: AlignmentSample) {
        match sample {
            AlignmentSample::Magnetic(t_s, pose) => self.guide.magnetic(t_s, &pose),
            AlignmentSample::Imu(t_s, sample) => self.guide.imu(t_s, &sample),
        }
    }

    fn silence(&self) -> String {
        format!("{:?} sends nothing that can be believed; see to the devices", self.name)
    }
}

fn pose(pose: &Isometry3<f64>) -> serde_json::Value {
    let position_m: [f64; 3] = pose.translation.vector.into();
    json!({ "position_m": position_m, "orientation_wxyz": orientation_to_wxyz(&pose.rotation) })
}
