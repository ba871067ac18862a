//! One device: who it is, what its sensors have sent, and its clock.
//!
//! Numbers and times of a device that was switched off begin anew, and so they look when they were damaged, or have waited for seconds in a
//! network. What does not follow is a [`Rival`]: it is believed once it goes on by itself for a while, or where the device had been silent.

use std::net::SocketAddr;

use posed_state::Plain;

use super::wire::{Count, Hello, Time, Unit as TimeUnit};
use crate::rate::Rate;
use crate::sample::{DeviceTime, Timestamp};

/// Most sensors of one device.
pub(super) const MOST_SENSORS: usize = 16;
/// Rates that a device may claim, Hz.
pub(super) const RATES_HZ: std::ops::RangeInclusive<f64> = 1.0..=1000.0;
/// Silence after which a device is stale, and after which it is lost, s.
pub(super) const STALE_S: f64 = 2.0;
pub(super) const LOST_S: f64 = 10.0;
/// A number further back than this is no late sample.
const LATE: i64 = 1000;
/// A time further back than this, or further ahead of the host's clock than any before, is that of another life of the device, s.
const APART_S: f64 = 1.0;
/// Most samples that come at once after they have waited.
const AT_ONCE: f64 = 1000.0;
/// Most samples a second of one count, with room for a crystal and a burst.
const MOST_PER_S: u32 = 1100;
/// A rival is believed after so many samples in so long a time, s.
const AGREEING: u32 = 3;
const BELIEVED_S: f64 = 0.1;
/// How fast the device's clock may gain on the host's: 500 ppm.
const DRIFT: f64 = 5e-4;

/// Whether a device is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub(super) enum Presence {
    /// It has not come yet, or it has gone.
    #[default]
    Away,
    /// It sends.
    Here,
    /// It has been silent for some seconds.
    Stale,
}

/// What to do with a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It is new, and so many before it are missing.
    Follows(u32),
    /// It was there before, or one after it was.
    Late,
    /// It does not follow, and nobody knows yet whether the device has begun anew.
    Doubtful,
    /// There are more of them than the format allows.
    TooMany,
}

/// Samples of one count.
#[derive(Clone, Copy, Debug, Default, Plain)]
struct Sequence {
    last: Option<u32>,
    /// When its latest second began, and how many came in it.
    second: Option<Timestamp>,
    count: u32,
}

/// One sensor of a device.
#[derive(Clone, Copy, Debug, Plain)]
pub(super) struct Stream {
    sensor: u8,
    motion: Sequence,
    orientation: Sequence,
}

/// The device's clock, unwrapped.
#[derive(Clone, Copy, Debug, Default, Plain)]
struct Clock {
    /// The latest time, in ticks as sent and unwrapped, and the host's time of its coming.
    last: Option<(i64, u64)>,
    /// Host time less device time of the fastest sample, s: since when, and how much.
    fastest: Option<(Timestamp, f64)>,
}

/// Samples that do not follow, but one another.
#[derive(Clone, Copy, Debug, Plain)]
struct Rival {
    sensor: u8,
    count: Count,
    begun: Timestamp,
    at: Timestamp,
    number: Option<u32>,
    ticks: Option<i64>,
    samples: u32,
}

/// A device, named in the settings or found.
#[derive(Clone, Debug, Plain)]
pub(super) struct Unit {
    pub(super) id: String,
    pub(super) name: Option<String>,
    pub(super) rate: Option<Rate>,
    /// Who sends under its name.
    pub(super) peer: Option<SocketAddr>,
    pub(super) heard: Option<Timestamp>,
    /// When it last sent a sample that was new.
    sampled: Option<Timestamp>,
    pub(super) presence: Presence,
    /// How often its clock has begun anew; 0 before its first message.
    pub(super) epoch: u32,
    buttons: u32,
    unit: TimeUnit,
    bits: u8,
    clock: Clock,
    streams: Vec<Stream>,
    rival: Option<Rival>,
    /// Samples without a number so far.
    unnumbered: u64,
}

impl Unit {
    pub(super) fn new(id: String) -> Self {
        Self {
            id,
            name: None,
            rate: None,
            peer: None,
            heard: None,
            sampled: None,
            presence: Presence::Away,
            epoch: 0,
            buttons: 0,
            unit: TimeUnit::default(),
            bits: 32,
            clock: Clock::default(),
            streams: Vec::new(),
            rival: None,
            unnumbered: 0,
        }
    }

    /// Seconds since it was heard.
    pub(super) fn silent_s(&self, now: Timestamp) -> f64 {
        self.heard.map_or(f64::INFINITY, |heard| now.seconds_since(heard))
    }

