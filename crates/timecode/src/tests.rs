//! A generator, a sound card and a host whose clocks differ, and what is stated of the code in every moment.

use std::collections::VecDeque;

use posed_geometry::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{Counting, Follower, Frame, Label, Rate, Reading, Relation, State, ltc, mtc};

const SAMPLE_RATE_HZ: f64 = 48_000.0;
/// Samples that a sound card hands over at once.
const PERIOD: usize = 480;
/// What the code may be off by, s.
const LIMIT_S: f64 = 1e-3;
/// Rates at which the code itself runs.
const CODE_RATES: [Rate; 6] = [
    Rate::Film24PulledDown,
    Rate::Film24,
    Rate::Video25,
    Rate::Video30PulledDown,
    Rate::Video30Drop,
    Rate::Video30,
];

/// A generator on a wire to a sound card whose samples a host reads late.
struct Setup {
    rate: Rate,
    first: Frame,
    /// Share by which the generator and the sound card run fast.
    generator: f64,
    card: f64,
    encoder: ltc::Encoder,
    random: ChaCha8Rng,
    /// Host time at which all that has come is read at the soonest.
    stalled_until_s: f64,
    samples: u64,
    wire: Wire,
}

/// What is on the wire.
#[derive(Clone, Copy, PartialEq)]
enum Wire {
    /// The code, at that level, upside down where it is below 0, with noise of that standard deviation.
    Code {
        level: f32,
        noise: f32,
    },
    Silence,
    Noise,
}

const CLEAN: Wire = Wire::Code { level: 1.0, noise: 0.0 };

impl Setup {
    fn new(rate: Rate, generator_ppm: f64, card_ppm: f64, first: Frame) -> Self {
        let (generator, card) = (generator_ppm * 1e-6, card_ppm * 1e-6);
        let frame_rate_hz = rate.hz() * (1.0 + generator) / (1.0 + card);
        Self {
            rate,
            first,
            generator,
            card,
            encoder: ltc::Encoder::new(SAMPLE_RATE_HZ, frame_rate_hz, rate.counting(), first),
            random: ChaCha8Rng::seed_from_u64(rate as u64 + 100),
            stalled_until_s: 0.0,
            samples: 0,
            wire: CLEAN,
        }
    }

    /// Number of the frame at a host time, of the day.
    fn number_at(&self, t_s: f64) -> f64 {
        f64::from(self.rate.counting().number(self.first).unwrap())
            + t_s * self.rate.hz() * (1.0 + self.generator)
    }

    fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.random.random::<f32>()).sum::<f32>() - 6.0
    }

    /// The samples of the next period, and when the host reads them.
    fn period(&mut self) -> (Vec<f32>, Timestamp) {
        let samples = (0..PERIOD).map(|_| {
            let code = self.encoder.sample();
            match self.wire {
                Wire::Code { level, noise } if noise > 0.0 => level * code + noise * self.normal(),
                Wire::Code { level, .. } => level * code,
                Wire::Silence => 0.0,
                Wire::Noise => 0.3 * self.normal(),
            }
        });
        let samples = samples.collect();
        self.samples += PERIOD as u64;
        let captured_s = self.samples as f64 / (SAMPLE_RATE_HZ * (1.0 + self.card));
        let late_s = 2e-4 - 2e-4 * libm::log(1.0 - self.random.random::<f64>());
        if self.random.random::<f64>() < 0.002 {
            self.stalled_until_s = captured_s + 0.03;
        }
        (samples, Timestamp::from_secs_f64((captured_s + late_s).max(self.stalled_until_s)))
    }
}

/// How far a relation is off at a moment, s.
fn error_s(relation: &Relation, setup: &Setup, t: Timestamp) -> f64 {
    let day = f64::from(setup.rate.counting().day());
    let off = relation.number_at(t) - setup.number_at(t.as_secs_f64());
    (off - day * (off / day).round()) / setup.rate.hz()
}

/// Runs a set-up for so long, `wire` being what is on it; the largest error in all moments after the first lock.
fn run(setup: &mut Setup, follower: &mut Follower, seconds: f64, mut wire: impl FnMut(f64) -> Wire) -> f64 {
    let mut decoder = ltc::Decoder::new(SAMPLE_RATE_HZ);
    let mut worst_s = 0.0_f64;
    let mut t = Timestamp::ZERO;
    while t.as_secs_f64() < seconds {
        setup.wire = wire(t.as_secs_f64());
        let (samples, t_read) = setup.period();
        t = t_read;
        decoder.push(&samples, 0, |reading| _ = follower.push(t_read, &reading));
        if let Some(relation) = follower.relation() {
            worst_s = worst_s.max(error_s(relation, setup, t).abs());
        }
    }
    worst_s
}

