//! Fingerprints of layouts: FNV-1a over names and the fingerprints of what they hold, at compile time.

const PRIME: u64 = 0x0000_0100_0000_01b3;

/// Fingerprint of a name: FNV-1a, 64 bits, over its UTF-8 bytes.
pub const fn name(name: &str) -> u64 {
    let (bytes, mut hash, mut at) = (name.as_bytes(), 0xcbf2_9ce4_8422_2325u64, 0);
    while at < bytes.len() {
        hash = (hash ^ bytes[at] as u64).wrapping_mul(PRIME);
        at += 1;
    }
    hash
}

/// Fingerprint of `first` followed by `second`; the order counts.
pub const fn join(first: u64, second: u64) -> u64 {
    let (bytes, mut hash, mut at) = (second.to_le_bytes(), first, 0);
    while at < bytes.len() {
        hash = (hash ^ bytes[at] as u64).wrapping_mul(PRIME);
        at += 1;
    }
    hash
}

/// Fingerprint of a structure, `layout` so far, with one field more: its name and the layout `of` its type.
pub const fn field(layout: u64, field: &str, of: u64) -> u64 {
    join(join(layout, name(field)), of)
}
