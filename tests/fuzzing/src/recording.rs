//! Damaged recordings.

use std::sync::Arc;

use posed_recording::{Brief, Chunks, Info, Item, Looker, Outline, Reader, Repaired, Take, repair};

use crate::files::file;

/// A recording is read, described, replayed and repaired, or refused. What came before the damage is there after the repair, which
/// leaves nothing to repair.
///
/// # Panics
/// That does not hold.
pub(crate) fn recording(data: &[u8]) {
    let Ok(reader) = Reader::new(data, data.len() as u64) else { return };
    let sound: Vec<Item> = reader.map_while(Result::ok).collect();
    if let Ok(take) = Reader::new(data, data.len() as u64).and_then(Take::new) {
        take.take_while(Result::is_ok).for_each(drop);
    }
    let path = file("take.mcap", data);
    let described = Info::read(&path, |_| ());
    let outline = Outline::read(&path);
    assert!(described.is_err() || outline.is_ok(), "{outline:?}");
    let brief = Brief::read(&path);
    assert!(described.is_err() || brief.is_ok(), "{brief:?}");
    if let (Ok(Some(chunks)), Ok(outline)) = (Chunks::read(&path), &outline)
        && let Ok(mut looker) = Looker::new(Arc::new(chunks))
    {
        let _ = looker.at(outline.end);
    }
    match repair(&path, |_| ()) {
        Ok(Repaired::WasComplete) => {
            assert_eq!(described.expect("it was read through").problem, None, "complete, and not");
        }
        Ok(Repaired::Completed { .. }) => {
            let again: Vec<Item> =
                Reader::open(&path).expect("repaired").map(|item| item.expect("repaired")).collect();
            // By its text: NaN, which a model may hold, is not equal to itself.
            assert_eq!(format!("{again:?}"), format!("{sound:?}"), "the repair changed what was sound");
            let twice = repair(&path, |_| ());
            assert!(matches!(twice, Ok(Repaired::WasComplete)), "{twice:?}");
        }
        Err(_) => {}
    }
}
