//! Topic `field`: events of the field's models, of disturbances, of a guided calibration.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Names, round};
use posed_field::{Cause, Progress, Warning, arrows};
use posed_stage::input::{Model, SensorIndex};
use posed_stage::output::FieldNews;

/// Arrows that a client is given of a map.
const ARROWS: usize = 150;

/// Body of `field`: an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FieldEvent {
    /// Stream time at which it was decided, s; rises strictly (by 1 µs between events of one frame).
    pub t_s: f64,
    /// Stage-wide number of the event, from 1.
    pub event_id: u64,
    /// Capture time it speaks of, s.
    pub t_valid_s: f64,
    /// What happened.
    #[serde(flatten)]
    pub change: FieldChange,
}

/// What happened to the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum FieldChange {
    /// A model was swapped in between two frames.
    ModelSwapped {
        /// The model, in full.
        model: Model,
    },
    /// A map was swapped in between two frames, or taken away.
    MapSwapped {
        /// Its number on this stage, 0 for none.
        version: u32,
        /// What it is made of; null: poses are not corrected.
        map: Option<String>,
        /// Rms distance from straight poles when it was made, m: without correction, and with it; null without a map.
        raw_m: Option<f64>,
        /// See `raw_m`.
        residual_m: Option<f64>,
        /// The same on blocks that were held out, m.
        heldout_m: Option<f64>,
        /// Rms at the anchors, m; null without three.
        anchors_m: Option<f64>,
        /// What it does: pairs of a reading and its corrected place all over the calibrated volume, transmitter frame, m.
        arrows_m: Vec<[[f64; 3]; 2]>,
    },
    /// Metal or the mains disturb the field, or do so no longer. Meanwhile poses are less certain and nothing is learnt.
    Disturbed {
        /// Began or ended.
        active: bool,
        /// What tells of it.
        cause: Cause,
        /// The reference sensor, or the pair.
        sensors: Vec<String>,
        /// How far off they are, m.
        deviation_m: f64,
    },
    /// The field has changed for good: calibrate again.
    Drifted {
        /// The reference sensor, or the pair.
        sensors: Vec<String>,
        /// How far off they have stayed, m.
        deviation_m: f64,
    },
    /// How far a guided calibration is, once a second.
    Calibrating {
        /// Where it is.
        progress: Progress,
    },
}

impl FieldChange {
    /// Of a swapped model: a map is megabytes to nobody's use.
    pub(crate) fn swapped(model: &Model) -> Self {
        let Model::Field { version, map } = model else {
            return Self::ModelSwapped { model: model.clone() };
        };
        let report = map.as_ref().map(|map| &map.map().report);
        let finite = |x: f64| x.is_finite().then(|| round::to(round::SIGMA, x));
        Self::MapSwapped {
            version: *version,
            map: report.map(|report| report.model.clone()),
            raw_m: report.and_then(|report| finite(report.raw_m)),
            residual_m: report.and_then(|report| finite(report.residual_m)),
            heldout_m: report.and_then(|report| finite(report.heldout_m)),
            anchors_m: report.and_then(|report| report.anchors_m).and_then(finite),
            arrows_m: map.as_ref().map_or_else(Vec::new, |map| {
                let rounded = |p: [f64; 3]| p.map(|x| round::to(round::POSITION, x));
                arrows(map, ARROWS).into_iter().map(|arrow| arrow.map(rounded)).collect()
            }),
        }
    }

    /// Of what the pipeline reports.
    pub(crate) fn news(news: &FieldNews, names: &Names) -> Self {
        let named = |sensors: &[usize; 2]| {
            let mut named: Vec<String> =
                sensors.iter().map(|sensor| names.sensor(*sensor as SensorIndex).to_owned()).collect();
            named.dedup();
            named
        };
        let length = |x: f64| round::to(round::SIGMA, x);
        match news {
            FieldNews::Warning(Warning::Disturbed { cause, sensors, deviation_m, active }) => {
                Self::Disturbed {
                    active: *active,
                    cause: *cause,
                    sensors: named(sensors),
                    deviation_m: length(*deviation_m),
                }
            }
            FieldNews::Warning(Warning::Drifted { sensors, deviation_m }) => {
                Self::Drifted { sensors: named(sensors), deviation_m: length(*deviation_m) }
            }
            FieldNews::Progress(progress) => Self::Calibrating {
                progress: Progress {
                    seconds: round::to(1e1, progress.seconds),
                    covered: round::to(1e3, progress.covered),
                    unvisited_m: progress.unvisited_m.iter().map(|p| p.map(|x| round::to(1e2, x))).collect(),
                    residual_m: length(progress.residual_m),
                    ..progress.clone()
                },
            },
        }
    }
}
