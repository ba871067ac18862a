//! Where everything was at a time, from what a recording shows to viewers: without a replay, by reading the chunk around that time.
//!
//! What comes in: a recording with an index, times. What goes out: the poses of `/tf`, which every recording holds at least five times a
//! second. What it never does: pass through what lies before, or hold more than a few chunks of one channel.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use posed_drivers::Timestamp;
use serde::Deserialize;

use super::chunks::Chunks;
use super::ending::ReadError;
use posed_protocol::{FigureSegment, Look, LookBody, LookSensor, Names};
use posed_stage::{BodyIndex, Problems, Stage};

/// What was shown so long before is not where it is any more.
const LATEST: Duration = Duration::from_secs(1);
/// Chunks whose poses are kept: who scrubs goes back and forth.
const KEPT: usize = 8;
/// Chunks that are looked at before the first that shows something.
const FIRST_CHUNKS: usize = 8;

/// Looks into one recording.
pub struct Looker {
    chunks: Arc<Chunks>,
    /// The channel of the poses; absent where nothing was ever shown.
    channel: Option<u16>,
    names: Names,
    /// Of each sensor, by the name of its frame, its place and whether it measures positions.
    sensors: BTreeMap<String, (usize, bool)>,
    /// What stands before the names of each body's segments, and the same as JSON has it.
    bodies: Vec<(BodyIndex, String, String)>,
    /// Poses of the chunks that were read last, the latest at the end.
    read: VecDeque<(usize, Arc<Shown>)>,
}

/// Messages of a chunk, in the order of the file.
type Shown = Vec<(Timestamp, Vec<u8>)>;

/// `/tf`.
#[derive(Deserialize)]
struct Transforms {
    transforms: Vec<Transform>,
}

#[derive(Deserialize)]
struct Transform {
    child_frame_id: String,
    translation: Xyz,
    rotation: Xyzw,
}

#[derive(Deserialize)]
struct Xyz {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Deserialize)]
struct Xyzw {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// Whose poses a message holds.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Whose {
    Sensors,
    Body(BodyIndex),
}

/// A message that shows somebody.
struct Found {
    whose: Whose,
    t: Timestamp,
    /// Where it is.
    shown: Arc<Shown>,
    place: usize,
}

impl Looker {
    /// For a recording whose index was read.
    ///
    /// # Errors
    /// The recording's stage file is of another version.
    pub fn new(chunks: Arc<Chunks>) -> Result<Self, Problems> {
        let stage = Stage::parse(&chunks.header().stage_toml)?;
        let names = Names::new(&stage);
        let frame = |(index, (name, _)): (usize, (&str, &str))| {
            (format!("sensors/{name}"), (index, names.is_magnetic(index as _)))
        };
        let sensors = names.sensors().enumerate().map(frame).collect();
        let several = stage.bodies.len() > 1;
        let prefix = |body| match several {
            true => format!("{}/", names.body_name(body)),
            false => "body/".to_owned(),
        };
        let written = |prefix: &str| serde_json::Value::from(prefix).to_string().trim_matches('"').to_owned();
        let bodies = names.bodies().map(|body| {
            let prefix = prefix(body);
            let written = written(&prefix);
            (body, prefix, written)
        });
        let bodies = bodies.collect();
        let channel = chunks.channel_of("/tf");
        Ok(Self { chunks, channel, names, sensors, bodies, read: VecDeque::new() })
    }

