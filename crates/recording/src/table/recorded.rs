//! What a live stage saw of every frame of a recording, row by row.
//!
//! What comes in: a recording. What goes out: the columns of [`signals::columns`] and of the bodies, and a row per frame. Only the
//! newest row is kept.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::TableError;
use super::poses::{SensorEntry, SensorsMessage};
use crate::{Item, ReadError, Take};
use posed_stage::layout::BodyLayout;
use posed_stage::signals::{self, InertialColumns, prefix_of};
use posed_stage::{BodyIndex, Stage};

/// A recording as named channels over time.
pub struct RecordedStreams {
    path: PathBuf,
    take: Take<BufReader<File>>,
    sensors: Vec<String>,
    inertial: InertialColumns,
    /// Index of the body, joint and angle of those of bodies.
    angles: Vec<(usize, String, &'static str)>,
    /// Names of the bodies, in the stage's order.
    bodies: Vec<String>,
    columns: Vec<String>,
    row: Vec<Option<f64>>,
    /// The newest of each body.
    newest: Vec<Option<BodyMessage>>,
}

impl RecordedStreams {
    /// Opens a recording; with `body` of several bodies that one's joints alone, named as those of an only one.
    ///
    /// # Errors
    /// It is damaged, or is none, or has no such body.
    pub fn open(path: &Path, body: Option<&str>) -> Result<Self, TableError> {
        let take = Take::open(path)
            .map_err(|source| TableError::Recording { file: path.display().to_string(), source })?;
        let sensors = take.header().sensors.clone();
        let mut columns = signals::columns(sensors.iter().map(String::as_str));
        let stage = Stage::parse(&take.header().stage_toml).ok();
        let inertial = stage.as_ref().map(InertialColumns::of).unwrap_or_default();
        columns.extend(stage.iter().flat_map(|stage| inertial.names(stage)));
        let layouts = stage.as_ref().map(BodyLayout::all).unwrap_or_default();
        let bodies: Vec<String> =
            stage.iter().flat_map(|stage| &stage.bodies).map(|body| body.name.clone()).collect();
        if let Some(name) = body.filter(|name| !bodies.iter().any(|known| known == name)) {
            let reason = format!("its stage has no body {name:?}");
            let source = ReadError::NotARecording(reason);
            return Err(TableError::Recording { file: path.display().to_string(), source });
        }
        let mut angles = Vec::new();
        for (index, layout) in layouts.iter().enumerate() {
            let wanted = body.is_none_or(|name| bodies[index] == name);
            let Some(layout) = layout.as_ref().filter(|_| wanted) else { continue };
            let prefix =
                stage.as_ref().filter(|_| body.is_none()).map(|stage| prefix_of(stage, index as BodyIndex));
            let prefix = prefix.unwrap_or_default();
            columns.extend(layout.columns().map(|column| format!("{prefix}{column}")));
            let name = |angle: &usize| {
                let (joint, angle) = layout.angle(*angle);
                (index, joint.to_owned(), angle)
            };
            angles.extend(layout.shown_angles.iter().map(name));
        }
        let row = Vec::with_capacity(columns.len());
        let newest = bodies.iter().map(|_| None).collect();
        Ok(Self { path: path.to_owned(), take, sensors, inertial, angles, bodies, columns, row, newest })
    }

    /// Names of the channels: of each sensor those of [`signals::columns`] (room, m, unit quaternion), of inertial sensors
    /// without a body those of [`signals::inertial_columns`], of bodies their joint angles (`JOINT_ANGLE_deg`, of several `NAME.JOINT_ANGLE_deg`). A stage file of
    /// another version shows the first kind alone.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// Values of the newest row, in the order of the columns; empty before the first. `None` where a sensor has no pose that may
    /// be used as good, and for angles that are not known or older than 0.05 s ([`signals::BODY_AGE_S`]).
    pub fn row(&self) -> &[Option<f64>] {
        &self.row
    }

    /// Goes on to the next row; returns its capture time, s, or `None` at the end.
    ///
    /// # Errors
    /// The recording is damaged.
    pub fn next_row(&mut self) -> Result<Option<f64>, TableError> {
        self.next().map_err(|source| TableError::Recording { file: self.path.display().to_string(), source })
    }

    fn next(&mut self) -> Result<Option<f64>, ReadError> {
        for item in self.take.by_ref() {
            let Item::Message(message) = item? else { continue };
            if &*message.topic == "body" && !self.angles.is_empty() {
                let body = BodyMessage::parse(&message.json)?;
                // A single one of an earlier version has no name.
                let at = self.bodies.iter().position(|name| *name == body.name).unwrap_or(0);
                self.newest[at] = Some(body);
            }
            if &*message.topic != "sensors" {
                continue;
            }
            let message = SensorsMessage::parse(&message.json)?;
            self.row.clear();
            for name in &self.sensors {
                let usable = |entry: &&SensorEntry| entry.name == *name && entry.state.is_usable();
                let entry = message.sensors.iter().find(usable);
                let position_m = entry.and_then(|entry| entry.position_m);
                let orientation_wxyz = entry.and_then(|entry| entry.orientation_wxyz);
                signals::append(position_m, orientation_wxyz, &mut self.row);
            }
            for index in self.inertial.sensors() {
                let name = self.sensors.get(*index);
                let usable = |entry: &&SensorEntry| name == Some(&entry.name) && entry.state.is_usable();
                let measured = message.sensors.iter().find(usable).and_then(|entry| entry.measured.as_ref());
                let specific_force_m_s2 = measured.and_then(|measured| measured.specific_force_m_s2);
                let angular_velocity_rad_s = measured.and_then(|measured| measured.angular_velocity_rad_s);
                signals::append_inertial(specific_force_m_s2, angular_velocity_rad_s, &mut self.row);
            }
            let newest = &self.newest;
            let fresh = |body: &&BodyMessage| message.t_s - body.t_s <= signals::BODY_AGE_S;
            self.row.extend(
                self.angles.iter().map(|(body, joint, angle)| {
                    newest[*body].as_ref().filter(fresh)?.angle_deg(joint, angle)
                }),
            );
            return Ok(Some(message.t_s));
        }
        Ok(None)
    }
}

/// What streams need of a `body` message.
#[derive(Deserialize)]
struct BodyMessage {
    t_s: f64,
    #[serde(default)]
    name: String,
    joints: Vec<Joint>,
}

#[derive(Deserialize)]
struct Joint {
    name: String,
    angles_deg: BTreeMap<String, Option<f64>>,
}

impl BodyMessage {
    fn parse(json: &[u8]) -> Result<Self, ReadError> {
        serde_json::from_slice(json)
            .map_err(|error| ReadError::NotARecording(format!("a `body` message cannot be read: {error}")))
    }

    /// The angle of that name, degrees.
    fn angle_deg(&self, joint: &str, angle: &str) -> Option<f64> {
        let joint = self.joints.iter().find(|known| known.name == joint)?;
        joint.angles_deg.get(angle).copied().flatten()
    }
}
