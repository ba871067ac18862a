//! The pipeline: input log in, outputs out.
//!
//! What comes in: [`Entry`]s in their total order. What goes out: [`Output`]s, during the call. What it never
//! does: read a clock, start a thread, allocate per frame once warm, depend on anything but the entries. One
//! input, then all outputs are drained; the same entries give the same outputs, and a pipeline restored from
//! a snapshot goes on as if nothing had happened.
//!
//! ```
//! use posed_drivers::Timestamp;
//! use posed_pipeline::Pipeline;
//! use posed_stage::Stage;
//! use posed_stage::input::{Entry, Input};
//!
//! let text = "name = \"s\"\n[[device]]\nname = \"d\"\ndriver = \"fastrak\"\nport = \"auto\"\n\
//!     [[sensor]]\nname = \"hand\"\ndevice = \"d\"\naddress = 1\n";
//! let stage = Stage::parse(text)?;
//! let mut pipeline = Pipeline::new(&stage)?;
//! let mut outputs = 0;
//! pipeline.push(&Entry { t: Timestamp::ZERO, input: Input::Timer }, &mut |_| outputs += 1);
//! let mut again = Pipeline::restore(&stage, pipeline.models(), &pipeline.snapshot())?;
//! assert_eq!(again.snapshot(), pipeline.snapshot());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod attached;
mod body;
mod chain;
mod changes;
pub mod clock;
mod device;
mod exercise;
mod fault_map;
mod field;
pub mod frame;
mod inertial;
mod input_error;
mod keyframes;
mod magnetic;
mod naming;
mod sensor;
mod session;
mod source;
mod spike;
mod status;
mod supervised;
mod timecode;
mod units;
mod wearer;

use nalgebra::Isometry3;
use posed_drivers::{LineEvent, Sample, Timestamp, session::Output as SessionOutput};
use posed_state::State;
use thiserror::Error;

use crate::frame::{Assembler, Frame};
use attached::Attached;
pub use body::{ImuRecords, all_have_field, sensor_mount};
use device::{Device, owner};
pub use exercise::DEFAULT_SUBJECT;
use exercise::ExerciseStage;
use fault_map::FaultMapStage;
pub use fault_map::{RawPose, raw_poses};
use field::Field;
pub use input_error::InputError;
use keyframes::Keyframes;
use naming::Naming;
use posed_fusion::body::SEGMENTS;
use posed_motion::segments;
use posed_stage::input::{DeviceIndex, Entry, Input, SensorIndex};
use posed_stage::output::{Estimate, Output, SensorEstimate};
use posed_stage::{BodyIndex, LoadedModels, Stage};
use sensor::Sensor;
use source::Source;
pub use status::{BodyStatus, ClockStatus, DeviceStatus, PipelineStatus, SensorStatus};
use supervised::Recoveries;
pub use supervised::SupervisedPipeline;
use timecode::Timecode;
use units::Units;
use wearer::Wearer;

/// No port brings more bytes in its life: who claims so is a damaged recording, and drivers add such numbers up.
const MOST_DROPPED_BYTES: u64 = 1 << 40;

