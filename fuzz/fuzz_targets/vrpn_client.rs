//! Whatever a VRPN client sends is taken, passed over or refused, never a panic.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| posed_protocol::vrpn::fuzz_client(data));
