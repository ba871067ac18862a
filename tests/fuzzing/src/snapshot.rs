//! Damaged snapshots.

use posed_pipeline::Pipeline;

use crate::log::go_on;
use crate::stand::STANDS;

/// The first byte chooses a stage; the others damage its own snapshot: of each thirteen, one says how, four where, and the rest what
/// stands there. So a corpus outlives a change of the layout. What was changed is refused; a new sum behind it is no damage, but
/// somebody's work.
///
/// # Panics
/// Where damage is taken for a snapshot, or the stage does not go on from its own.
pub(crate) fn snapshot(data: &[u8]) {
    let Some((&choice, edits)) = data.split_first() else { return };
    let stand = &STANDS[usize::from(choice) % STANDS.len()];
    let own = stand.pipeline.snapshot();
    let mut bytes = own.clone();
    edits.chunks_exact(EDIT).for_each(|edit| damage(&mut bytes, edit));
    let restored = Pipeline::restore(&stand.stage, stand.pipeline.models(), &bytes);
    if bytes == own {
        go_on(&stand.stage, restored.expect("its own"), &stand.next);
    } else if bytes.last_chunk::<8>() == own.last_chunk() {
        assert!(restored.is_err(), "damage was not seen");
    }
}

/// Bytes of one edit.
const EDIT: usize = 13;

fn damage(bytes: &mut Vec<u8>, edit: &[u8]) {
    let place = u32::from_le_bytes([edit[1], edit[2], edit[3], edit[4]]) as usize % (bytes.len() + 1);
    let what = &edit[5..];
    match edit[0] % 5 {
        // A number, a byte, or a bit in place of what stands there.
        0 => bytes.iter_mut().skip(place).zip(what).for_each(|(byte, new)| *byte = *new),
        1 => bytes.iter_mut().skip(place).take(1).for_each(|byte| *byte = what[0]),
        2 => bytes.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= 1 << (what[0] % 8)),
        3 => bytes.truncate(place),
        _ => drop(bytes.splice(place..place, what.iter().copied())),
    }
}