    /// Whether somebody else sends under its name now.
    pub(super) fn is_anothers(&self, now: Timestamp, peer: Option<SocketAddr>) -> bool {
        self.peer.is_some() && self.peer != peer && self.silent_s(now) < STALE_S
    }

    /// The device, its clock or its connection has begun anew.
    pub(super) fn begin_anew(&mut self) {
        self.epoch += 1;
        self.clock = Clock::default();
        self.rival = None;
        for stream in &mut self.streams {
            stream.motion.last = None;
            stream.orientation.last = None;
        }
    }

    /// Takes what it says of itself; false where it claims a rate that cannot be.
    pub(super) fn hello(&mut self, hello: &Hello) -> bool {
        let (unit, bits) = (hello.unit.unwrap_or_default(), hello.bits.unwrap_or(32));
        if (unit, bits) != (self.unit, self.bits) {
            self.clock = Clock::default();
            (self.unit, self.bits) = (unit, bits);
        }
        if self.name != hello.name {
            self.name.clone_from(&hello.name);
        }
        let Some(claimed_hz) = hello.rate_hz else { return true };
        let rate = Rate::claimed(claimed_hz, &RATES_HZ);
        if let Ok(rate) = rate {
            self.rate = Some(rate);
        }
        rate.is_ok()
    }

    /// The place of a sensor's stream, and whether it is new; `None` where there are too many.
    pub(super) fn stream(&mut self, sensor: u8) -> Option<(usize, bool)> {
        if let Some(at) = self.streams.iter().position(|stream| stream.sensor == sensor) {
            return Some((at, false));
        }
        if self.streams.len() == MOST_SENSORS {
            return None;
        }
        let (motion, orientation) = (Sequence::default(), Sequence::default());
        self.streams.push(Stream { sensor, motion, orientation });
        Some((self.streams.len() - 1, true))
    }

    /// Which of its buttons have just been pressed.
    pub(super) fn pressed(&mut self, buttons: u32) -> u32 {
        let before = std::mem::replace(&mut self.buttons, buttons);
        buttons & !before
    }

    /// A time in ticks: whole units, or microseconds where units are too coarse for what was written.
    fn ticks(&self, time: Time) -> i64 {
        match time {
            Time::Ticks(ticks) if self.unit != TimeUnit::Seconds => ticks,
            Time::Ticks(seconds) => seconds.saturating_mul(1_000_000),
            Time::Units(units) if self.unit != TimeUnit::Seconds => units.round() as i64,
            Time::Units(seconds) => (seconds * 1e6).round() as i64,
            Time::Seconds(seconds) => (seconds * 1e6 / self.tick_us()).round() as i64,
        }
    }

    fn tick_us(&self) -> f64 {
        if self.unit == TimeUnit::Milliseconds { 1000.0 } else { 1.0 }
    }

    fn tick_s(&self) -> f64 {
        if self.unit == TimeUnit::Milliseconds { 1e-3 } else { 1e-6 }
    }

    /// The way from one time to another, in ticks; over the end of the clock where that is nearer.
    fn step(&self, from: i64, to: i64) -> i64 {
        // Seconds with a fraction never wrap: their width is of another unit.
        match self.bits {
            32 if self.unit != TimeUnit::Seconds => i64::from(to.wrapping_sub(from) as i32),
            64 => to.wrapping_sub(from),
            _ => to.saturating_sub(from),
        }
    }

    /// Judges a sample of the stream at `at`, and takes note of it if it follows.
    pub(super) fn judge(
        &mut self,
        now: Timestamp,
        at: usize,
        count: Count,
        number: Option<u32>,
        time: Option<Time>,
    ) -> Verdict {
        let silent_s = self.sampled.map_or(f64::INFINITY, |sampled| now.seconds_since(sampled));
        let (stream, ticks) = (self.streams[at], time.map(|time| self.ticks(time)));
        let sequence = match count {
            Count::Motion => stream.motion,
            Count::Orientation => stream.orientation,
        };
        let mut verdict = self.order(sequence.last, number, ticks, silent_s);
        if ticks.is_some_and(|ticks| self.is_apart(now, ticks, silent_s)) {
            verdict = Verdict::Doubtful;
        }
        if verdict == Verdict::Doubtful
            && (silent_s >= STALE_S || self.rival(now, stream.sensor, count, number, ticks))
        {
            self.begin_anew();
            verdict = Verdict::Follows(0);
        }
        let sequence = match count {
            Count::Motion => &mut self.streams[at].motion,
            Count::Orientation => &mut self.streams[at].orientation,
        };
        if let Verdict::Follows(_) = verdict {
            if sequence.second.is_none_or(|second| now.seconds_since(second) >= 1.0) {
                (sequence.second, sequence.count) = (Some(now), 0);
            }
            sequence.count += 1;
            let is_flood = sequence.count > MOST_PER_S;
            if number.is_some() {
                sequence.last = number;
            }
            self.rival = None;
            self.sampled = Some(now);
            if let Some(ticks) = ticks {
                self.follow(now, ticks);
            }
            if is_flood {
                return Verdict::TooMany;
            }
        }
        verdict
    }

