//! A frame's poses on their way to a hub: of each sensor only what somebody there wants.
//!
//! Numbers are whole, as the stage has them, so that the hub's messages are the stage's, to the byte.

use serde::{Deserialize, Serialize};

use posed_drivers::Timestamp;
use posed_protocol::{Field, Fields, Selection};
use posed_stage::output::{
    Change, Estimate, FrameLabel, Measured, PoseEstimate, SensorEstimate, SensorLabel, SensorState,
};

/// Where the covariance has the variances of the rotation.
const ROTATION: [usize; 3] = [15, 18, 20];

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Frame {
    held: Selection,
    frame: u64,
    t_valid: Timestamp,
    t_closed: Timestamp,
    sigma_t_s: f64,
    fault: Option<FrameLabel>,
    /// One per sensor of the stage file; `None` of one that nobody wants.
    sensors: Vec<Option<Part>>,
}

/// What is wanted of a sensor.
#[derive(Debug, Serialize, Deserialize)]
struct Part {
    state: SensorState,
    coasted: bool,
    pose: Option<PosePart>,
    measured: Option<Measured>,
    fault: Option<SensorLabel>,
    change: Option<Change>,
}

/// What is wanted of a pose.
#[derive(Debug, Serialize, Deserialize)]
struct PosePart {
    position_m: Option<[f64; 3]>,
    orientation_wxyz: Option<[f64; 4]>,
    velocity_m_s: Option<[f64; 3]>,
    angular_velocity_rad_s: Option<[f64; 3]>,
    sigma_m: Option<f64>,
    /// Of the rotation, where the covariance is not wanted.
    variance: Option<[f64; 3]>,
    covariance: Option<[f64; 21]>,
}

impl Frame {
    /// So much of a frame.
    pub(crate) fn of(estimate: &Estimate, selection: &Selection) -> Self {
        let Estimate { frame, t_valid, t_closed, sigma_t_s, fault, ref sensors } = *estimate;
        let fields = selection.fields;
        let part = |values| Part::of(values, fields);
        let sensors =
            (0..).zip(sensors).map(|(sensor, values)| selection.has_sensor(sensor).then(|| part(values)));
        Self {
            held: selection.clone(),
            frame,
            t_valid,
            t_closed,
            sigma_t_s,
            fault: fault.filter(|_| fields.has(Field::Fault)),
            sensors: sensors.collect(),
        }
    }

    /// The frame, and how much of it is there; the rest is blank.
    pub(crate) fn into_estimate(self) -> (Estimate, Selection) {
        let Self { held, frame, t_valid, t_closed, sigma_t_s, fault, sensors } = self;
        let values = |part: Option<Part>| part.map(Part::into_values).unwrap_or_default();
        let sensors = sensors.into_iter().map(values).collect();
        (Estimate { frame, t_valid, t_closed, sigma_t_s, fault, sensors }, held)
    }
}

impl Part {
    fn of(values: &SensorEstimate, fields: Fields) -> Self {
        let SensorEstimate { state, pose, measured, fault, coasted, change } = *values;
        Self {
            state,
            coasted,
            pose: pose.map(|pose| PosePart::of(&pose, fields)),
            measured: measured.filter(|_| fields.has(Field::Measured)),
            fault: fault.filter(|_| fields.has(Field::Fault)),
            change: change.filter(|_| fields.has(Field::Change)),
        }
    }

    fn into_values(self) -> SensorEstimate {
        let Self { state, coasted, pose, measured, fault, change } = self;
        SensorEstimate { state, pose: pose.map(PosePart::into_pose), measured, fault, coasted, change }
    }
}

impl PosePart {
    fn of(pose: &PoseEstimate, fields: Fields) -> Self {
        let has = |field| fields.has(field);
        let PoseEstimate {
            position_m,
            orientation_wxyz,
            velocity_m_s,
            angular_velocity_rad_s,
            covariance,
            sigma_m,
        } = *pose;
        let only_rotation = has(Field::Quality) && !has(Field::Covariance);
        Self {
            position_m: position_m.filter(|_| has(Field::PositionM)),
            orientation_wxyz: has(Field::OrientationWxyz).then_some(orientation_wxyz),
            velocity_m_s: velocity_m_s.filter(|_| has(Field::Velocity)),
            angular_velocity_rad_s: has(Field::Velocity).then_some(angular_velocity_rad_s),
            sigma_m: sigma_m.filter(|_| has(Field::SigmaM)),
            variance: only_rotation.then(|| ROTATION.map(|at| covariance[at])),
            covariance: has(Field::Covariance).then_some(covariance),
        }
    }