    /// What was shown last at `t`, or first of all where that is before everything; of a sensor or a body that was not good then,
    /// nothing.
    ///
    /// # Errors
    /// The recording cannot be read there.
    pub fn at(&mut self, t: Timestamp) -> Result<Look, ReadError> {
        let mut look = Look { t_s: t.as_secs_f64(), ..Look::default() };
        let Some(channel) = self.channel else { return Ok(look) };
        let earliest = t - LATEST;
        let mut around: Vec<(Timestamp, usize)> = (self.chunks.times().enumerate())
            .filter(|(_, (from, to))| *from <= t && *to >= earliest)
            .map(|(chunk, (_, to))| (to, chunk))
            .collect();
        around.sort_unstable();
        // The last of each of those who are looked for, at or before `t`.
        let mut last: Vec<Found> = Vec::new();
        while let Some((to, chunk)) = around.pop() {
            if last.len() > self.bodies.len() && last.iter().all(|found| found.t >= to) {
                break;
            }
            let shown = self.shown(chunk, channel)?;
            for (place, (shown_t, bytes)) in shown.iter().enumerate() {
                if *shown_t > t || *shown_t < earliest {
                    continue;
                }
                let Some(whose) = self.whose(bytes) else { continue };
                let found = Found { whose, t: *shown_t, shown: Arc::clone(&shown), place };
                match last.iter_mut().find(|known| known.whose == whose) {
                    Some(known) if known.t > found.t => {}
                    Some(known) => *known = found,
                    None => last.push(found),
                }
            }
        }
        if last.is_empty() {
            last = self.first(t, channel)?;
        }
        let Some(newest) = last.iter().map(|found| found.t).max() else { return Ok(look) };
        look.t_s = newest.as_secs_f64();
        for Found { shown, place, .. } in &last {
            self.put(&shown[*place].1, &mut look);
        }
        let at = |name: &str| self.names.sensors().position(|(known, _)| known == name);
        look.sensors.sort_by_cached_key(|sensor| at(&sensor.name));
        look.bodies.sort_by_cached_key(|body| {
            self.names.bodies().find(|index| self.names.body_name(*index) == body.name)
        });
        Ok(look)
    }

    /// What was shown first after `t`.
    fn first(&mut self, t: Timestamp, channel: u16) -> Result<Vec<Found>, ReadError> {
        let mut later: Vec<(Timestamp, usize)> = (self.chunks.times().enumerate())
            .filter(|(_, (from, to))| *to > t && from.seconds_since(t) < LATEST.as_secs_f64())
            .map(|(chunk, (from, _))| (from, chunk))
            .collect();
        later.sort_unstable();
        let mut first: Vec<Found> = Vec::new();
        for (_, chunk) in later.into_iter().take(FIRST_CHUNKS) {
            let shown = self.shown(chunk, channel)?;
            for (place, (shown_t, bytes)) in shown.iter().enumerate().filter(|(_, (at, _))| *at > t) {
                if let Some(whose) = self.whose(bytes)
                    && !first.iter().any(|known| known.whose == whose)
                {
                    first.push(Found { whose, t: *shown_t, shown: Arc::clone(&shown), place });
                }
            }
            if !first.is_empty() {
                break;
            }
        }
        Ok(first)
    }

    /// The poses of a chunk.
    fn shown(&mut self, chunk: usize, channel: u16) -> Result<Arc<Shown>, ReadError> {
        if let Some(place) = self.read.iter().position(|(known, _)| *known == chunk)
            && let Some(known) = self.read.remove(place)
        {
            let shown = Arc::clone(&known.1);
            self.read.push_back(known);
            return Ok(shown);
        }
        let mut shown = Shown::new();
        self.chunks.messages(chunk, channel, |t, bytes| shown.push((t, bytes.to_vec())))?;
        let shown = Arc::new(shown);
        if self.read.len() == KEPT {
            self.read.pop_front();
        }
        self.read.push_back((chunk, Arc::clone(&shown)));
        Ok(shown)
    }

    /// Whose poses a message holds; `None` where it holds none. By the first name in it, so that not every message has to be read.
    fn whose(&self, bytes: &[u8]) -> Option<Whose> {
        const KEY: &[u8] = br#""child_frame_id":""#;
        let at = bytes.windows(KEY.len()).position(|window| window == KEY)?;
        let name = &bytes[at + KEY.len()..];
        if name.starts_with(b"transmitter\"") || name.starts_with(b"sensors/") {
            return Some(Whose::Sensors);
        }
        let body = self.bodies.iter().find(|(.., written)| name.starts_with(written.as_bytes()));
        body.map(|(body, ..)| Whose::Body(*body))
    }

