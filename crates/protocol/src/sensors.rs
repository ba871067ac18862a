//! The bodies of `sensors` and `truth`, written straight from a frame for the fields and sensors that a client chose.

use schemars::JsonSchema;
use serde::ser::{Serialize, SerializeSeq, SerializeStruct, Serializer};
use serde::{Deserialize, Serialize as DeriveSerialize};

use super::message::{Change, Measured, Quality};
use super::{Encoding, Names, Stamp, Topic, round};
use posed_stage::input::{SensorIndex, Truth, TruthSensor};
use posed_stage::output::{
    self, Estimate, FrameLabel, PoseEstimate, SensorEstimate, SensorLabel, SensorState,
};

/// Something that a `sensors` entry can say; name and state are always said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, DeriveSerialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Field {
    /// The sensor's name: always there.
    Name,
    /// How far to trust the pose: always there, so that nobody reads a pose without it.
    State,
    /// The device's name.
    Device,
    /// Filtered position.
    PositionM,
    /// Filtered orientation.
    OrientationWxyz,
    /// Expected position error.
    SigmaM,
    /// The raw record; `raw` is another word for it.
    #[serde(alias = "raw")]
    Measured,
    /// Covariance of position and rotation.
    Covariance,
    /// Velocity and angular velocity.
    Velocity,
    /// Expected rotation error; for the frame its number and the standard deviation of its time.
    Quality,
    /// What the fault map reports about the sensor and of the frame; absent where the stage has none.
    Fault,
    /// The statistic of key poses of the sensor; absent where they are not looked for.
    Change,
}

impl Field {
    /// All there are.
    const EVERY: [Self; 12] = [
        Self::Name,
        Self::State,
        Self::Device,
        Self::PositionM,
        Self::OrientationWxyz,
        Self::SigmaM,
        Self::Measured,
        Self::Covariance,
        Self::Velocity,
        Self::Quality,
        Self::Fault,
        Self::Change,
    ];
}

/// A set of [`Field`]s.
#[derive(Clone, Copy, Debug, PartialEq, Eq, DeriveSerialize, Deserialize)]
pub struct Fields(u16);

impl Fields {
    /// Exactly these, and name and state.
    pub fn of(fields: &[Field]) -> Self {
        let always = [Field::Name, Field::State];
        Self(always.iter().chain(fields).fold(0, |set, field| set | 1 << *field as u16))
    }

    /// Everything there is: what a recording holds.
    pub fn all() -> Self {
        Self::of(&Field::EVERY)
    }

    /// The fields of the set.
    pub fn list(self) -> Vec<Field> {
        Field::EVERY.into_iter().filter(|field| self.has(*field)).collect()
    }

    /// Whether all of `others` are in the set.
    pub fn holds(self, others: Self) -> bool {
        others.0 & !self.0 == 0
    }

    /// The set, and what is in `others`.
    #[must_use]
    pub fn with(self, others: Self) -> Self {
        Self(self.0 | others.0)
    }

    /// Whether `field` is in the set.
    pub fn has(self, field: Field) -> bool {
        self.0 & (1 << field as u16) != 0
    }
}

impl Default for Fields {
    /// Name, device, state, position, orientation and sigma.
    fn default() -> Self {
        Self::of(&[Field::Device, Field::PositionM, Field::OrientationWxyz, Field::SigmaM])
    }
}

/// What a client sees of a frame, and how it is written. Clients with equal views share the bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct View {
    /// How it is written.
    pub encoding: Encoding,
    /// What is said of each sensor.
    pub fields: Fields,
    /// Indices of the sensors, ascending; `None` is all.
    pub sensors: Option<Box<[SensorIndex]>>,
}

impl View {
    /// All sensors with the default fields.
    pub fn all(encoding: Encoding) -> Self {
        Self { encoding, fields: Fields::default(), sensors: None }
    }

    /// The view of one topic: only `sensors` and `truth` look different for different choices.
    pub fn for_topic(&self, topic: Topic) -> Self {
        match topic {
            Topic::Sensors | Topic::Truth => self.clone(),
            _ => Self::all(self.encoding),
        }
    }

    fn shows(&self, sensor: SensorIndex) -> bool {
        self.sensors.as_ref().is_none_or(|chosen| chosen.binary_search(&sensor).is_ok())
    }

