//! The program of every target: its own name says which.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| posed_fuzzing::run(env!("CARGO_BIN_NAME"), data));
