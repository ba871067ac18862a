//! What changes a pipeline between two frames: models that are swapped in, and requests of clients.
//!
//! In: a [`Model`] or a [`Request`] of the log. Out: whether it can be used now, and the change. What cannot be used changes nothing but a count.

use std::f64::consts::TAU;

use super::Pipeline;
use super::fault_map::FaultMapStage;
use super::input_error::InputError;
use super::sensor::Sensor;
use posed_fusion::noise::TrackerNoise;
use posed_motion::fault_map::FaultMap;
use posed_stage::input::{DeviceIndex, MARK_BYTES, Model, Request, SensorIndex};
use posed_stage::output::{Outcome, OutcomeKind, Output};
use posed_stage::{BodyIndex, body_named};

impl Pipeline {
    /// Whether a model can be used now; [`Input::Model`](crate::Input::Model) then swaps it in, unless it is of a part that this stage does not have.
    ///
    /// # Errors
    /// What stands against it: [`Model::check`], or that there are too many of its kind, or that it costs too much.
    pub fn check_model(&self, model: &Model) -> Result<(), InputError> {
        model.check().map_err(InputError::NoModel)?;
        match model {
            Model::Exercise { exercise } => self.exercise.check_load(exercise),
            Model::Imu { unit, .. } => self.units.check_load(unit),
            _ => Ok(()),
        }
    }