    /// Takes the poses of a message over.
    fn put(&self, bytes: &[u8], look: &mut Look) {
        // Ours are as we wrote them; what others have written shows nothing.
        let Ok(Transforms { transforms }) = serde_json::from_slice(bytes) else { return };
        for Transform { child_frame_id, translation, rotation } in transforms {
            let position_m = [translation.x, translation.y, translation.z];
            let orientation_wxyz = [rotation.w, rotation.x, rotation.y, rotation.z];
            if let Some((index, measures)) = self.sensors.get(&child_frame_id) {
                let name = self.names.sensor(*index as _).to_owned();
                let position_m = measures.then_some(position_m);
                look.sensors.push(LookSensor { name, position_m, orientation_wxyz });
                continue;
            }
            let named = self.bodies.iter().find_map(|(body, prefix, _)| {
                Some((self.names.body_name(*body), child_frame_id.strip_prefix(prefix.as_str())?))
            });
            let Some((body, segment)) = named else { continue };
            let segment = FigureSegment { name: segment.to_owned(), position_m, orientation_wxyz };
            match look.bodies.iter_mut().find(|known| known.name == body) {
                Some(known) => known.segments.push(segment),
                None => look.bodies.push(LookBody { name: body.to_owned(), segments: vec![segment] }),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::path::Path;

    use super::*;
    use crate::Writer;
    use crate::testing::{STAGE, chunk, header};
    use posed_protocol::foxglove::views;

    fn ms(ms: i64) -> Timestamp {
        Timestamp::from_nanos(ms * 1_000_000)
    }

    /// Every 200 ms the sensor `left` is so many metres up as seconds have passed; `right` is good for the first second.
    fn record(path: &Path) {
        let stage = Stage::parse(STAGE).unwrap();
        let channel = views(&stage, false).remove(0);
        assert_eq!(channel.topic, "/tf");
        let mut writer = Writer::new(File::create(path).unwrap(), header()).unwrap();
        for n in 1..=50 {
            let t_s = 0.2 * n as f64;
            let frame = |name: &str, z: f64| {
                format!(
                    r#"{{"parent_frame_id":"room","child_frame_id":"{name}","translation":{{"x":1,"y":2,"z":{z}}},"rotation":{{"x":0,"y":0,"z":0.6,"w":0.8}}}}"#
                )
            };
            let mut frames = vec![frame("transmitter", 0.0), frame("sensors/left", t_s)];
            frames.extend((n <= 5).then(|| frame("sensors/right", 0.0)));
            let json = format!(r#"{{"transforms":[{}]}}"#, frames.join(","));
            writer.entry(&chunk(n * 200_000_000)).unwrap();
            writer.view(&channel, ms(n * 200), json.as_bytes()).unwrap();
            if n % 3 == 0 {
                writer.flush().unwrap();
            }
        }
        writer.finish("enough").unwrap();
    }

    #[test]
    fn what_was_shown_last_is_found_at_any_time_in_any_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        record(&path);
        let chunks = Arc::new(Chunks::read(&path).unwrap().unwrap());
        let mut looker = Looker::new(chunks).unwrap();
        for at_ms in [5010, 10_900, 250, 5000, 4990, 601, 599, 9999] {
            let look = looker.at(ms(at_ms)).unwrap();
            let expected_s = 0.2 * (at_ms.min(10_000) / 200) as f64;
            assert!((look.t_s - expected_s).abs() < 1e-9, "{at_ms}: {look:?}");
            let left = &look.sensors[0];
            assert_eq!((left.name.as_str(), left.orientation_wxyz), ("left", [0.8, 0.0, 0.0, 0.6]));
            assert!((left.position_m.unwrap()[2] - expected_s).abs() < 1e-9);
            assert_eq!(look.sensors.len(), if expected_s <= 1.0 { 2 } else { 1 }, "{at_ms}");
        }
        assert!(looker.read.len() <= KEPT);
        // Before everything is the first, and long after the end nothing.
        let first = looker.at(ms(-100)).unwrap();
        assert_eq!((first.t_s, first.sensors.len()), (0.2, 2));
        assert!(looker.at(ms(60_000)).unwrap().sensors.is_empty());
        assert!(looker.at(ms(-60_000)).unwrap().sensors.is_empty());
    }
}