    fn into_pose(self) -> PoseEstimate {
        let Self {
            position_m,
            orientation_wxyz,
            velocity_m_s,
            angular_velocity_rad_s,
            sigma_m,
            variance,
            covariance,
        } = self;
        let mut covariance = covariance.unwrap_or([0.0; 21]);
        for (at, variance) in ROTATION.into_iter().zip(variance.into_iter().flatten()) {
            covariance[at] = variance;
        }
        PoseEstimate {
            position_m,
            orientation_wxyz: orientation_wxyz.unwrap_or([1.0, 0.0, 0.0, 0.0]),
            velocity_m_s,
            angular_velocity_rad_s: angular_velocity_rad_s.unwrap_or_default(),
            covariance,
            sigma_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_protocol::{Encoding, Names, Payload, Stamp, Topic, View, encode};
    use posed_stage::Stage;
    use posed_stage::input::SensorIndex;

    fn estimate() -> Estimate {
        let number = |n: usize| 1.0 / (n as f64 + 3.0);
        let sensor = |n: usize| {
            let pose = PoseEstimate {
                position_m: (n != 1).then(|| [0, 1, 2].map(number)),
                orientation_wxyz: [0.5; 4],
                velocity_m_s: Some([3, 4, 5].map(number)),
                angular_velocity_rad_s: [6, 7, 8].map(number),
                covariance: std::array::from_fn(number),
                sigma_m: Some(number(n)),
            };
            let measured = Measured {
                t_valid: Timestamp::from_nanos(5_000 * n as i64),
                position_m: Some([1, 2, 3].map(number)),
                clipped: false,
                orientation_wxyz: None,
                button: Some(3),
                inertial: None,
            };
            let (state, pose, measured) = (SensorState::Ok, (n != 2).then_some(pose), Some(measured));
            SensorEstimate { state, pose, measured, coasted: n == 0, ..SensorEstimate::default() }
        };
        Estimate { frame: 7, sigma_t_s: 1e-4, sensors: (0..4).map(sensor).collect(), ..Estimate::default() }
    }

    /// Whatever is asked for, the hub's message is that of the stage.
    #[test]
    fn what_is_asked_for_is_shown_as_at_the_stage() {
        let mut stage =
            "name = \"s\"\n[[device]]\nname = \"d\"\ndriver = \"flock-of-birds\"\nport = \"/dev/x\"\n"
                .to_owned();
        for n in 1..=4 {
            stage += &format!("[[sensor]]\nname = \"s{n}\"\ndevice = \"d\"\naddress = {n}\n");
        }
        let names = Names::new(&Stage::parse(&stage).unwrap());
        let whole = estimate();
        let stamp = Stamp { topic: Topic::Sensors, body: 0, t_us: 1, event_id: None, timecode: None };
        let message = |estimate: &Estimate, view: &View| {
            let mut out = Vec::new();
            encode::body(&Payload::Estimate(estimate), &stamp, &names, view, &mut out);
            String::from_utf8(out).unwrap()
        };
        let all = Fields::all().list();
        let (mut least, mut most) = (usize::MAX, 0);
        for chosen in 0..1_u32 << all.len() {
            let fields: Vec<Field> =
                (0..).zip(&all).filter(|(bit, _)| chosen & 1 << *bit != 0).map(|(_, field)| *field).collect();
            let sensors: Option<Box<[SensorIndex]>> =
                (chosen % 3 > 0).then(|| (0..3).filter(|n| chosen >> n & 1 == 1).collect());
            let selection = Selection { fields: Fields::of(&fields), sensors };
            let bytes = rmp_serde::to_vec(&Frame::of(&whole, &selection)).unwrap();
            (least, most) = (least.min(bytes.len()), most.max(bytes.len()));
            let (part, held) = rmp_serde::from_slice::<Frame>(&bytes).unwrap().into_estimate();
            let view = View {
                encoding: Encoding::Json,
                fields: selection.fields,
                sensors: selection.sensors.clone(),
            };
            assert!(held.covers(&view));
            assert_eq!(message(&part, &view), message(&whole, &view), "{fields:?}");
        }
        assert!(least * 10 < most, "{least} to {most} bytes");
        assert_eq!(Frame::of(&whole, &Selection::whole()).into_estimate().0, whole);
    }
}
