//! Time code: samples of a sound card, bytes of a MIDI port, and readings as a recording has them.

use posed_drivers::Timestamp;
use posed_timecode::{Counting, Follower, Reading, ltc, mtc};

/// As many as a slow sound card has: a frame takes few bytes.
pub(crate) const SAMPLE_RATE_HZ: f64 = 8000.0;
/// Bytes of a read.
const READ: usize = 320;

/// The first byte chooses what carries it, the second how many pictures a frame of it stands for, the rest is that.
///
/// - Samples: signed 16-bit numbers, little-endian.
/// - MIDI.
/// - Readings, each with the time of its read.
///
/// # Panics
/// A frame was read that does not exist, or something is said of the code that is no number.
pub(crate) fn timecode(data: &[u8]) {
    let [choice, pictures, bytes @ ..] = data else { return };
    let mut follower = Follower::new(0.001, 1 + pictures % 2);
    let mut follow = |t: Timestamp, reading: &Reading| {
        follower.push(t, reading);
        check(&follower, t);
    };
    match choice % 3 {
        0 => {
            let mut decoder = ltc::Decoder::new(SAMPLE_RATE_HZ);
            for (read, bytes) in bytes.chunks(READ).enumerate() {
                let sample = |pair: &[u8]| f32::from(i16::from_le_bytes([pair[0], pair[1]])) / 32768.0;
                let samples: Vec<f32> = bytes.chunks_exact(2).map(sample).collect();
                let t = Timestamp::from_secs_f64((read + 1) as f64 * (READ / 2) as f64 / SAMPLE_RATE_HZ);
                decoder.push(&samples, 0, |reading| {
                    exists(&reading);
                    assert!(reading.behind_s >= 0.0 && reading.position_s.is_some_and(|s| s >= 0.0));
                    follow(t, &reading);
                });
            }
        }
        1 => {
            let mut decoder = mtc::Decoder::default();
            // A quarter frame at 25 frames a second, two bytes of which come every 10 ms.
            for (read, bytes) in bytes.chunks(2).enumerate() {
                let t = Timestamp::from_secs_f64(read as f64 * 0.01);
                decoder.push(t, bytes, 0, |reading| {
                    exists(&reading);
                    follow(t, &reading);
                });
            }
        }
        _ => {
            let Ok(readings) = rmp_serde::from_slice::<Vec<(Timestamp, Reading)>>(bytes) else { return };
            readings.iter().for_each(|(t, reading)| follow(*t, reading));
        }
    }
}

/// # Panics
/// No counting has such a frame.
fn exists(reading: &Reading) {
    let counted = reading.frames_per_s.unwrap_or(30);
    let counting = Counting { frames_per_s: counted, drop: reading.drop };
    assert!(counting.number(reading.frame).is_some(), "{reading:?}");
}

/// # Panics
/// What is known at a moment, and long after it, is no time code.
fn check(follower: &Follower, t: Timestamp) {
    let Some(relation) = follower.relation() else { return };
    for later_s in [0.0, 1.0, 1e5] {
        let t = Timestamp::from_nanos(t.as_nanos().saturating_add((later_s * 1e9) as i64));
        if let Some(label) = relation.label(t) {
            let Counting { frames_per_s, drop } = relation.counting;
            let counting = Counting { frames_per_s: frames_per_s * relation.pictures, drop };
            assert!(counting.number(label.frame).is_some() && label.hundredths < 100, "{label:?}");
            assert!(relation.sigma_s(t).is_finite() && relation.drift_ppm().is_none_or(f64::is_finite));
        }
    }
}