    pub(super) fn swap(&mut self, model: &Model, emit: &mut dyn FnMut(Output<'_>)) {
        let accepted = self.check_model(model).is_ok() && self.apply(model);
        if !accepted {
            self.models_refused += 1;
            return;
        }
        self.models.insert(model);
        // Nothing is measured by a swap; it speaks of the frame before it.
        let t = self.estimate.t_valid;
        emit(Output::Outcome(&Outcome {
            t_valid: t,
            t_decided: t,
            what: OutcomeKind::ModelSwapped(model.clone()),
        }));
        if let Model::Exercise { .. } = model {
            self.exercise.loaded(&self.estimate, &mut |outcome| emit(Output::Outcome(outcome)));
        }
    }

    /// Whether a request about exercises, headings or marks can be carried out now; [`Input::Request`](crate::Input::Request) then does.
    ///
    /// # Errors
    /// What stands against it. Requests about the field are refused here in any case; [`Self::push`] carries
    /// them out all the same.
    pub fn check_request(&self, request: &Request) -> Result<(), InputError> {
        match request {
            Request::HeadingReset { body, sensor, heading_rad } => {
                self.heading(body.as_deref(), sensor.as_deref(), *heading_rad).map(drop)
            }
            Request::Mark { label } if label.len() > MARK_BYTES => {
                Err(InputError::OutOfRange { key: "label", expected: format!("at most {MARK_BYTES} bytes") })
            }
            Request::Mark { .. } => Ok(()),
            _ => self.exercise.check(request),
        }
    }

    /// Whoever wears this sensor asked on the tracker itself that the headings begin anew: looks ahead, along the room's x. Where nobody does, it is the only person
    /// there.
    pub(super) fn asked_on_a_tracker(
        &mut self,
        device: DeviceIndex,
        sensor: Option<SensorIndex>,
        emit: &mut dyn FnMut(Output<'_>),
    ) {
        let body = self.wearer_of(sensor);
        let done = body.is_some_and(|body| self.bodies[usize::from(body)].reset_heading(None, 0.0));
        let text = if done {
            "asked for on a tracker: the headings of the body begin anew, it looks along the room's x"
        } else {
            "a tracker asks that headings begin anew, and there is no IMU on a calibrated human body whose heading drifts"
        };
        emit(Output::Warning { device, text });
    }

    /// The body that wears a sensor, or else the only one.
    pub(super) fn wearer_of(&self, sensor: Option<SensorIndex>) -> Option<BodyIndex> {
        let worn_by = sensor.and_then(|sensor| self.worn_by[usize::from(sensor)]);
        worn_by.or((self.bodies.len() == 1).then_some(0))
    }

    /// The body of that name, or the only one.
    fn body(&self, name: Option<&str>) -> Result<BodyIndex, InputError> {
        Ok(body_named(self.bodies.iter().map(|body| &*body.name), name)?)
    }

    /// The body whose heading is to begin anew, and which of its sensors, `None` for all of them.
    fn heading(
        &self,
        body: Option<&str>,
        sensor: Option<&str>,
        heading_rad: f64,
    ) -> Result<(usize, Option<SensorIndex>), InputError> {
        let index =
            |name: &str| index_of(&self.sensors, name).ok_or_else(|| InputError::NoSensor(name.to_owned()));
        let sensor = sensor.map(index).transpose()?;
        if !(-TAU..=TAU).contains(&heading_rad) {
            let (key, expected) = ("heading_deg", "-360 to 360".to_owned());
            return Err(InputError::OutOfRange { key, expected });
        }
        // Who is not named is who wears the sensor.
        let wearer = if body.is_none() && sensor.is_some() { self.wearer_of(sensor) } else { None };
        let at = usize::from(wearer.map_or_else(|| self.body(body), Ok)?);
        let human = self.bodies.get(at).and_then(|body| body.human.as_ref());
        if human.is_some_and(|human| human.drifts(sensor)) {
            return Ok((at, sensor));
        }
        Err(InputError::NoHeading(
            "there is no IMU on a calibrated human body here whose heading drifts: where the field tells it, nobody has to",
        ))
    }

    pub(super) fn request(&mut self, request: &Request, emit: &mut dyn FnMut(Output<'_>)) {
        // It speaks of the frame before it.
        let t = self.estimate.t_valid;
        let done = match request {
            Request::FieldStart { .. } | Request::FieldFinish {} => {
                self.field.request(request, t, self.sensors.iter().map(Sensor::name), emit)
            }
            Request::HeadingReset { body, sensor, heading_rad } => {
                let about = self.heading(body.as_deref(), sensor.as_deref(), *heading_rad);
                about.is_ok_and(|(at, sensor)| self.bodies[at].reset_heading(sensor, *heading_rad))
            }
            Request::Mark { label } => {
                let noted = label.len() <= MARK_BYTES;
                if noted {
                    let what = OutcomeKind::Mark { label: label.clone() };
                    emit(Output::Outcome(&Outcome { t_valid: t, t_decided: t, what }));
                }
                noted
            }
            Request::ExerciseSelect { .. } | Request::ExerciseReset { .. } => {
                self.exercise.request(request, &self.estimate, &mut |outcome| emit(Output::Outcome(outcome)))
            }
        };
        self.requests_refused += u64::from(!done);
    }

    /// Takes a model whose numbers are right; false where it speaks of nothing that is here.
    fn apply(&mut self, model: &Model) -> bool {
        match model {
            Model::Transmitter { position_m, orientation_wxyz } => {
                let pose = posed_geometry::isometry(*position_m, *orientation_wxyz);
                self.room_transmitter = pose.unwrap_or(self.room_transmitter);
                self.attached.moved();
                pose.is_some()
            }
            Model::TrackerNoise { device, r0_m, sigma_radial_m, sigma_rotation_rad } => {
                let noise = TrackerNoise {
                    r0_m: *r0_m,
                    sigma_radial_m: *sigma_radial_m,
                    sigma_rotation_rad: *sigma_rotation_rad,
                };
                let Some(owner) = self.devices.iter().position(|owner| owner.name == *device) else {
                    return false;
                };
                for sensor in self.sensors.iter_mut().filter(|sensor| usize::from(sensor.device()) == owner) {
                    sensor.set_noise(noise);
                }
                true
            }
            Model::Field { map, .. } => {
                self.field.swap(map.clone());
                true
            }
            Model::Mounting { body, sensors: mounted } => {
                let Ok(at) = self.body(body.as_deref()) else { return false };
                let Self { bodies, sensors, .. } = self;
                let human = bodies.get_mut(usize::from(at)).and_then(|body| body.human.as_mut());
                human.is_some_and(|human| human.mount(mounted, |name| index_of(sensors, name)))
            }
            Model::Chain { body, calibration } => {
                let Ok(at) = self.body(body.as_deref()) else { return false };
                let chain = self.bodies.get_mut(usize::from(at)).and_then(|body| body.chain.as_mut());
                chain.is_some_and(|chain| chain.calibrate(calibration))
            }
            Model::AttachedImu { sensor, quat_wxyz, offset_m, clock_offset_s } => {
                let pose = posed_geometry::isometry(*offset_m, *quat_wxyz);
                index_of(&self.sensors, sensor)
                    .zip(pose)
                    .is_some_and(|(sensor, pose)| self.attached.attach(sensor, &pose, *clock_offset_s))
            }
            Model::Imu { unit, intrinsics } => {
                self.units.load(unit, intrinsics);
                true
            }
            Model::Exercise { exercise } => self.exercise.load(exercise),
            Model::Faults { fault_map } => self.watch_faults(fault_map),
        }
    }

    fn watch_faults(&mut self, fault_map: &FaultMap) -> bool {
        if self.faults.as_mut().is_some_and(|faults| faults.rename(fault_map)) {
            return true;
        }
        let sensors = self.sensors.iter().map(|sensor| (sensor.name(), sensor.is_magnetic()));
        let made = FaultMapStage::new(fault_map, sensors);
        let accepted = made.is_ok();
        self.faults = made.ok().map(Box::new).or(self.faults.take());
        accepted
    }
}

/// The sensor of that name; `None` where the stage has none.
fn index_of(sensors: &[Sensor], name: &str) -> Option<SensorIndex> {
    sensors.iter().position(|sensor| sensor.name() == name).map(|index| index as SensorIndex)
}
