//! What Lab Streaming Layer receives: poses, joint angles and events as three streams.
//!
//! What comes in: frames, bodies, messages of events. What goes out: the streams' names and channels, and samples with their
//! capture time. What it never does: call liblsl (`posed_daemon` does), or fill a gap: what is not good is not a number.

use posed_drivers::Timestamp;

use crate::{Names, Stamp};
use posed_stage::output::{Body, Estimate};
use posed_stage::{BodyIndex, Stage};

/// Numbers per sensor: position, orientation.
const PER_SENSOR: usize = 7;

/// A stream to be offered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stream {
    /// Its name: the stage's and what it holds.
    pub name: String,
    /// What programs look for: `MoCap`, or `Markers` for events.
    pub kind: &'static str,
    /// Unique and the same after a restart, so that programs that were reading go on.
    pub source_id: String,
    /// Its numbers; none: its samples are one text each.
    pub channels: Vec<Channel>,
}

/// One number of a stream, in the words of the XDF meta-data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Its name: `SENSOR_x` and so on to `SENSOR_qw`, or `JOINT_ANGLE`.
    pub label: String,
    /// What it is: `PositionX` to `PositionZ`, `OrientationX` to `OrientationW`, or `JointAngle`.
    pub kind: &'static str,
    /// Its unit: `meters`, `quaternion` (a component, without unit) or `degrees`.
    pub unit: &'static str,
}

/// One sample of one stream.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Which stream, by its place in [`Streams::list`].
    pub stream: usize,
    /// Capture time of poses and angles, stream time at which an event was decided.
    pub t: Timestamp,
    /// Its numbers or its text.
    pub data: Data,
}

/// What a sample holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Data {
    /// One number per channel, in the order of the channels; NaN where it is not good.
    Numbers(Vec<f64>),
    /// An event: its message in JSON.
    Text(String),
}

/// The streams of a stage.
#[derive(Clone, Debug)]
pub struct Streams {
    list: Vec<Stream>,
    sensors: usize,
    poses_at: Option<usize>,
    /// By body: its stream, and which of its angles are in it.
    angles: Vec<Option<(usize, Vec<usize>)>>,
    events_at: usize,
}

impl Streams {
    /// Those of a stage: poses where it has sensors, joint angles where they are worn, events always.
    pub fn new(stage: &Stage) -> Self {
        let names = Names::new(stage);
        let mut list = Vec::new();
        let mut add = |what: &str, kind, channels: Vec<Channel>| {
            let name = format!("{} {what}", stage.name);
            let source_id = format!("posed {} {what}", stage.name);
            list.push(Stream { name, kind, source_id, channels });
            list.len() - 1
        };
        let poses: Vec<_> = names.sensors().flat_map(|(name, _)| pose(name)).collect();
        let poses_at = (!poses.is_empty()).then(|| add("poses", "MoCap", poses));
        let of_body = |body: BodyIndex| {
            let layout = names.body(body).filter(|layout| !layout.shown_angles.is_empty())?;
            let channel = |angle: &usize| {
                let (joint, angle) = layout.angle(*angle);
                Channel { label: format!("{joint}_{angle}"), kind: "JointAngle", unit: "degrees" }
            };
            let channels = layout.shown_angles.iter().map(channel).collect();
            let what = match stage.bodies.len() {
                1 => "joint angles".to_owned(),
                _ => format!("{} joint angles", names.body_name(body)),
            };
            Some((add(&what, "MoCap", channels), layout.shown_angles.clone()))
        };
        let angles = names.bodies().map(of_body).collect();
        let events_at = add("events", "Markers", Vec::new());
        Self { list, sensors: names.sensor_count(), angles, poses_at, events_at }
    }

    /// What to offer: poses, joint angles of each body, events, in this order; events alone are always there.
    pub fn list(&self) -> &[Stream] {
        &self.list
    }

    /// The poses of a frame: of each sensor, in the stage file's order, its position in the room, m, and its orientation, sensor
    /// to room, a quaternion with its scalar last. NaN where a pose may not be used as good, and for the position of a sensor
    /// that measures none. `None` on a stage without sensors.
    pub fn frame(&self, estimate: &Estimate) -> Option<Sample> {
        let mut numbers = vec![f64::NAN; PER_SENSOR * self.sensors];
        for (numbers, sensor) in numbers.chunks_mut(PER_SENSOR).zip(&estimate.sensors) {
            let Some(pose) = sensor.usable_pose() else { continue };
            let [w, x, y, z] = pose.orientation_wxyz;
            numbers[3..].copy_from_slice(&[x, y, z, w]);
            if let Some(position_m) = pose.position_m {
                numbers[..3].copy_from_slice(&position_m);
            }
        }
        Some(Sample { stream: self.poses_at?, t: estimate.t_valid, data: Data::Numbers(numbers) })
    }

