//! Damage to a stream: bytes lost, inserted and flipped, garbage, half messages.

use crate::matrix::Noise;

/// What happens to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Damage {
    Lost,
    Inserted,
    Flipped,
    Garbage,
    Half,
}

/// Those that change how many bytes there are, or what stands between messages.
pub(crate) const FRAMING: [Damage; 4] = [Damage::Lost, Damage::Inserted, Damage::Garbage, Damage::Half];

/// The messages as a host reads them, each with its damage: about one in six is hit.
pub(crate) fn damaged(messages: &[Vec<u8>], kinds: &[Damage], noise: &mut Noise) -> Vec<Vec<u8>> {
    let mut damaged = messages.to_vec();
    for message in damaged.iter_mut().filter(|message| !message.is_empty()) {
        if noise.below(6) > 0 {
            continue;
        }
        let at = noise.below(message.len());
        match kinds[noise.below(kinds.len())] {
            Damage::Lost => _ = message.remove(at),
            Damage::Inserted => message.insert(at, noise.next()),
            Damage::Flipped => message[at] ^= 1 << noise.below(8),
            Damage::Garbage => {
                let count = 1 + noise.below(90);
                let garbage = noise.bytes(count);
                message.splice(at..at, garbage);
            }
            Damage::Half => message.truncate(at),
        }
    }
    damaged
}