    /// What its number says of a sample.
    fn order(&self, last: Option<u32>, number: Option<u32>, ticks: Option<i64>, silent_s: f64) -> Verdict {
        let Some((last, number)) = last.zip(number) else { return Verdict::Follows(0) };
        let step = i64::from(number.wrapping_sub(last) as i32);
        if step <= 0 {
            // A count that goes back while the clock goes on has begun anew.
            let ahead = self.clock.last.zip(ticks).map(|((raw, _), ticks)| self.step(raw, ticks));
            let is_newer = ahead.is_some_and(|ahead| ahead as f64 * self.tick_s() > APART_S);
            // So long after the others nothing is late: it was switched off.
            let is_alone = step < 0 && silent_s >= STALE_S;
            return if -step > LATE || is_newer || is_alone { Verdict::Doubtful } else { Verdict::Late };
        }
        if step as f64 > AT_ONCE + f64::from(MOST_PER_S) * silent_s {
            return Verdict::Doubtful;
        }
        Verdict::Follows((step - 1) as u32)
    }

    /// Whether a time cannot be of the same life as those before.
    fn is_apart(&self, now: Timestamp, ticks: i64, silent_s: f64) -> bool {
        let (Some((raw, unwrapped)), Some((since, fastest_s))) = (self.clock.last, self.clock.fastest) else {
            return false;
        };
        let step = self.step(raw, ticks);
        let step_s = step as f64 * self.tick_s();
        let device_s = (i128::from(unwrapped) + i128::from(step)) as f64 * self.tick_s();
        let behind_s = now.as_secs_f64() - device_s - fastest_s;
        let drift_s = DRIFT * now.seconds_since(since);
        let is_back = step_s < -APART_S;
        let is_ahead = behind_s < -APART_S - drift_s;
        // Nothing waits for so long in a network.
        let is_away = silent_s >= LOST_S && behind_s > APART_S + drift_s;
        is_back || is_ahead || is_away
    }

    /// Takes note of the time of a sample that follows.
    fn follow(&mut self, now: Timestamp, ticks: i64) {
        let unwrapped = match self.clock.last {
            None if self.bits == 32 && self.unit != TimeUnit::Seconds => u64::from(ticks as u32),
            None => ticks.max(0) as u64,
            Some((raw, unwrapped)) => {
                let step = self.step(raw, ticks);
                let unwrapped = unwrapped.wrapping_add_signed(step);
                if step < 0 {
                    return;
                }
                unwrapped
            }
        };
        self.clock.last = Some((ticks, unwrapped));
        let behind_s = now.as_secs_f64() - unwrapped as f64 * self.tick_s();
        match &mut self.clock.fastest {
            Some((since, fastest_s)) if behind_s < *fastest_s => (*since, *fastest_s) = (now, behind_s),
            Some(_) => {}
            fastest => *fastest = Some((now, behind_s)),
        }
    }

    /// The time of a sample that follows, as the clock model gets it.
    pub(super) fn device_time(&mut self, number: Option<u32>, time: Option<Time>) -> DeviceTime {
        match (time, self.clock.last) {
            (Some(time), Some((raw, unwrapped))) => {
                let ticks = unwrapped.wrapping_add_signed(self.step(raw, self.ticks(time)));
                DeviceTime::Counter { ticks, tick_s: self.tick_s() }
            }
            _ => {
                self.unnumbered += 1;
                DeviceTime::Cycle(number.map_or(self.unnumbered, u64::from))
            }
        }
    }