    fn count(&self, of: usize) -> usize {
        self.sensors.as_ref().map_or(of, |chosen| chosen.len())
    }
}

/// Body of `sensors`.
pub(super) struct SensorsBody<'a> {
    pub(super) stamp: &'a Stamp,
    pub(super) estimate: &'a Estimate,
    pub(super) names: &'a Names,
    pub(super) view: &'a View,
}

impl Serialize for SensorsBody<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let quality = self.view.fields.has(Field::Quality);
        let fault = self.estimate.fault.filter(|_| self.view.fields.has(Field::Fault));
        let length = if quality { 4 } else { 2 } + usize::from(fault.is_some());
        let mut body = serializer.serialize_struct("Sensors", length)?;
        body.serialize_field("t_s", &self.stamp.t_s())?;
        if quality {
            body.serialize_field("frame", &self.estimate.frame)?;
            body.serialize_field("sigma_t_s", &round::significant(self.estimate.sigma_t_s))?;
        }
        if let Some(fault) = fault {
            body.serialize_field("fault", &FrameLabel { distance: fault.distance.map(distance), ..fault })?;
        }
        body.serialize_field("sensors", &Entries(self))?;
        body.end()
    }
}

/// Distances of faults, m or shares of a chain.
fn distance(value: f64) -> f64 {
    round::to(round::VELOCITY, value)
}

struct Entries<'a>(&'a SensorsBody<'a>);

impl Serialize for Entries<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let SensorsBody { estimate, names, view, .. } = self.0;
        let entry = |sensor: SensorIndex, values| Entry { sensor, values, names, fields: view.fields };
        let mut entries = serializer.serialize_seq(Some(view.count(estimate.sensors.len())))?;
        match &view.sensors {
            None => {
                for (sensor, values) in (0..).zip(&estimate.sensors) {
                    entries.serialize_element(&entry(sensor, values))?;
                }
            }
            Some(chosen) => {
                const NOTHING: SensorEstimate = SensorEstimate {
                    state: SensorState::Missing,
                    pose: None,
                    measured: None,
                    fault: None,
                    coasted: false,
                    change: None,
                };
                for &sensor in chosen {
                    let values = estimate.sensors.get(usize::from(sensor)).unwrap_or(&NOTHING);
                    entries.serialize_element(&entry(sensor, values))?;
                }
            }
        }
        entries.end()
    }
}

struct Entry<'a> {
    sensor: SensorIndex,
    values: &'a SensorEstimate,
    names: &'a Names,
    fields: Fields,
}

impl Serialize for Entry<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let has = |field| self.fields.has(field);
        let fault = self.values.fault.filter(|_| has(Field::Fault));
        let change = self.values.change.filter(|_| has(Field::Change));
        let length = self.fields.0.count_ones() as usize + usize::from(has(Field::Velocity))
            - usize::from(has(Field::Fault) && fault.is_none())
            - usize::from(has(Field::Change) && change.is_none());
        let pose = self.values.pose.as_ref();
        let mut entry = serializer.serialize_struct("SensorEntry", length)?;
        entry.serialize_field("name", self.names.sensor(self.sensor))?;
        if has(Field::Device) {
            entry.serialize_field("device", self.names.device_of(self.sensor))?;
        }
        entry.serialize_field("state", &self.values.state)?;
        if has(Field::PositionM) {
            entry.serialize_field(
                "position_m",
                &pose.and_then(|p| Some(round::each(round::POSITION, p.position_m?))),
            )?;
        }
        if has(Field::OrientationWxyz) {
            let orientation = pose.map(|p| round::each(round::QUATERNION, p.orientation_wxyz));
            entry.serialize_field("orientation_wxyz", &orientation)?;
        }
        if has(Field::Measured) {
            entry.serialize_field("measured", &self.values.measured.as_ref().map(measured))?;
        }
        if has(Field::SigmaM) {
            entry
                .serialize_field("sigma_m", &pose.and_then(|p| Some(round::to(round::SIGMA, p.sigma_m?))))?;
        }
        if has(Field::Velocity) {
            entry.serialize_field(
                "velocity_m_s",
                &pose.and_then(|p| Some(round::each(round::VELOCITY, p.velocity_m_s?))),
            )?;
            let angular = pose.map(|p| round::each(round::VELOCITY, p.angular_velocity_rad_s));
            entry.serialize_field("angular_velocity_rad_s", &angular)?;
        }
        if has(Field::Covariance) {
            entry.serialize_field("covariance", &pose.map(|p| p.covariance.map(round::significant)))?;
        }
        if has(Field::Quality) {
            entry.serialize_field("quality", &pose.map(|pose| quality(pose, self.values.coasted)))?;
        }
        if let Some(fault) = fault {
            let distance_m = fault.distance_m.map(distance);
            entry.serialize_field("fault", &SensorLabel { distance_m, ..fault })?;
        }
        if let Some(change) = change {
            entry.serialize_field("change", &self::change(&change))?;
        }
        entry.end()
    }
}

