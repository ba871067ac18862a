//! Places of a recording from which its replay goes on without all that lies before: a thread passes through it once, ahead of who watches, and keeps the
//! pipeline as it stands there.
//!
//! In: a recording with an index. Out: the last place before a time. Never: more memory than [`MOST_BYTES`], nor another replay than one from the beginning: a
//! pipeline that was kept is the one that came by.

use std::fs::File;
use std::io::BufReader;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_pipeline::SupervisedPipeline;
use posed_recording::{Chunks, Item, Machine, Reader};

use super::jobs::give_way;
use super::player::{PlayError, Played};

/// What the pipelines of one recording may take, bytes.
const MOST_BYTES: usize = 128 << 20;
/// They are not closer than this in stage time: so much is passed through in milliseconds.
const CLOSEST_S: f64 = 1.0;
/// Entries between two looks at whether anybody still watches.
const BATCH: u32 = 256;
/// The thread gives way to whatever else the machine has to do: live tracking may go on beside.
const NICE: i32 = 19;

/// The places found so far; the thread ends when this is dropped.
pub(super) struct Waypoints {
    found: Arc<Found>,
    chunks: Arc<Chunks>,
}

#[derive(Default)]
struct Found {
    waypoints: Mutex<Vec<Waypoint>>,
    /// Up to where the thread has come, ns.
    until_ns: AtomicI64,
    abandoned: AtomicBool,
}

struct Waypoint {
    /// Time and number of the entry that comes next.
    t: Timestamp,
    entry: u32,
    pipeline: SupervisedPipeline,
}

/// A recording that stands at a waypoint.
pub(super) struct Resumed {
    pub(super) t: Timestamp,
    pub(super) reader: Reader<BufReader<File>>,
    pub(super) pipeline: SupervisedPipeline,
}

impl Waypoints {
    /// Sets out through a recording; `None` where it has no index, and where there is no thread.
    pub(super) fn look_for(played: &Played) -> Option<Self> {
        let chunks = played.chunks.clone()?;
        let found = Arc::new(Found::default());
        let (filled, played) = (Arc::clone(&found), played.clone());
        #[expect(clippy::disallowed_methods, reason = "the daemon owns this thread, too")]
        let thread = std::thread::Builder::new().name("waypoints".into()).spawn(move || {
            // Who plays waits for the same: before this gives way.
            played.prepare();
            give_way(NICE);
            if let Err(error) = filled.pass_through(&played, MOST_BYTES) {
                // What came before is of use, and who watches meets the same.
                tracing::debug!(%error, "no more waypoints");
            }
        });
        thread.ok().map(|_| Self { found, chunks })
    }

    /// Up to where places have been looked for.
    pub(super) fn until(&self) -> Timestamp {
        Timestamp::from_nanos(self.found.until_ns.load(Ordering::Relaxed))
    }

    /// The last place before `t` that is after `than`, to go on from.
    pub(super) fn before(&self, t: Timestamp, than: Timestamp) -> Option<Resumed> {
        let (t, entry, pipeline) = {
            let waypoints = self.found.waypoints.lock().unwrap_or_else(PoisonError::into_inner);
            let behind = waypoints.partition_point(|waypoint| waypoint.t < t);
            let Waypoint { t, entry, pipeline } = waypoints[..behind].last()?;
            (*t > than).then(|| (*t, *entry, pipeline.clone()))?
        };
        let reader = self.chunks.reader(entry).ok().flatten()?;
        Some(Resumed { t, reader, pipeline })
    }
}

impl Drop for Waypoints {
    fn drop(&mut self) {
        self.found.abandoned.store(true, Ordering::Relaxed);
    }
}

impl Found {
    fn pass_through(&self, played: &Played, most_bytes: usize) -> Result<(), PlayError> {
        let reader = Reader::open(&played.path)?;
        let (_, Machine { mut pipeline, .. }) = Machine::as_recorded(played.header(&reader))?;
        let begun = reader.header().begun;
        let duration_s = played.end.seconds_since(begun);
        let mut next = begun + Duration::from_secs_f64(CLOSEST_S);
        let mut number = 0_u32;
        for item in reader {
            let Item::Entry(entry) = item? else { continue };
            if number.is_multiple_of(BATCH) {
                if self.abandoned.load(Ordering::Relaxed) {
                    return Ok(());
                }
                self.until_ns.fetch_max(entry.t.as_nanos(), Ordering::Relaxed);
            }
            if entry.t >= next {
                let distance_s = duration_s * pipeline.snapshot().len() as f64 / most_bytes as f64;
                next = entry.t + Duration::from_secs_f64(distance_s.max(CLOSEST_S));
                let waypoint = Waypoint { t: entry.t, entry: number, pipeline: pipeline.clone() };
                self.waypoints.lock().unwrap_or_else(PoisonError::into_inner).push(waypoint);
            }
            pipeline.push(&entry, &mut |_| {});
            number += 1;
        }
        self.until_ns.fetch_max(played.end.as_nanos(), Ordering::Relaxed);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use posed_recording::{Header, Writer};
    use posed_stage::Stage;
    use posed_stage::input::{Entry, Input};

    use super::*;

    #[test]
    fn places_of_a_long_recording_are_further_apart_and_take_no_more_than_their_share() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("long.mcap");
        let toml = "name = \"Empty\"\n";
        let header = Header::new(&Stage::parse(toml).unwrap(), toml, 0);
        let mut writer = Writer::new(File::create(&path).unwrap(), header).unwrap();
        let at = |s: u64| Timestamp::ZERO + Duration::from_secs(s);
        for s in 0..3600 {
            writer.entry(&Entry { t: at(s), input: Input::Timer }).unwrap();
        }
        writer.finish("enough").unwrap();
        let played = Played { path, end: at(3599), chunks: None };
        let bytes = |most_bytes: usize| {
            let found = Found::default();
            found.pass_through(&played, most_bytes).unwrap();
            assert_eq!(found.until_ns.load(Ordering::Relaxed), played.end.as_nanos());
            let waypoints = found.waypoints.into_inner().unwrap();
            (
                waypoints.len(),
                waypoints.iter().map(|waypoint| waypoint.pipeline.snapshot().len()).sum::<usize>(),
            )
        };
        let (closest, one) = bytes(MOST_BYTES);
        assert_eq!(closest, 3599);
        // A hundredth of the memory takes a hundredth of the places, the first one being where it is.
        let share = one / 100;
        let (apart, few) = bytes(share);
        assert!(apart.abs_diff(closest / 100) <= 1, "{apart} places");
        assert!(few <= share + one / closest, "{few} bytes, {share} given");
    }
}