#[test]
fn within_a_millisecond_at_every_rate_with_drift_and_dropouts() {
    let mut table = Vec::new();
    for rate in CODE_RATES {
        for (generator_ppm, card_ppm) in [(-100.0, 40.0), (0.0, 0.0), (100.0, -40.0)] {
            let mut setup = Setup::new(rate, generator_ppm, card_ppm, Frame::new(23, 59, 52, 10));
            let mut follower = Follower::new(0.0, 1);
            // A short one at once, when little is known, and long ones; the last brings noise.
            let wire = |t_s: f64| match t_s {
                2.0..2.4 | 5.0..8.0 => Wire::Silence,
                11.0..14.0 => Wire::Noise,
                _ => Wire::Code { level: 0.4, noise: 0.004 },
            };
            let worst_s = run(&mut setup, &mut follower, 16.0, wire);
            let relation = follower.relation().unwrap();
            assert!(worst_s < LIMIT_S, "{rate}, {generator_ppm} ppm: {:.3} ms", 1e3 * worst_s);
            assert_eq!(relation.rate(), Some(rate), "{generator_ppm} ppm: {relation:?}");
            let off_ppm = relation.drift_ppm().unwrap() - generator_ppm;
            assert!(off_ppm.abs() < 60.0, "{rate}: {off_ppm:.1} ppm off");
            assert_eq!(follower.jumps(), 0, "{rate}");
            table.push((rate, generator_ppm, worst_s));
        }
    }
    for (rate, drift_ppm, worst_s) in table {
        println!("{:8} {drift_ppm:5.0} ppm: {:.3} ms", rate.name(), 1e3 * worst_s);
    }
}

#[test]
fn pictures_faster_than_thirty_are_counted_two_to_a_frame() {
    for rate in Rate::ALL.into_iter().filter(|rate| rate.pictures_per_frame() == 2) {
        let Counting { frames_per_s, drop } = rate.counting();
        let code = Counting { frames_per_s: frames_per_s / 2, drop };
        let code = Rate::nearest(code, rate.hz() / 2.0).unwrap();
        let mut setup = Setup::new(code, 30.0, -20.0, Frame::new(1, 0, 59, 20));
        let mut follower = Follower::new(0.0, rate.pictures_per_frame());
        run(&mut setup, &mut follower, 4.0, |_| CLEAN);
        let relation = follower.relation().unwrap();
        assert_eq!(relation.rate(), Some(rate));
        let t = Timestamp::from_secs_f64(4.0);
        let label = relation.label(t).unwrap();
        let true_number = 2.0 * setup.number_at(4.0);
        let number = rate.counting().number(label.frame).unwrap();
        let number = f64::from(number) + f64::from(label.hundredths) / 100.0;
        // 59.94df: LTC's own frames and pictures leave out the same minutes' names.
        assert!((number - true_number).abs() / rate.hz() < LIMIT_S, "{rate}: {label} {true_number}");
    }
}

#[test]
fn what_is_carried_on_says_how_well_it_is_known_and_ends() {
    let mut setup = Setup::new(Rate::Video25, 100.0, 0.0, Frame::new(10, 0, 0, 0));
    let mut follower = Follower::new(0.0, 1);
    run(&mut setup, &mut follower, 30.0, |_| CLEAN);
    let relation = follower.relation().unwrap();
    let at = |t_s: f64| Timestamp::from_secs_f64(t_s);
    assert_eq!(relation.state(at(30.0)), State::Locked);
    assert_eq!(relation.state(at(31.0)), State::Holding);
    // An hour later it is still stated, and its error lies within what is said of it.
    let hour = at(3630.0);
    let (error_s, sigma_s) = (error_s(relation, &setup, hour), relation.sigma_s(hour));
    assert!(sigma_s > relation.sigma_s(at(30.0)) && error_s.abs() < 3.0 * sigma_s, "{error_s} {sigma_s}");
    assert_eq!(relation.state(at(1e6)), State::None);
    assert_eq!(relation.label(at(1e6)), None);
}

#[test]
fn a_code_that_goes_on_elsewhere_is_followed_after_four_frames_and_not_before() {
    let mut setup = Setup::new(Rate::Video25, 0.0, 0.0, Frame::new(10, 0, 0, 0));
    let mut follower = Follower::new(0.0, 1);
    run(&mut setup, &mut follower, 10.0, |_| CLEAN);
    let (first, samples) = (setup.first, setup.samples);
    setup.encoder.skip(25 * 3600);
    setup.first = Frame::new(11, 0, 0, 0);
    let mut decoder = ltc::Decoder::new(SAMPLE_RATE_HZ);
    // What came before has gone through another decoder: samples are counted on.
    let mut followed_at = None;
    while setup.samples < samples + 48_000 {
        let (read, t_read) = setup.period();
        let before_s = samples as f64 / SAMPLE_RATE_HZ;
        decoder.push(&read, 0, |mut reading| {
            reading.position_s = reading.position_s.map(|position_s| position_s + before_s);
            follower.push(t_read, &reading);
        });
        let label = follower.relation().unwrap().label(t_read).unwrap();
        if label.frame.hours == 11 {
            followed_at.get_or_insert(t_read.as_secs_f64());
            assert!(error_s(follower.relation().unwrap(), &setup, t_read).abs() < LIMIT_S);
        } else {
            assert_eq!((label.frame.hours, followed_at), (first.hours, None));
        }
    }
    assert!((10.1..10.4).contains(&followed_at.unwrap()), "{followed_at:?}");
    assert_eq!(follower.jumps(), 1);
}