    /// Adds a sample that does not follow; whether it is believed now, with those before it.
    fn rival(
        &mut self,
        now: Timestamp,
        sensor: u8,
        count: Count,
        number: Option<u32>,
        ticks: Option<i64>,
    ) -> bool {
        let new = Rival { sensor, count, begun: now, at: now, number, ticks, samples: 1 };
        let Some(before) = self.rival.filter(|rival| now.seconds_since(rival.at) < STALE_S) else {
            self.rival = Some(new);
            return false;
        };
        if (before.sensor, before.count) != (sensor, count) {
            return false;
        }
        let counts = match (before.number, number) {
            (Some(before), Some(number)) => {
                (1..=LATE).contains(&i64::from(number.wrapping_sub(before) as i32))
            }
            (before, number) => before.is_none() && number.is_none(),
        };
        let passes = match (before.ticks, ticks) {
            (Some(then), Some(ticks)) => {
                let step_s = self.step(then, ticks) as f64 * self.tick_s();
                step_s > 0.0 && step_s <= now.seconds_since(before.at) + APART_S
            }
            (before, ticks) => before.is_none() && ticks.is_none(),
        };
        if !(counts && passes) {
            self.rival = Some(new);
            return false;
        }
        let rival = Rival { begun: before.begun, samples: before.samples + 1, ..new };
        self.rival = Some(rival);
        rival.samples >= AGREEING && now.seconds_since(rival.begun) >= BELIEVED_S
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(t_s: f64) -> Timestamp {
        Timestamp::from_secs_f64(t_s)
    }

    struct Sender {
        unit: Unit,
        stream: usize,
    }

    impl Sender {
        fn new() -> Self {
            let mut unit = Unit::new("esp-7f3a".to_owned());
            let stream = unit.stream(0).unwrap().0;
            Self { unit, stream }
        }

        fn push(&mut self, t_s: f64, number: u32, ticks: i64) -> Verdict {
            let time = Some(Time::Ticks(ticks));
            self.unit.judge(at(t_s), self.stream, Count::Motion, Some(number), time)
        }

        fn ticks(&mut self, ticks: i64) -> u64 {
            match self.unit.device_time(Some(0), Some(Time::Ticks(ticks))) {
                DeviceTime::Counter { ticks, .. } | DeviceTime::Cycle(ticks) => ticks,
            }
        }
    }

    #[test]
    fn numbers_wrap_show_losses_and_what_is_late() {
        let mut sender = Sender::new();
        for (k, number) in [u32::MAX - 1, u32::MAX, 0, 1].into_iter().enumerate() {
            let verdict = sender.push(0.01 * k as f64, number, 10_000 * k as i64);
            assert_eq!(verdict, Verdict::Follows(0), "{number}");
        }
        assert_eq!(sender.push(0.08, 5, 80_000), Verdict::Follows(3));
        assert_eq!(sender.push(0.081, 5, 80_000), Verdict::Late);
        assert_eq!(sender.push(0.082, 4, 70_000), Verdict::Late);
        assert_eq!(sender.push(0.09, 9, 90_000), Verdict::Follows(3));
    }

    #[test]
    fn a_clock_of_32_bits_wraps() {
        let mut sender = Sender::new();
        sender.push(0.0, 1, 4_294_967_000);
        let before = sender.ticks(4_294_967_000);
        assert_eq!(sender.push(0.001, 2, 704), Verdict::Follows(0));
        assert_eq!(sender.ticks(704) - before, 1000);
    }

    #[test]
    fn a_device_that_was_switched_off_is_believed_soon_and_one_damaged_time_never() {
        let mut sender = Sender::new();
        for k in 0..1000_u32 {
            sender.push(0.01 * f64::from(k), 5000 + k, 60_000_000 + 10_000 * i64::from(k));
        }
        let epoch = sender.unit.epoch;
        for (number, ticks) in
            [(6000, 900_000_000), (6000, 20_000_000), (4_000_000, 70_000_000), (17, 70_000_000)]
        {
            assert_eq!(sender.push(10.0, number, ticks), Verdict::Doubtful, "{number} {ticks}");
        }
        assert_eq!(sender.push(10.0, 6000, 70_000_000), Verdict::Follows(0));
        let anew: Vec<Verdict> = (0..20)
            .map(|k| sender.push(10.5 + 0.01 * f64::from(k), k, 300_000 + 10_000 * i64::from(k)))
            .collect();
        assert_eq!(anew.iter().filter(|verdict| **verdict == Verdict::Doubtful).count(), 10);
        assert!(anew[10..].iter().all(|verdict| *verdict == Verdict::Follows(0)), "{anew:?}");
        assert_eq!(sender.unit.epoch, epoch + 1);
        // After a silence there is nothing to be damaged.
        assert_eq!(sender.push(14.0, 2, 20_000), Verdict::Follows(0));
        assert_eq!(sender.unit.epoch, epoch + 2);
    }

    #[test]
    fn what_waited_in_the_network_is_no_restart() {
        let mut sender = Sender::new();
        sender.push(0.0, 0, 0);
        // Five seconds of samples at once, and the stream goes on.
        for k in 1..=500_u32 {
            assert_eq!(sender.push(5.0, k, 10_000 * i64::from(k)), Verdict::Follows(0), "{k}");
        }
        assert_eq!(sender.push(5.01, 501, 5_010_000), Verdict::Follows(0));
    }
}
