//! Whatever a client sends is a request or an error, never a panic; a request survives being written and read again.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| posed_protocol::fuzz_client_message(data));
