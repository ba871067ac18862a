//! Poses, joint angles and measurements as messages of ROS 2, for programs that listen by rmw_zenoh.
//!
//! What comes in: frames and bodies. What goes out: topics with their keys and tokens, and messages as CDR with the capture time in UTC. What it never
//! does: open a session (`posed-mesh` does), ask a clock, or send what may not be used as good: that is left out, and where a message must have it, its covariance
//! says that it is not known.
//!
//! Frames: all are children of the room, whatever their sensors hang on, so that what is not shown breaks no chain. Right-handed, z up, m, rad, s; quaternions have their scalar last.

mod cdr;
mod keys;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector3};

use self::cdr::Cdr;
use self::keys::{Kind, Names, plain};
pub use self::keys::{Node, Topic, attachment, gid};
use crate::rate::Rate;
use posed_geometry::{orientation_from_wxyz, orientation_to_wxyz, so3};
use posed_stage::Stage;
use posed_stage::layout::BodyLayout;
use posed_stage::output::{Body, Estimate, PoseEstimate, SensorEstimate};

/// Where the router of ROS 2 listens by custom.
pub const DEFAULT_ROUTER: &str = "tcp/localhost:7447";
/// The room, unless the stage file names it.
const DEFAULT_FRAME: &str = "map";
/// First number of a covariance that is not known.
const UNKNOWN: f64 = -1.0;

/// Turns frames and bodies into messages.
#[derive(Clone, Debug)]
pub struct Publisher {
    node: Node,
    topics: Vec<Topic>,
    epoch_utc_ns: i64,
    /// The room.
    frame: String,
    tf: usize,
    sensors: Vec<Sensor>,
    bodies: Vec<Worn>,
    frames: Rate,
}

#[derive(Clone, Debug)]
struct Sensor {
    frame: String,
    topic: usize,
    /// It measures no place.
    is_imu: bool,
}

#[derive(Clone, Debug)]
struct Worn {
    /// Its segments' frames; empty without places.
    frames: Vec<String>,
    /// Index and name of each angle that may be shown.
    joints: Vec<(usize, String)>,
    joint_states: usize,
    rate: Rate,
}

impl Publisher {
    /// For a stage whose epoch was at this time, ns since 1970, as `[ros2]` of its file has it.
    pub fn new(stage: &Stage, settings: &posed_stage::Ros2, epoch_utc_ns: i64) -> Self {
        let namespace = settings.namespace.clone().unwrap_or_default();
        let below =
            |name: &str| if namespace.is_empty() { name.to_owned() } else { format!("{namespace}/{name}") };
        let rate = || settings.rate_hz.map_or(Rate::every(0.0), |rate_hz| Rate::every(1.0 / rate_hz));
        let mut topics = Vec::new();
        let mut add = |name: String, kind| {
            topics.push(Topic { name, kind });
            topics.len() - 1
        };
        // One tree for all robots and stages: the namespace is in the names of the frames.
        let tf = add("tf".to_owned(), Kind::TfMessage);
        let mut names = Names::default();
        let mut sensors = Vec::new();
        for sensor in &stage.sensors {
            let frame = below(&names.of(&sensor.name));
            let is_imu = stage.is_imu(sensor);
            let (topic, kind) = if is_imu { ("imu/data", Kind::Imu) } else { ("pose", Kind::PoseStamped) };
            let topic = add(format!("{frame}/{topic}"), kind);
            sensors.push(Sensor { frame, topic, is_imu });
        }
        let several = stage.bodies.len() > 1;
        let mut bodies = Vec::new();
        for (body, layout) in stage.bodies.iter().zip(BodyLayout::all(stage)) {
            let topic = if several {
                format!("{}/joint_states", plain(&body.name))
            } else {
                "joint_states".to_owned()
            };
            let joint_states = add(below(&topic), Kind::JointState);
            let layout = layout.as_ref();
            let frames =
                layout.into_iter().flat_map(|layout| layout.places().map(str::to_owned).collect::<Vec<_>>());
            let frames =
                frames.map(|segment| below(&names.of(&format!("{} {segment}", body.name)))).collect();
            let joints = layout.into_iter().flat_map(|layout| {
                let name = |index: &usize| {
                    let (joint, angle) = layout.angle(*index);
                    (*index, format!("{joint}_{angle}"))
                };
                layout.shown_angles.iter().map(name).collect::<Vec<_>>()
            });
            bodies.push(Worn { frames, joints: joints.collect(), joint_states, rate: rate() });
        }
        let node = Node {
            domain_id: settings.domain_id,
            namespace,
            name: format!("posed_{}", plain(&stage.file_name())),
        };
        let frame = settings.frame.clone().unwrap_or_else(|| DEFAULT_FRAME.to_owned());
        Self { node, topics, epoch_utc_ns, frame, tf, sensors, bodies, frames: rate() }
    }