#[test]
fn samples_that_a_card_loses_and_a_stream_that_begins_anew_move_no_code() {
    let mut setup = Setup::new(Rate::Video30Drop, 50.0, -30.0, Frame::new(10, 0, 58, 0));
    let mut follower = Follower::new(0.0, 1);
    let mut decoder = ltc::Decoder::new(SAMPLE_RATE_HZ);
    let (mut worst_s, mut stream) = (0.0_f64, 0);
    for period in 0..2400 {
        let (samples, t_read) = setup.period();
        // 150 ms that never come at 10 s, another stream at 17 s.
        if (1000..1015).contains(&period) {
            continue;
        }
        stream += u32::from(period == 1700);
        decoder.push(&samples, stream, |reading| _ = follower.push(t_read, &reading));
        if let Some(relation) = follower.relation() {
            worst_s = worst_s.max(error_s(relation, &setup, t_read).abs());
        }
    }
    assert!(worst_s < LIMIT_S, "{:.3} ms", 1e3 * worst_s);
    assert_eq!(follower.jumps(), 0);
}

#[test]
fn levels_polarity_noise_and_pieces_change_nothing_and_a_wrong_frame_is_not_believed() {
    let wires = [
        Wire::Code { level: -1.0, noise: 0.0 },
        Wire::Code { level: 0.01, noise: 0.0002 },
        Wire::Code { level: 1.0, noise: 0.05 },
    ];
    for wire in wires {
        let mut setup = Setup::new(Rate::Film24, 20.0, 10.0, Frame::new(10, 0, 0, 0));
        let mut follower = Follower::new(0.0, 1);
        let worst_s = run(&mut setup, &mut follower, 6.0, |t_s| match wire {
            // The level rises and falls four times as high.
            Wire::Code { level, noise } if t_s % 2.0 > 1.0 => {
                Wire::Code { level: level / 4.0, noise: noise / 4.0 }
            }
            wire => wire,
        });
        let relation = follower.relation().expect("it locks");
        assert!(worst_s < LIMIT_S && relation.state(Timestamp::from_secs_f64(6.0)) == State::Locked);
    }
    // One frame that says another hour, with everything else as it should be.
    let mut setup = Setup::new(Rate::Video25, 0.0, 0.0, Frame::new(10, 0, 0, 0));
    let (mut decoder, mut follower) = (ltc::Decoder::new(SAMPLE_RATE_HZ), Follower::new(0.0, 1));
    let mut count = 0;
    while count < 100 {
        let (samples, t_read) = setup.period();
        decoder.push(&samples, 0, |mut reading| {
            count += 1;
            reading.frame.hours += u8::from(count % 10 == 0);
            follower.push(t_read, &reading);
        });
        if let Some(relation) = follower.relation() {
            assert!(error_s(relation, &setup, t_read).abs() < LIMIT_S);
        }
    }
    assert_eq!(follower.jumps(), 0);
}

#[test]
fn samples_in_any_pieces_give_the_same_frames() {
    let counting = Rate::Video30Drop.counting();
    let mut encoder = ltc::Encoder::new(44_100.0, Rate::Video30Drop.hz(), counting, Frame::new(1, 2, 3, 4))
        .with_user_bits(0x1234_5678);
    let samples: Vec<f32> = (0..44_100).map(|_| encoder.sample()).collect();
    let read = |piece: usize| {
        let (mut decoder, mut readings) = (ltc::Decoder::new(44_100.0), Vec::<Reading>::new());
        samples.chunks(piece).for_each(|piece| decoder.push(piece, 0, |reading| readings.push(reading)));
        readings
    };
    let whole = read(samples.len());
    assert!(
        whole.len() >= 27 && whole.iter().all(|reading| reading.user_bits == 0x1234_5678 && reading.drop)
    );
    for piece in [1, 7, 480] {
        let pieces = read(piece);
        assert_eq!(pieces.len(), whole.len());
        for (of_piece, of_whole) in pieces.iter().zip(&whole) {
            assert_eq!((of_piece.frame, of_piece.position_s), (of_whole.frame, of_whole.position_s));
        }
    }
}

