//! What a live stage saw of every frame of a recording, row by row.
//!
//! What comes in: a recording. What goes out: the columns of [`signals::columns`] and of the body, and a row per frame. Only the
//! newest row is kept.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::TableError;
use super::poses::{SensorEntry, SensorsMessage};
use crate::{Item, ReadError, Take};
use posed_stage::Stage;
use posed_stage::layout::BodyLayout;
use posed_stage::signals::{self, InertialColumns};

/// A recording as named channels over time.
pub struct RecordedStreams {
    path: PathBuf,
    take: Take<BufReader<File>>,
    sensors: Vec<String>,
    inertial: InertialColumns,
    /// Joint and angle of those of the body.
    angles: Vec<(String, &'static str)>,
    columns: Vec<String>,
    row: Vec<Option<f64>>,
    body: Option<BodyMessage>,
}

impl RecordedStreams {
    /// Opens a recording.
    ///
    /// # Errors
    /// It is damaged, or is none.
    pub fn open(path: &Path) -> Result<Self, TableError> {
        let take = Take::open(path)
            .map_err(|source| TableError::Recording { file: path.display().to_string(), source })?;
        let sensors = take.header().sensors.clone();
        let mut columns = signals::columns(sensors.iter().map(String::as_str));
        let stage = Stage::parse(&take.header().stage_toml).ok();
        let layout = stage.as_ref().and_then(BodyLayout::of);
        let inertial = stage.as_ref().map(InertialColumns::of).unwrap_or_default();
        columns.extend(stage.iter().flat_map(|stage| inertial.names(stage)));
        columns.extend(layout.iter().flat_map(BodyLayout::columns));
        let names = |layout: &BodyLayout| -> Vec<(String, &'static str)> {
            let name = |index: &usize| layout.angle(*index);
            layout.shown_angles.iter().map(name).map(|(joint, angle)| (joint.to_owned(), angle)).collect()
        };
        let angles = layout.as_ref().map_or_else(Vec::new, names);
        let row = Vec::with_capacity(columns.len());
        Ok(Self { path: path.to_owned(), take, sensors, inertial, angles, columns, row, body: None })
    }

    /// Names of the channels: of each sensor those of [`signals::columns`] (room, m, unit quaternion), of inertial sensors
    /// without a body those of [`signals::inertial_columns`], of a body its joint angles (`JOINT_ANGLE_deg`). A stage file of
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
                self.body = Some(BodyMessage::parse(&message.json)?);
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
            let fresh = self.body.as_ref().filter(|body| message.t_s - body.t_s <= signals::BODY_AGE_S);
            self.row.extend(self.angles.iter().map(|(joint, angle)| fresh?.angle_deg(joint, angle)));
            return Ok(Some(message.t_s));
        }
        Ok(None)
    }
}

/// What streams need of a `body` message.
#[derive(Deserialize)]
struct BodyMessage {
    t_s: f64,
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
