//! Any bytes as a stage file; seeds: `cargo fuzz run stage_file fuzz/corpus/stage_file tests/broken-stages config`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| posed_stage::fuzz(data));
