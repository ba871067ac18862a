//! Whatever a Foxglove viewer sends is understood or refused with a sentence, never a panic.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| posed_protocol::foxglove::fuzz_viewer(data));