    /// Joint angles of a body, degrees; NaN where one is not known. `None` on a stage whose sensors show no joint angle.
    pub fn body(&self, body: &Body) -> Option<Sample> {
        let (stream, angles) = self.angles.get(usize::from(body.index))?.as_ref()?;
        let degrees = |angle: &usize| body.angles_rad[*angle].map_or(f64::NAN, f64::to_degrees);
        let numbers = angles.iter().map(degrees).collect();
        Some(Sample { stream: *stream, t: body.t_valid, data: Data::Numbers(numbers) })
    }

    /// An event: `json` is the message that our own clients get, `stamp` has its time.
    pub fn event(&self, stamp: &Stamp, json: String) -> Sample {
        Sample { stream: self.events_at, t: stamp.t(), data: Data::Text(json) }
    }
}

/// The channels of a sensor.
fn pose(sensor: &str) -> impl Iterator<Item = Channel> {
    let of = [
        ("x", "PositionX", "meters"),
        ("y", "PositionY", "meters"),
        ("z", "PositionZ", "meters"),
        ("qx", "OrientationX", "quaternion"),
        ("qy", "OrientationY", "quaternion"),
        ("qz", "OrientationZ", "quaternion"),
        ("qw", "OrientationW", "quaternion"),
    ];
    of.into_iter().map(move |(axis, kind, unit)| Channel { label: format!("{sensor}_{axis}"), kind, unit })
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_fusion::body::{ANGLES, Heading};
    use posed_stage::output::{PoseEstimate, PositionSource, SensorEstimate, SensorState};

    #[test]
    fn numbers_stand_where_the_labels_say_and_what_is_not_good_is_none() {
        let stage = Stage::parse(
            "name = \"A\"\n[body]\nheight_m = 1.8\n[[device]]\nname = \"f\"\ndriver = \"flock-of-birds\"\nport = \"auto\"\n\
             [[sensor]]\nname = \"one\"\ndevice = \"f\"\naddress = 1\n[[sensor]]\nname = \"two\"\ndevice = \"f\"\naddress = 2\n\
             segment = \"forearm_r\"\n",
        )
        .unwrap();
        let streams = Streams::new(&stage);
        let names: Vec<_> = streams.list().iter().map(|stream| (stream.name.as_str(), stream.kind)).collect();
        assert_eq!(names, [("A poses", "MoCap"), ("A joint angles", "MoCap"), ("A events", "Markers")]);
        let channels = &streams.list()[0].channels;
        assert_eq!(
            (channels.len(), channels[7].label.as_str(), channels[13].kind),
            (14, "two_x", "OrientationW")
        );
        let pose = PoseEstimate {
            position_m: Some([1.0, 2.0, 3.0]),
            orientation_wxyz: [0.5, -0.5, 0.5, -0.5],
            velocity_m_s: None,
            angular_velocity_rad_s: [0.0; 3],
            covariance: [0.0; 21],
            sigma_m: None,
        };
        let sensor = |state| SensorEstimate { state, pose: Some(pose), ..SensorEstimate::default() };
        let sensors = vec![sensor(SensorState::Suspect), sensor(SensorState::Ok)];
        let estimate = Estimate { t_valid: Timestamp::from_nanos(5), sensors, ..Estimate::default() };
        let Some(Sample { stream: 0, t, data: Data::Numbers(numbers) }) = streams.frame(&estimate) else {
            panic!()
        };
        assert_eq!(t, Timestamp::from_nanos(5));
        assert!(numbers[..7].iter().all(|value| value.is_nan()));
        assert_eq!(numbers[7..], [1.0, 2.0, 3.0, -0.5, 0.5, -0.5, 0.5]);
        let mut angles_rad = [None; ANGLES];
        angles_rad[streams.angles[0].as_ref().unwrap().1[1]] = Some(std::f64::consts::PI);
        let (heading, position_source) = (Heading::Field, PositionSource::Trackers);
        let body = Body {
            index: 0,
            t_valid: Timestamp::ZERO,
            heading,
            heading_sigma_rad: Some(0.02),
            position_source,
            position_sigma_m: Some(0.02),
            contacts: None,
            segments: Vec::new(),
            angles_rad,
            spread: Default::default(),
        };
        let Some(Sample { stream: 1, data: Data::Numbers(degrees), .. }) = streams.body(&body) else {
            panic!()
        };
        assert_eq!(degrees.len(), streams.list()[1].channels.len());
        assert!(degrees[0].is_nan() && (degrees[1] - 180.0).abs() < 1e-12);
    }

    #[test]
    fn a_stage_without_sensors_has_events_only() {
        let streams = Streams::new(&Stage::parse("name = \"A\"").unwrap());
        assert_eq!(streams.list().len(), 1);
        assert_eq!(streams.frame(&Estimate::default()), None);
    }
}