#[test]
fn code_that_runs_backwards_or_at_another_speed_is_read_and_not_followed() {
    let counting = Rate::Video25.counting();
    for speed in [0.3, 0.7, 2.0, 4.0] {
        let mut encoder = ltc::Encoder::new(SAMPLE_RATE_HZ, 25.0 * speed, counting, Frame::new(10, 0, 0, 0));
        let mut samples: Vec<f32> = (0..96_000).map(|_| encoder.sample()).collect();
        for reversed in [false, true] {
            let (mut decoder, mut follower) = (ltc::Decoder::new(SAMPLE_RATE_HZ), Follower::new(0.0, 1));
            let mut readings = Vec::new();
            decoder.push(&samples, 0, |reading| {
                follower.push(Timestamp::from_secs_f64(2.0), &reading);
                readings.push(reading);
            });
            let least = 0.8 * 2.0 * 25.0 * speed;
            assert!(readings.len() as f64 > least, "{speed} {reversed}: {} of {least}", readings.len());
            assert!(readings.iter().all(|reading| reading.reversed == reversed));
            assert_eq!(follower.relation(), None);
            samples.reverse();
        }
    }
}

#[test]
fn noise_silence_and_numbers_that_are_none_give_no_frame() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let noise: Vec<f32> = (0..480_000).map(|_| random.random::<f32>() - 0.5).collect();
    let odd = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 0.0];
    let odd: Vec<f32> = (0..48_000).map(|n| odd[n * n % 5]).collect();
    for samples in [vec![0.0; 48_000], noise, odd, vec![1.0; 48_000]] {
        let mut decoder = ltc::Decoder::new(SAMPLE_RATE_HZ);
        decoder.push(&samples, 0, |reading| panic!("{reading:?}"));
    }
}

#[test]
fn midi_is_followed_within_a_millisecond_once_its_pace_is_known() {
    for (rate, drift_ppm) in [
        (Rate::Video25, 0.0),
        (Rate::Video30Drop, 100.0),
        (Rate::Film24, -100.0),
        (Rate::Film24PulledDown, 0.0),
    ] {
        let counting = rate.counting();
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let (mut decoder, mut follower) = (mtc::Decoder::default(), Follower::new(0.0, 1));
        let setup = Setup::new(rate, drift_ppm, 0.0, Frame::new(9, 59, 59, 0));
        let first = counting.number(setup.first).unwrap();
        let mut sent = VecDeque::new();
        for pair in 0..(30.0 * rate.hz() / 2.0) as u32 {
            let frame = counting.frame(first + 2 * pair);
            for (at, bytes) in mtc::quarter_frames(frame, counting).into_iter().enumerate() {
                let t_s = (f64::from(pair) * 2.0 + at as f64 / 4.0) / (rate.hz() * (1.0 + drift_ppm * 1e-6));
                let late_s = 1e-4 - 3e-4 * libm::log(1.0 - random.random::<f64>());
                sent.push_back((t_s + late_s, bytes));
            }
        }
        let mut worst_s = 0.0_f64;
        for (t_s, bytes) in sent {
            // Four seconds are lost.
            if (14.0..18.0).contains(&t_s) {
                continue;
            }
            let t_read = Timestamp::from_secs_f64(t_s);
            decoder.push(t_read, &bytes, 0, |reading| _ = follower.push(t_read, &reading));
            if let Some(relation) = follower.relation().filter(|_| t_s > 9.0) {
                worst_s = worst_s.max(error_s(relation, &setup, t_read).abs());
            }
        }
        assert!(worst_s < LIMIT_S, "{rate}: {:.3} ms", 1e3 * worst_s);
        assert_eq!(follower.relation().unwrap().rate(), Some(rate));
        assert_eq!(follower.jumps(), 0);
    }
}

#[test]
fn readings_out_of_a_damaged_log_break_nothing() {
    let mut follower = Follower::new(0.0, 1);
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let odd = [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e300, 1.0];
    for n in 0..20_000 {
        let mut pick = || odd[random.random_range(0..odd.len())];
        let (position_s, behind_s) = (pick(), pick());
        let mut byte = || random.random::<u8>();
        let reading = Reading {
            frame: Frame::new(byte() % 25, byte() % 61, byte() % 61, byte() % 31),
            drop: byte() < 128,
            frames_per_s: (byte() < 128).then(&mut byte).filter(|_| n % 2 == 0),
            user_bits: 0,
            stream: n / 5000,
            position_s: (byte() < 200).then_some(position_s),
            behind_s,
            reversed: byte() < 20,
        };
        follower.push(Timestamp::from_nanos(i64::from(n) * i64::from(byte())), &reading);
        if let Some(relation) = follower.relation() {
            let label: Option<Label> = relation.label(Timestamp::from_nanos(i64::MAX));
            assert!(label.is_none_or(|label| label.frame.hours < 24));
        }
    }
}
