//! LTC in a sound file.

use std::path::Path;

use posed_drivers::Timestamp;
use posed_timecode::{Follower, Relation, ltc};
use serde::Serialize;

use super::Error;

/// Samples that are looked at together, s: gaps are known to so much.
const PIECE_S: f64 = 0.01;
/// Time without a frame that is a gap, s: longer than two frames of any rate.
const GAP_S: f64 = 0.1;

/// A stretch of time code without a jump.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Stretch {
    /// Where in the sound it is known from and to, s.
    from_s: f64,
    to_s: f64,
    /// Time code there.
    from: String,
    to: String,
    /// Rate of the pictures; null where too little was there to tell.
    rate: Option<&'static str>,
    /// How much faster than its rate it runs on the sound's clock, ppm.
    drift_ppm: Option<f64>,
    /// Frames that were read, and gaps between them.
    frames: u64,
    gaps: u64,
    longest_gap_s: f64,
    /// The user bits, eight hexadecimal digits with the first last.
    user_bits: String,
}

impl Stretch {
    /// For people.
    pub(super) fn sentence(&self) -> String {
        let drift = self.drift_ppm.map_or_else(String::new, |ppm| format!(", {ppm:+.1} ppm"));
        format!(
            "timecode  {} to {} at {}{drift}, from {:.3} s to {:.3} s, {} frames, {} gaps (longest {:.2} s), user bits {}\n",
            self.from,
            self.to,
            self.rate.unwrap_or("a rate that is not known"),
            self.from_s,
            self.to_s,
            self.frames,
            self.gaps,
            self.longest_gap_s,
            self.user_bits,
        )
    }
}

/// What a sound file has.
pub(super) struct Sound {
    pub(super) duration_s: f64,
    pub(super) stretches: Vec<Stretch>,
    /// Code against the sound's own time, by the last stretch.
    pub(super) relation: Option<Relation>,
}

/// The stretch that is being read.
#[derive(Default)]
struct Now {
    first: Option<(f64, Relation)>,
    last_s: f64,
    frames: u64,
    gaps: u64,
    longest_gap_s: f64,
    user_bits: u32,
}

impl Now {
    fn end(&self, relation: Option<&Relation>) -> Option<Stretch> {
        let ((from_s, _), relation) = (self.first?, relation?);
        let label = |t_s: f64| Some(relation.label(Timestamp::from_secs_f64(t_s))?.to_string());
        Some(Stretch {
            from_s,
            to_s: self.last_s,
            from: label(from_s)?,
            to: label(self.last_s)?,
            rate: relation.rate().map(posed_timecode::Rate::name),
            drift_ppm: relation.drift_ppm().map(|ppm| (ppm * 10.0).round() / 10.0),
            frames: self.frames,
            gaps: self.gaps,
            longest_gap_s: self.longest_gap_s,
            user_bits: format!("{:08x}", self.user_bits),
        })
    }
}

/// Reads a WAV file.
pub(super) fn read(path: &Path, channel: u16, pictures: u8) -> Result<Sound, Error> {
    let failed = |error: &dyn std::fmt::Display| {
        Error::Failed(format!("{}: {error}; give a WAV file or a recording (.mcap)", path.display()))
    };
    let mut file = hound::WavReader::open(path).map_err(|error| failed(&error))?;
    let spec = file.spec();
    if channel > spec.channels {
        return Err(Error::Usage(format!("{} has {} channels", path.display(), spec.channels)));
    }
    let (each, at) = (usize::from(spec.channels.max(1)), usize::from(channel - 1));
    let samples: Result<Vec<f32>, hound::Error> = match spec.sample_format {
        hound::SampleFormat::Float => file.samples::<f32>().skip(at).step_by(each).collect(),
        hound::SampleFormat::Int => {
            let full = (1_u64 << (spec.bits_per_sample.clamp(1, 32) - 1)) as f32;
            let all = file.samples::<i32>().skip(at).step_by(each);
            all.map(|sample| sample.map(|sample| sample as f32 / full)).collect()
        }
    };
    let samples = samples.map_err(|error| failed(&error))?;
    Ok(of_samples(&samples, f64::from(spec.sample_rate), pictures))
}

/// What samples have.
fn of_samples(samples: &[f32], sample_rate_hz: f64, pictures: u8) -> Sound {
    // The sound's own time stands for the host's: nothing is read late.
    let mut decoder = ltc::Decoder::new(sample_rate_hz);
    let mut follower = Follower::new(0.0, pictures);
    let (mut stretches, mut now, mut before) = (Vec::new(), Now::default(), None);
    let mut read = 0;
    for piece in samples.chunks(((PIECE_S * sample_rate_hz) as usize).max(1)) {
        read += piece.len();
        let t_read = Timestamp::from_secs_f64(read as f64 / sample_rate_hz);
        decoder.push(piece, 0, |reading| {
            let jumps = follower.jumps();
            follower.push(t_read, &reading);
            let at_s = reading.position_s.unwrap_or(0.0);
            if follower.jumps() > jumps {
                stretches.extend(now.end(before.as_ref()));
                now = Now::default();
            }
            before = follower.relation().copied();
            let Some(relation) = before else { return };
            if now.first.is_none() {
                now.first = Some((at_s, relation));
            } else if at_s - now.last_s > GAP_S {
                now.gaps += 1;
                now.longest_gap_s = now.longest_gap_s.max(at_s - now.last_s);
            }
            now.last_s = at_s;
            now.frames += 1;
            now.user_bits = reading.user_bits;
        });
    }
    stretches.extend(now.end(before.as_ref()));
    Sound { duration_s: samples.len() as f64 / sample_rate_hz, stretches, relation: before }
}

#[cfg(test)]
mod tests {
    use posed_timecode::{Frame, Rate};

    use super::*;

    #[test]
    fn a_gap_and_a_jump_are_reported_and_the_rate_is_known() {
        let rate = Rate::Video30Drop;
        let mut encoder = ltc::Encoder::new(48_000.0, rate.hz(), rate.counting(), Frame::new(1, 0, 0, 0))
            .with_user_bits(0x1234_abcd);
        let mut samples: Vec<f32> = (0..48_000 * 6).map(|_| encoder.sample()).collect();
        samples[48_000 * 2..48_000 * 3].fill(0.0);
        encoder.skip(1000);
        samples.extend((0..48_000 * 3).map(|_| encoder.sample()));
        let Sound { duration_s, stretches, relation } = of_samples(&samples, 48_000.0, 1);
        assert_eq!((duration_s, stretches.len()), (9.0, 2));
        let (first, second) = (&stretches[0], &stretches[1]);
        assert_eq!((first.rate, first.gaps, second.gaps), (Some("29.97df"), 1, 0));
        assert_eq!(first.user_bits, "1234abcd");
        assert!((first.longest_gap_s - 1.05).abs() < 0.08, "{first:?}");
        assert!(first.drift_ppm.unwrap().abs() < 5.0 && first.from.starts_with("01:00:00;0"), "{first:?}");
        assert!(second.to_s > 8.9 && second.from_s > 6.0, "{second:?}");
        // The sound's beginning by the code behind the jump.
        let begin = relation.unwrap().label(Timestamp::from_secs_f64(9.0)).unwrap();
        assert!(begin.to_string().starts_with("01:00:42"), "{begin}");
    }
}