/// A stage file that no pipeline can be made of, or a snapshot that does not fit it.
#[derive(Debug, Error)]
pub enum PipelineError {
    /// A sensor names a device that the stage does not have.
    #[error("sensor {sensor:?} belongs to device {device:?}, which the stage does not have")]
    UnknownDevice {
        /// The sensor, by name.
        sensor: String,
        /// The name that its key `device` gives.
        device: String,
    },
    /// A driver refuses its settings, or the addresses of its sensors.
    #[error("device {device:?}: {source}")]
    Settings {
        /// The device, by name.
        device: String,
        /// The key that is wrong, and what the driver expects.
        source: posed_drivers::flock::SettingsError,
    },
    /// Two IMUs sit on one segment of the human skeleton.
    #[error("sensors {:?} and {:?} sit on the same segment: give each a `segment` of its own", sensors[0], sensors[1])]
    SameSegment {
        /// The two, by name.
        sensors: [String; 2],
    },
    /// A value that the pipeline cannot work with, or one that it lacks.
    #[error("{key}: expected {expected}")]
    Value {
        /// The key in the stage file.
        key: &'static str,
        /// What it must be.
        expected: &'static str,
    },
    /// The snapshot is damaged, of another version of the program, or of a stage with other parts.
    #[error("the snapshot cannot be read: {0}")]
    Snapshot(#[from] posed_state::Damaged),
}

/// All stages from bytes of devices to outcomes, as plain data: see the crate. Its estimates are causal: a frame knows what
/// arrived until it closed.
#[derive(Clone, Debug, State)]
pub struct Pipeline {
    now: Timestamp,
    #[state(each)]
    devices: Vec<Device>,
    /// The clocks of all devices, in their order.
    #[state(each)]
    sources: Vec<Source>,
    #[state(each)]
    sensors: Vec<Sensor>,
    frames: Assembler,
    room_transmitter: Isometry3<f64>,
    field: Field,
    estimate: Estimate,
    attached: Attached,
    /// Boxed: few stages have any.
    units: Box<Units>,
    exercise: ExerciseStage,
    /// Who wears the sensors, in the stage's order.
    #[state(each)]
    bodies: Vec<Wearer>,
    /// By sensor, the body that wears it.
    #[state(keep)]
    worn_by: Vec<Option<BodyIndex>>,
    /// Absent where the stage does not ask for them.
    #[state(each)]
    keyframes: Option<Keyframes>,
    models_refused: u64,
    requests_refused: u64,
    /// By device, whether its port has modem lines, if it is open.
    opened: Vec<Option<bool>>,
    /// Of a [`SupervisedPipeline`].
    recoveries: Recoveries,
    /// One per body whose motion is named, or one of a stage without bodies.
    #[state(each)]
    naming: Vec<Naming>,
    #[state(each)]
    faults: Option<Box<FaultMapStage>>,
    #[state(keep)]
    models: LoadedModels,
    /// Absent where the stage reads none.
    timecode: Option<Timecode>,
}

impl Pipeline {
    /// A pipeline for a stage, before its first input: time is the stage's epoch, no model is in use, not even those that the
    /// stage file names. It opens no file.
    ///
    /// # Errors
    /// All but [`PipelineError::Snapshot`]: a sensor of an unknown device, settings that a driver refuses, two IMUs on one
    /// segment, a value out of its range, a name that no sensor has, sensors on a human body without `height_m`.
    /// [`Stage::parse`] refuses all of it but the missing height, which only [`posed_stage::check`] finds: files can be worked on without.
    pub fn new(stage: &Stage) -> Result<Self, PipelineError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let check =
            |ok: bool, key, expected| if ok { Ok(()) } else { Err(PipelineError::Value { key, expected }) };
        let rate_ok = stage.frame_rate_hz.is_none_or(|rate| positive(rate) && rate <= 10_000.0);
        check(rate_ok, "frame_rate_hz", "a rate from above 0 to 10000")?;
        let wait = stage.frame_wait_ms;
        check((0.0..=10_000.0).contains(&wait), "frame_wait_ms", "0 to 10000")?;
        let owners =
            stage.sensors.iter().map(|sensor| owner(stage, sensor)).collect::<Result<Vec<_>, _>>()?;
        let mut sources = Vec::new();
        let devices: Vec<Device> = (0..stage.devices.len())
            .map(|index| Device::new(stage, index, &owners, &mut sources))
            .collect::<Result<_, _>>()?;
        let mut timed_by = vec![0; stage.sensors.len()];
        for placed in devices.iter().flat_map(|device| &device.sensors) {
            timed_by[usize::from(placed.sensor)] = placed.source;
        }
        let room_transmitter = match &stage.transmitter.pose_in_room {
            None => Isometry3::identity(),
            Some(pose) => posed_geometry::isometry(pose.position_m, pose.orientation_wxyz).ok_or(
                PipelineError::Value {
                    key: "transmitter.pose_in_room",
                    expected: "numbers up to 1e6 and a quaternion",
                },
            )?,
        };
        Ok(Self {
            now: Timestamp::ZERO,
            frames: Assembler::new(sources.len(), &timed_by, stage.frame_rate_hz, wait),
            sensors: stage
                .sensors
                .iter()
                .zip(&owners)
                .map(|(sensor, &device)| {
                    let driver = &stage.devices[usize::from(device)].driver;
                    Sensor::new(sensor, device, driver, stage.faults.repair)
                })
                .collect(),
            devices,
            sources,
            opened: vec![None; stage.devices.len()],
            recoveries: Recoveries::default(),
            room_transmitter,
            field: Field::new(stage),
            estimate: Estimate {
                sensors: vec![SensorEstimate::default(); stage.sensors.len()],
                ..Estimate::default()
            },
            attached: Attached::new(stage)?,
            units: Box::new(Units::new(stage.sensors.len())),
            exercise: ExerciseStage::new(stage),
            bodies: (0..)
                .zip(&stage.bodies)
                .map(|(index, _)| Wearer::new(stage, index))
                .collect::<Result<_, _>>()?,
            worn_by: stage.sensors.iter().map(|sensor| stage.wearer_of(sensor)).collect(),
            keyframes: Keyframes::new(stage)?,
            models_refused: 0,
            requests_refused: 0,
            naming: Vec::new(),
            faults: None,
            models: LoadedModels::default(),
            timecode: stage.timecode.as_ref().map(Timecode::new),
        })
    }