fn change(change: &output::Change) -> Change {
    let steps = round::score(change.threshold);
    Change {
        t_s: round::seconds(round::microseconds(change.t_valid)),
        score: round::to(steps, change.score),
        threshold: round::to(steps, change.threshold),
    }
}

fn measured(measured: &output::Measured) -> Measured {
    let inertial = measured.inertial.unwrap_or_default();
    let vector = |values: Option<[f64; 3]>| values.map(|values| round::each(round::QUATERNION, values));
    Measured {
        t_s: round::seconds(round::microseconds(measured.t_valid)),
        position_m: measured.position_m.map(|p| round::each(round::POSITION, p)),
        orientation_wxyz: measured.orientation_wxyz.map(|q| round::each(round::QUATERNION, q)),
        button: measured.button,
        angular_velocity_rad_s: vector(inertial.angular_velocity_rad_s),
        specific_force_m_s2: vector(inertial.specific_force_m_s2),
        linear_acceleration_m_s2: vector(inertial.linear_acceleration_m_s2),
        magnetic_field: vector(inertial.magnetic_field),
    }
}

/// Rows 3, 4 and 5 of the upper triangle begin at elements 15, 18 and 20.
fn quality(pose: &PoseEstimate, coasted: bool) -> Quality {
    let variance = pose.covariance[15] + pose.covariance[18] + pose.covariance[20];
    Quality { sigma_rotation_rad: round::to(round::SIGMA, variance.max(0.0).sqrt()), coasted }
}

/// Body of `truth`.
pub(super) struct TruthBody<'a> {
    pub(super) stamp: &'a Stamp,
    pub(super) truth: &'a Truth,
    pub(super) names: &'a Names,
    pub(super) view: &'a View,
}

impl Serialize for TruthBody<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut body = serializer.serialize_struct("Truths", 2)?;
        body.serialize_field("t_s", &self.stamp.t_s())?;
        body.serialize_field("sensors", &TruthEntries(self))?;
        body.end()
    }
}

struct TruthEntries<'a>(&'a TruthBody<'a>);

impl Serialize for TruthEntries<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let TruthBody { truth, names, view, .. } = self.0;
        let shown = || truth.sensors.iter().filter(|sensor| view.shows(sensor.sensor));
        let mut entries = serializer.serialize_seq(Some(shown().count()))?;
        for sensor in shown() {
            entries.serialize_element(&TruthEntry { sensor, names, fields: view.fields })?;
        }
        entries.end()
    }
}

struct TruthEntry<'a> {
    sensor: &'a TruthSensor,
    names: &'a Names,
    fields: Fields,
}

impl Serialize for TruthEntry<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let has = |field| self.fields.has(field);
        let optional = [Field::Device, Field::PositionM, Field::OrientationWxyz, Field::SigmaM];
        let length = 3 + optional.into_iter().filter(|field| has(*field)).count();
        let mut entry = serializer.serialize_struct("TruthEntry", length)?;
        entry.serialize_field("name", self.names.sensor(self.sensor.sensor))?;
        if has(Field::Device) {
            entry.serialize_field("device", self.names.device_of(self.sensor.sensor))?;
        }
        entry.serialize_field("state", &SensorState::Ok)?;
        if has(Field::PositionM) {
            entry.serialize_field("position_m", &round::each(round::POSITION, self.sensor.position_m))?;
        }
        if has(Field::OrientationWxyz) {
            let orientation = round::each(round::QUATERNION, self.sensor.orientation_wxyz);
            entry.serialize_field("orientation_wxyz", &orientation)?;
        }
        if has(Field::SigmaM) {
            entry.serialize_field("sigma_m", &0.0)?;
        }
        entry.serialize_field("class", &self.sensor.class)?;
        entry.end()
    }
}