    /// Who publishes.
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// What it publishes; messages name a topic by its place here.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Gives `emit` the messages of a frame, if one is due: the pose of each tracker that may be used as good, all of them as transforms, and what each IMU has
    /// measured, at the time of that measurement.
    pub fn frame(&mut self, estimate: &Estimate, mut emit: impl FnMut(usize, Vec<u8>)) {
        if !self.frames.is_due(estimate.t_valid.as_secs_f64()) {
            return;
        }
        let utc_ns = self.epoch_utc_ns + estimate.t_valid.as_nanos();
        let mut transforms = Vec::new();
        for (sensor, found) in self.sensors.iter().zip(&estimate.sensors) {
            if sensor.is_imu {
                self.imu(sensor, found, estimate).into_iter().for_each(|message| emit(sensor.topic, message));
                continue;
            }
            let Some(pose) = found.usable_pose() else { continue };
            let Some(position_m) = pose.position_m else { continue };
            let mut message = Cdr::new();
            message.header(utc_ns, &self.frame);
            message.numbers(&position_m);
            message.numbers(&scalar_last(pose.orientation_wxyz));
            emit(sensor.topic, message.finish());
            transforms.push((&*sensor.frame, position_m, pose.orientation_wxyz));
        }
        self.transforms(utc_ns, &transforms, emit);
    }

    /// Gives `emit` the messages of a body, if one is due: the angles that are known, and the segments that are shown as transforms.
    pub fn body(&mut self, body: &Body, mut emit: impl FnMut(usize, Vec<u8>)) {
        let Some(worn) = self.bodies.get_mut(usize::from(body.index)) else { return };
        if !worn.rate.is_due(body.t_valid.as_secs_f64()) {
            return;
        }
        let worn = &self.bodies[usize::from(body.index)];
        let utc_ns = self.epoch_utc_ns + body.t_valid.as_nanos();
        let known = worn.joints.iter().filter_map(|(index, name)| Some((name, body.angles_rad[*index]?)));
        let (names, angles_rad): (Vec<&String>, Vec<f64>) = known.unzip();
        if !names.is_empty() {
            let mut message = Cdr::new();
            message.header(utc_ns, "");
            message.count(names.len());
            names.iter().for_each(|name| message.text(name));
            message.count(angles_rad.len());
            message.numbers(&angles_rad);
            // Neither velocities nor efforts.
            message.count(0);
            message.count(0);
            emit(worn.joint_states, message.finish());
        }
        let shown = worn.frames.iter().zip(&body.segments).filter(|(_, segment)| segment.state.is_shown());
        let transforms: Vec<_> = shown
            .filter_map(|(frame, segment)| Some((&**frame, segment.position_m?, segment.orientation_wxyz?)))
            .collect();
        self.transforms(utc_ns, &transforms, emit);
    }

    /// `tf2_msgs/TFMessage`: frames, where they are in the room, m, and how they are turned in it, scalar first.
    fn transforms(
        &self,
        utc_ns: i64,
        transforms: &[(&str, [f64; 3], [f64; 4])],
        mut emit: impl FnMut(usize, Vec<u8>),
    ) {
        if transforms.is_empty() {
            return;
        }
        let mut message = Cdr::new();
        message.count(transforms.len());
        for (frame, position_m, orientation_wxyz) in transforms {
            message.header(utc_ns, &self.frame);
            message.text(frame);
            message.numbers(position_m);
            message.numbers(&scalar_last(*orientation_wxyz));
        }
        emit(self.tf, message.finish());
    }

    /// `sensor_msgs/Imu` of what a sensor measured for a frame, at the time of the measurement; `None` where it measured nothing of this.
    fn imu(&self, sensor: &Sensor, found: &SensorEstimate, estimate: &Estimate) -> Option<Vec<u8>> {
        let measured = found.measured.as_ref()?;
        let inertial = measured.inertial.as_ref()?;
        let [turn, force] = match inertial.sample() {
            Some(sample) => [Some(sample.gyro_rad_s.into()), Some(sample.accel_m_s2.into())],
            None => [inertial.angular_velocity_rad_s, inertial.specific_force_m_s2],
        };
        if turn.is_none() && force.is_none() {
            return None;
        }
        let before_s = estimate.t_valid.seconds_since(measured.t_valid);
        let orientation = found.usable_pose().and_then(|pose| orientation(pose, before_s));
        let mut message = Cdr::new();
        message.header(self.epoch_utc_ns + measured.t_valid.as_nanos(), &sensor.frame);
        let (orientation_wxyz, covariance) = orientation.unwrap_or(([1.0, 0.0, 0.0, 0.0], unknown()));
        message.numbers(&scalar_last(orientation_wxyz));
        message.numbers(covariance.as_slice());
        for vector in [turn, force] {
            message.numbers(&vector.unwrap_or_default());
            // How good it is nobody has measured: all zero; that there is none is something else.
            let covariance = if vector.is_some() { Matrix3::zeros() } else { unknown() };
            message.numbers(covariance.as_slice());
        }
        Some(message.finish())
    }
}

/// The orientation of a sensor so long before its pose, sensor to room, scalar first, and the covariance of its error about the room's axes, rad².
fn orientation(pose: &PoseEstimate, before_s: f64) -> Option<([f64; 4], Matrix3<f64>)> {
    let now = orientation_from_wxyz(pose.orientation_wxyz)?;
    let then = now * so3::exp(&(Vector3::from(pose.angular_velocity_rad_s) * -before_s));
    let c = &pose.covariance;
    let of_sensor = Matrix3::new(c[15], c[16], c[17], c[16], c[18], c[19], c[17], c[19], c[20]);
    let turn = then.to_rotation_matrix();
    Some((orientation_to_wxyz(&then), turn * of_sensor * turn.inverse()))
}

fn unknown() -> Matrix3<f64> {
    let mut covariance = Matrix3::zeros();
    covariance[0] = UNKNOWN;
    covariance
}

fn scalar_last([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [x, y, z, w]
}
