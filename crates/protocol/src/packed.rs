//! MessagePack as strangers write it.

use rmp_serde::Deserializer;
use rmp_serde::decode::{Error, ReadRefReader};
use serde::Deserialize;

/// Deepest that maps and lists may lie in one another. They are read by recursion, and each may make the reader take 1 MiB before
/// its items are there; requests, models and headers have a dozen.
pub(crate) const DEPTH: usize = 32;

/// Reads the first value of some bytes. What follows it is not looked at.
///
/// # Errors
/// They are no MessagePack, no such value, or nested deeper than any of ours.
pub fn unpack<'de, T: Deserialize<'de>>(bytes: &'de [u8]) -> Result<T, Error> {
    T::deserialize(&mut unpacker(bytes))
}

/// For one value after the other.
pub fn unpacker(bytes: &[u8]) -> Deserializer<ReadRefReader<'_, [u8]>> {
    let mut deserializer = Deserializer::from_read_ref(bytes);
    deserializer.set_max_depth(DEPTH);
    deserializer
}

#[cfg(test)]
mod tests {
    use posed_stage::input::Model;
    use serde_json::Value;

    use super::*;

    #[test]
    fn what_is_nested_deeper_than_anything_is_refused() {
        // A map of 4 G values, the first of which is another one, and so on.
        let level = [0xdf, 0xff, 0xff, 0xff, 0xff, 0xa1, b'a'];
        assert!(matches!(unpack::<Model>(&level.repeat(200)), Err(Error::DepthLimitExceeded)));
        let lists = |depth: usize| [&vec![0x91; depth][..], &[0xc0]].concat();
        assert!(unpack::<Value>(&lists(DEPTH - 1)).is_ok());
        assert!(unpack::<Value>(&lists(DEPTH + 1)).is_err());
    }
}