    /// Takes the next entry of the input log and gives all that follows from it to `emit`, in order, before it returns.
    ///
    /// Its time is the latest that an entry had: one that is earlier does not set it back. Of bytes and lines of a device that
    /// the stage does not have, only the time is taken. Nothing can fail: what is wrong is counted ([`Self::status`]).
    pub fn push(&mut self, entry: &Entry, emit: &mut dyn FnMut(Output<'_>)) {
        self.now = self.now.max(entry.t);
        let now = self.now;
        match &entry.input {
            Input::Bytes { device, bytes } => {
                if let Some(owner) = self.devices.get_mut(usize::from(*device)) {
                    owner.session.get_mut().handle_bytes(now, bytes);
                    self.drain(*device, emit);
                }
            }
            Input::Line { device, event } => self.line(*device, event, emit),
            Input::Timer => {
                for device in 0..self.devices.len() {
                    let session = self.devices[device].session.get_mut();
                    if session.poll_timeout().is_some_and(|timeout| timeout <= now) {
                        session.handle_timeout(now);
                    }
                    self.drain(device as DeviceIndex, emit);
                }
            }
            Input::Model(model) => self.swap(model, emit),
            Input::Request(request) => self.request(request, emit),
            Input::SegmentationNetwork(bytes) => self.name_with(bytes, emit),
            Input::Truth(truth) => emit(Output::Truth(truth)),
            Input::Timecode(reading) => {
                if let Some(timecode) = &mut self.timecode {
                    timecode.read(entry.t, reading);
                }
            }
        }
        // Before the frames that it dates.
        if let Some(timecode) = &mut self.timecode {
            timecode.report(now, emit);
        }
        self.close_frames(emit);
        while let Some(sensor) = self.bodies.iter_mut().find_map(Wearer::take_tapped) {
            self.asked_on_a_tracker(self.sensors[usize::from(sensor)].device(), Some(sensor), emit);
        }
    }

    /// Host time at which to push [`Input::Timer`] if nothing else comes before, possibly past already; `None`: nothing is due.
    /// Ask again after every entry.
    pub fn poll_timeout(&self) -> Option<Timestamp> {
        let sessions = self.devices.iter().filter_map(|device| device.session.get().poll_timeout());
        let timecode = self.timecode.as_ref().and_then(Timecode::poll_timeout);
        sessions.chain(self.frames.poll_timeout(self.now)).chain(timecode).min()
    }

    /// All that has changed since the pipeline was made and the models swapped in, as bytes for [`Self::restore`]: see
    /// [`posed_state`]. Neither the stage nor the models are in it.
    pub fn snapshot(&self) -> Vec<u8> {
        posed_state::snapshot(self)
    }

    /// A pipeline before its first input, with these models in use.
    fn with_models(stage: &Stage, models: &LoadedModels) -> Result<Self, PipelineError> {
        let mut pipeline = Self::new(stage)?;
        models.entries().for_each(|input| pipeline.push(&Entry { t: Timestamp::ZERO, input }, &mut |_| {}));
        Ok(pipeline)
    }

    /// A pipeline that goes on from a snapshot taken on the same stage with the same models ([`Self::models`]): the same entries
    /// give it the same outputs.
    ///
    /// # Errors
    /// As [`Self::new`]; [`PipelineError::Snapshot`] where the bytes are no snapshot of this version, or of a stage with other
    /// devices, sensors or models as far as the bytes show it.
    pub fn restore(stage: &Stage, models: &LoadedModels, snapshot: &[u8]) -> Result<Self, PipelineError> {
        let mut pipeline = Self::with_models(stage, models)?;
        posed_state::restore(&mut pipeline, snapshot)?;
        Ok(pipeline)
    }

    /// The models in use: those of the log that were accepted, the newest of each kind.
    pub fn models(&self) -> &LoadedModels {
        &self.models
    }

    /// What the pipeline has counted and measured until its last entry; a copy.
    pub fn status(&self) -> PipelineStatus {
        PipelineStatus {
            devices: self.devices.iter().map(|device| device.status(&self.sources)).collect(),
            sensors: (0..)
                .zip(&self.sensors)
                .map(|(index, sensor)| {
                    let device = &self.devices[usize::from(sensor.device())];
                    let counted = device.counted(index, &self.sensors);
                    let condition = device.condition(index, &self.sensors);
                    sensor.status(counted.as_ref(), condition, self.units.corrects(index))
                })
                .collect(),
            bodies: self.bodies.iter().map(Wearer::status).collect(),
            models_refused: self.models_refused,
            requests_refused: self.requests_refused,
            entries_left_out: self.recoveries.entries_left_out(),
            begun_anew: self.recoveries.begun_anew(),
        }
    }

    fn line(&mut self, device: DeviceIndex, event: &LineEvent, emit: &mut dyn FnMut(Output<'_>)) {
        let capped;
        let event = match event {
            LineEvent::Dropped { bytes } if *bytes > MOST_DROPPED_BYTES => {
                capped = LineEvent::Dropped { bytes: MOST_DROPPED_BYTES };
                &capped
            }
            other => other,
        };
        let now = self.now;
        let Some(owner) = self.devices.get_mut(usize::from(device)) else { return };
        match event {
            LineEvent::Opened { modem_lines } => self.opened[usize::from(device)] = Some(*modem_lines),
            LineEvent::Closed { .. } => self.opened[usize::from(device)] = None,
            LineEvent::Dropped { .. } => {
                // Nobody knows how many cycles they were, where no device counts them.
                let rate_hz = owner.session.get().rate_hz();
                self.sources[owner.source_range()].iter_mut().for_each(|source| source.restart(rate_hz));
            }
        }
        if matches!(event, LineEvent::Opened { modem_lines: true }) {
            self.sources[owner.source_range()].iter_mut().for_each(Source::know_wire);
        }
        owner.session.get_mut().handle_line(now, event);
        self.drain(device, emit);
    }

    /// All that a session has to say.
    fn drain(&mut self, device: DeviceIndex, emit: &mut dyn FnMut(Output<'_>)) {
        let index = usize::from(device);
        while let Some(output) = self.devices[index].session.get_mut().poll_output() {
            match output {
                SessionOutput::Transmit(bytes) => emit(Output::Transmit { device, bytes: &bytes }),
                SessionOutput::SetRts(asserted) => emit(Output::SetRts { device, asserted }),
                SessionOutput::HeadingReset { address } => {
                    let asked = self.devices[index].route(address, &self.sensors).sensor;
                    self.asked_on_a_tracker(device, asked, emit);
                }
                SessionOutput::Pressed { address } => {
                    let pressed = self.devices[index].route(address, &self.sensors).sensor;
                    let body = self.wearer_of(pressed).map(|body| &self.bodies[usize::from(body)]);
                    let human = body.and_then(|body| body.human.as_ref());
                    if human.is_some_and(|human| human.resets_by_button()) {
                        self.asked_on_a_tracker(device, pressed, emit);
                    }
                }
                SessionOutput::Warning(text) => emit(Output::Warning { device, text: &text }),
                SessionOutput::StateChanged => {
                    self.state_changed(device);
                    emit(Output::Device { device, state: self.devices[index].session.get().state() });
                }
                SessionOutput::Sample(sample) => self.sample(device, &sample),
            }
        }
    }

    fn state_changed(&mut self, device: DeviceIndex) {
        let owner = &mut self.devices[usize::from(device)];
        match owner.turned() {
            Some(true) => {
                let rate_hz = owner.session.get().rate_hz();
                self.sources[owner.source_range()].iter_mut().for_each(|source| source.restart(rate_hz));
            }
            Some(false) => owner.source_range().for_each(|source| self.frames.stop(source as u16)),
            None => {}
        }
    }

    fn sample(&mut self, device: DeviceIndex, sample: &Sample) {
        let owner = &self.devices[usize::from(device)];
        let route = owner.route(sample.address, &self.sensors);
        let sensor = route.sensor.map(|index| &mut self.sensors[usize::from(index)]);
        if sensor.as_ref().is_some_and(|sensor| !sensor.times(&sample.measurement)) {
            // It joins the next record of its sensor, at that one's time.
            if let Some(sensor) = sensor {
                sensor.record(self.now, &sample.measurement);
            }
            return;
        }
        let source = &mut self.sources[usize::from(route.source)];
        let stamp = source.push(sample);
        let period_s = source.period_or_nominal_s();
        self.frames.stamp(route.source, &stamp, period_s, self.now);
        if let (Some(index), Some(sensor)) = (route.sensor, sensor)
            && let Some(mut measured) = sensor.record(stamp.t_valid, &sample.measurement)
        {
            if !self.units.is_empty()
                && self.units.correct(index, owner.unit(sample.address, sensor), &mut measured)
            {
                sensor.restart();
                self.attached.restart(index);
                self.bodies.iter_mut().for_each(|body| body.restart(index));
            }
            self.frames.sample(index, measured, stamp.is_late());
        }
        if stamp.begins_cycle
            && route.sensor.is_some()
            && let Some(period_s) = period_s
        {
            for placed in owner.sensors.iter().filter(|placed| placed.source == route.source) {
                self.sensors[usize::from(placed.sensor)].set_interval_s(period_s);
            }
        }
    }

    fn close_frames(&mut self, emit: &mut dyn FnMut(Output<'_>)) {
        let Self {
            frames,
            sensors,
            estimate,
            room_transmitter,
            now,
            field,
            keyframes,
            exercise,
            naming,
            bodies,
            faults,
            attached,
            recoveries,
            ..
        } = self;
        while let Some(frame) = frames.poll(*now) {
            estimate.fault = faults.as_mut().map(|faults| faults.frame(frame, room_transmitter));
            for (sensor, position_m) in bodies.iter().flat_map(Wearer::brought_by_feet) {
                let position_m = room_transmitter.inverse_transform_point(&position_m.into()).coords;
                sensors[usize::from(sensor)].known_at(frame.t_valid, position_m);
            }
            estimate_frame(frame, sensors, field, room_transmitter, faults.as_deref(), estimate);
            attached.frame(frame, sensors, room_transmitter, estimate);
            estimate.sensors.iter_mut().for_each(SensorEstimate::withhold_non_finite);
            for body in bodies.iter_mut().filter_map(|body| body.frame(frame, estimate)) {
                emit(Output::Body(body));
            }
            let latest = |index: BodyIndex| bodies.get(usize::from(index))?.latest();
            if let Some(keyframes) = keyframes {
                keyframes.frame(estimate);
            }
            recoveries.closed(estimate.frame, estimate.t_valid);
            emit(Output::Estimate(estimate));
            for naming in naming.iter_mut() {
                let human = naming.body().and_then(|index| bodies.get(usize::from(index))?.human.as_ref());
                naming.push(estimate, human.and_then(|human| human.latest()), emit);
            }
            if !naming.is_empty() {
                emit(Output::Named);
            }
            for (index, sensor) in sensors.iter_mut().enumerate() {
                sensor.outcomes(index as SensorIndex, frame, emit);
            }
            field.frame(estimate, sensors, room_transmitter, emit);
            if let Some(keyframes) = keyframes {
                keyframes.outcomes(estimate, emit);
            }
            exercise.frame(estimate, latest, &mut |outcome| emit(Output::Outcome(outcome)));
        }
    }

    fn name_with(&mut self, bytes: &[u8], emit: &mut dyn FnMut(Output<'_>)) {
        // Whoever sends one has looked first, to say what is wrong.
        let Ok(model) = segments::Model::from_bytes(bytes) else {
            self.models_refused += 1;
            return;
        };
        let whose: Vec<Option<BodyIndex>> = match self.bodies.len() {
            0 => vec![None],
            count => (0..count).map(|body| Some(body as BodyIndex)).collect(),
        };
        let (sensors, worn_by) = (&self.sensors, &self.worn_by);
        let mut made = Vec::with_capacity(whose.len());
        for body in whose {
            let names = sensors
                .iter()
                .zip(worn_by)
                .map(|(sensor, worn_by)| (worn_by.is_none() || *worn_by == body).then_some(sensor.name()));
            let human = body.and_then(|body| self.bodies[usize::from(body)].human.as_ref());
            let segments = human.map_or(&[][..], |human| human.segments());
            // A person of whom too little is seen is not named.
            made.extend(Naming::new(model.clone(), names, body, segments));
        }
        if made.is_empty() {
            self.models_refused += 1;
            return;
        }
        for before in &mut self.naming {
            if let Some(naming) = made.iter_mut().find(|naming| naming.body() == before.body()) {
                naming.follow(before, self.estimate.t_valid, emit);
            }
        }
        self.naming = made;
        self.models.insert_network(bytes);
    }

    /// The newest record of a magnetic sensor that was believed in the last frame: capture time, and sensor to transmitter, m,
    /// corrected by the field's map. A measurement, not filtered. `None` where none was believed, or none that is a whole pose,
    /// and for IMUs and sensors that the stage does not have.
    pub fn estimated_pose(&self, sensor: SensorIndex) -> Option<(Timestamp, Isometry3<f64>)> {
        let believed = self.sensors.get(usize::from(sensor))?.estimated_pose()?;
        Some((believed.t, believed.pose))
    }

    /// The IMU on each segment of a human body, by `BodySegment::index`: as the stage file has it, or as the last mounting
    /// found it. `None` where a segment wears none; all are where this is no human body.
    pub fn body_imus(&self, body: BodyIndex) -> [Option<SensorIndex>; SEGMENTS] {
        let human = self.bodies.get(usize::from(body)).and_then(|body| body.human.as_ref());
        human.map_or([None; SEGMENTS], |human| *human.imus())
    }

    /// Which unit is the sensor now: the serial number that its device reports, or else that of the stage file, or else its name.
    /// `None` where the stage has no such sensor.
    pub fn unit(&self, sensor: SensorIndex) -> Option<&str> {
        let known = self.sensors.get(usize::from(sensor))?;
        let owner = &self.devices[usize::from(known.device())];
        let infos = owner.session.get().sensors().iter();
        let mut at = infos.map(|info| info.address).filter(|address| {
            let route = owner.route(*address, &self.sensors);
            route.sensor == Some(sensor)
        });
        let alone = || known.serial().unwrap_or(known.name());
        Some(at.next().map_or_else(alone, |address| owner.unit(address, known)))
    }

    /// Where the transmitter stands: transmitter to room, m. By the latest `Model::Transmitter`, else by
    /// `transmitter.pose_in_room` of the stage file, else the identity.
    pub fn room_transmitter(&self) -> &Isometry3<f64> {
        &self.room_transmitter
    }
}

/// Checks, filters and publishes all sensors of a frame.
fn estimate_frame(
    frame: &Frame,
    sensors: &mut [Sensor],
    field: &Field,
    room: &Isometry3<f64>,
    faults: Option<&FaultMapStage>,
    estimate: &mut Estimate,
) {
    estimate.frame = frame.number;
    estimate.t_valid = frame.t_valid;
    estimate.t_closed = frame.t_closed;
    estimate.sigma_t_s = frame.sigma_t_s;
    // Motion in the previous frame: an explicit argument to the stuck test, like the prediction.
    let moving = sensors.iter().filter(|sensor| sensor.is_moving()).count();
    let slots = sensors.iter_mut().zip(&frame.sensors).zip(&mut estimate.sensors);
    for (index, ((sensor, slot), out)) in slots.enumerate() {
        let others_move = moving > usize::from(sensor.is_moving());
        let advice = faults.and_then(|faults| faults.advice(index));
        *out = sensor.estimate(slot, frame, others_move, field, room, advice);
    }
}

#[cfg(test)]
mod tests;
