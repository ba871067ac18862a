//! Sequences out of recordings: the joints are the stage's sensors and the segments of its body.
//!
//! What comes in: `sensors` and `body` messages. What goes out: a frame per `sensors` message. Where a sensor is called as the
//! segment that it sits on, the joint is the segment, as it is live.

use std::path::Path;

use super::poses::SensorsMessage;
use super::{SequenceFrame, Sequences, TableError};
use crate::{Item, ReadError, Take};
use posed_protocol::Figure;
use posed_stage::{Stage, signals};

impl Sequences {
    /// Reads positions in the room, m, from a recording (`.mcap`): a frame per `sensors` message, with the sensors whose pose may
    /// be used as good and the segments of the newest `body` message before it, unless that is older than 0.05 s
    /// ([`signals::BODY_AGE_S`]). Of several bodies it is the first of the stage. No labels. A torn recording gives what it has.
    ///
    /// # Errors
    /// The recording is damaged, or is none.
    pub fn read_recording(path: &Path) -> Result<Self, TableError> {
        let failed = |source| TableError::Recording { file: path.display().to_string(), source };
        let mut rows: Vec<(f64, Vec<Option<[f64; 3]>>)> = Vec::new();
        let mut joints: Vec<String> = Vec::new();
        let mut body: Vec<(usize, [f64; 3])> = Vec::new();
        let mut body_t_s = f64::NEG_INFINITY;
        let take = Take::open(path).map_err(failed)?;
        let bodies = Stage::parse(&take.header().stage_toml).map(|stage| stage.bodies).unwrap_or_default();
        let is_other = |name: &str| bodies.len() > 1 && bodies[0].name != name;
        for item in take {
            let Item::Message(message) = item.map_err(failed)? else { continue };
            match &*message.topic {
                "body" => {
                    let figure = figure(&message.json).map_err(failed)?;
                    if is_other(&figure.name) {
                        continue;
                    }
                    body.clear();
                    body_t_s = figure.t_s;
                    for segment in figure.segments {
                        if let Some(position_m) = segment.position_m {
                            body.push((intern(&mut joints, &segment.name), position_m));
                        }
                    }
                }
                "sensors" => {
                    let message = SensorsMessage::parse(&message.json).map_err(failed)?;
                    let mut row = Vec::with_capacity(joints.len());
                    let mut put = |at: usize, position_m| {
                        row.resize(row.len().max(at + 1), None);
                        row[at] = Some(position_m);
                    };
                    for sensor in message.sensors.iter().filter(|sensor| sensor.state.is_usable()) {
                        if let Some(position_m) = sensor.position_m {
                            put(intern(&mut joints, &sensor.name), position_m);
                        }
                    }
                    if message.t_s - body_t_s <= signals::BODY_AGE_S {
                        body.iter().for_each(|(at, position_m)| put(*at, *position_m));
                    }
                    rows.push((message.t_s, row));
                }
                _ => {}
            }
        }
        let mut sequences = Self { joints, ..Self::default() };
        for (t_s, mut row) in rows {
            row.resize(sequences.joints.len(), None);
            sequences.frames.push(SequenceFrame { t_s, ..SequenceFrame::default() });
            sequences.positions_m.append(&mut row);
        }
        Ok(sequences)
    }
}

fn figure(json: &[u8]) -> Result<Figure, ReadError> {
    serde_json::from_slice(json)
        .map_err(|error| ReadError::NotARecording(format!("a `body` message cannot be read: {error}")))
}

fn intern(joints: &mut Vec<String>, name: &str) -> usize {
    joints.iter().position(|known| known == name).unwrap_or_else(|| {
        joints.push(name.to_owned());
        joints.len() - 1
    })
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::*;
    use crate::Item;
    use crate::testing::{record, sensors};

    fn message(topic: &str, json: String) -> Item {
        Item::Message(crate::Message { topic: topic.into(), t: Timestamp::ZERO, json: json.into_bytes() })
    }

    #[test]
    fn a_body_that_is_no_more_is_no_joint() {
        let figure = r#"{"type":"body","seq":0,"dropped":0,"t_s":1.0,"position_source":"trackers","heading":"field","heading_held_s":0.0,"segments":[{"name":"hand_l","sensor":null,"state":"ok","position_m":[0.0,1.0,2.0],"orientation_wxyz":[1.0,0.0,0.0,0.0],"sigma_deg":1.0,"fault":null}],"joints":[]}"#;
        let at = |nanos| message("sensors", sensors(nanos));
        let items = [message("body", figure.to_owned()), at(1_040_000_000), at(1_060_000_000)];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        std::fs::write(&path, record(&items, 9)).unwrap();
        let sequences = Sequences::read_recording(&path).unwrap();
        let hand = sequences.joints.iter().position(|joint| joint == "hand_l").unwrap();
        assert_eq!(sequences.positions_m(0)[hand], Some([0.0, 1.0, 2.0]));
        assert_eq!(sequences.positions_m(1)[hand], None, "the body is 60 ms old");
    }
}
