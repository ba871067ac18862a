//! Tests of the drivers from outside, in one binary.

#![allow(clippy::unwrap_used, reason = "a test may stop where its ground gives way")]

mod damage;
mod fastrak;
mod flock;
mod fuzz_bodies;
mod matrix;
mod motionstar;
mod open_imu;
mod polhemus;
mod rig;
mod slimevr;
mod slimevr_receiver;
mod vrpn;
mod witmotion;
mod x_imu3;
mod xbus_captures;
mod xbus_examples;
mod xbus_session;

/// Bytes written in hexadecimal, spaces allowed.
fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
    digits.chunks(2).map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}
