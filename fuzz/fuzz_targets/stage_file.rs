//! Any bytes as a stage file.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| posed::stage::fuzz(data));
