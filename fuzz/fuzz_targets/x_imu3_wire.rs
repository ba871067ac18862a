#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| posed_drivers::fuzzing::x_imu3_wire(data));
