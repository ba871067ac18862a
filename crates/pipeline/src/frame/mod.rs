//! Frames: the stage clock, and which samples belong to which of its ticks.
//!
//! What comes in: the cycles and samples of all devices, with their capture times. What goes out: [`Frame`]s
//! with strictly rising times, each holding all samples with `t_valid` in `(t_k-1, t_k]`, and where it has none of a sensor
//! that measures at every tick, the one that follows within [`SLACK`]. What it never does: interpolate, reorder, wait for a
//! sensor that is not expected.
//!
//! Ticks lie on the samples of one device. Those of another one in step with it lie on the ticks, too, and capture times are
//! known to a fraction of a millisecond: without slack chance would decide in which frame each of them is.
//!
//! The stage clock follows the fastest device: its cycles are the ticks, so that its samples lie on them and
//! are never resampled. Cycles that were lost get their ticks from the clock model. While that device is
//! silent the ticks go on for [`COAST_S`] with `missing` sensors, then stop until something arrives. A stage
//! with a frame rate of its own ticks on the grid of that rate instead.
//!
//! A frame closes when every expected sensor has said what it has to say up to the tick, or else
//! `frame_wait_ms` after the last of them usually has. A sample that comes later joins the next frame, late, and so does one that
//! has waited for a tick for so long that it is of another time.

mod device;

use posed_state::{Plain, State};
use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::Timestamp;

use crate::clock::Stamp;
use device::Device;
use posed_stage::input::{DeviceIndex, SensorIndex};
use posed_stage::output::Measured;

/// How long ticks go on without a sample of any device, s; then they stop until one arrives.
pub const COAST_S: f64 = 0.5;
/// Share of a period by which the sample of a frame that lacks one may follow its tick.
const SLACK: f64 = 0.25;
/// How much longer than the ticks' interval the period of a device may be that measures at every tick.
const SAME_RATE: f64 = 1.1;
/// A sample that waited longer for a tick than so many of its device's periods, and than so long, s, is of another time: ticks were left
/// out, or they follow a slower device.
const WAITS_PERIODS: f64 = 1.5;
const WAITS_S: f64 = 0.1;
/// A sensor that has missed so many cycles is no longer waited for.
const UNHEARD_CYCLES: f64 = 5.0;
/// Share of a period by which a cycle between two ticks may be late before it counts as missed.
const OVERDUE: f64 = 0.5;
/// Another device takes over the stage clock only if it is faster by more than this.
const FASTER: f64 = 0.99;

/// One sample in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct FrameSample {
    /// The record, with its capture time.
    pub measured: Measured,
    /// It belongs to an earlier frame, which had closed when it arrived, or to a time without frames; or it may have waited on its way,
    /// so that nobody knows.
    pub late: bool,
}

/// One sensor in a frame.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub struct FrameSensor {
    /// All samples since the last tick, and late ones, oldest first; the newest is the frame's value. Where there is none, one that
    /// follows the tick by up to a quarter of a period. Empty where none came.
    pub samples: Vec<FrameSample>,
    /// Cycles of the sensor's device without a sample that this frame accounts for: counted by the cycles of the device's clock,
    /// so an estimate where the device was away.
    pub missed: u32,
}

impl FrameSensor {
    /// Whether the sensor's device should have measured it since the last tick: false where no cycle of a slower device fell into
    /// the frame, and once the device has stopped.
    pub fn expected(&self) -> bool {
        self.missed > 0 || !self.samples.is_empty()
    }
}

/// The samples of all sensors up to one tick, as they came: nothing is filtered or interpolated.
#[derive(Clone, Debug, Default, PartialEq, Plain)]
pub struct Frame {
    /// Number of the frame, from 0.
    pub number: u64,
    /// The tick: a capture time on the host's clock, later than that of the frame before.
    pub t_valid: Timestamp,
    /// Host time at which it closed.
    pub t_closed: Timestamp,
    /// Standard deviation of `t_valid`, s: that of the latest cycle of the stage clock's device, or of any with a frame rate.
    pub sigma_t_s: f64,
    /// Ticks that were left out in front of this one, while the stage was silent for longer than [`COAST_S`].
    pub ticks_left_out: u64,
    /// The tick comes from the clock model: no record shows that the device measured then. False for ticks of a frame rate.
    pub by_model: bool,
    /// One per sensor, in the stage's order.
    pub sensors: Vec<FrameSensor>,
}

/// A tick that has not closed.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Tick {
    t: Timestamp,
    /// The device whose cycle it is; `None` for a tick of the grid, or between the cycles of two devices.
    device: Option<usize>,
    by_model: bool,
    left_out: u64,
}

#[derive(Clone, Debug, Plain)]
struct Sensor {
    device: usize,
    queue: VecDeque<FrameSample>,
    newest: Option<Timestamp>,
    /// Latest cycle that a frame has accounted for, sample or not; what its device misses while it is stopped is
    /// accounted for when it is back.
    accounted: Option<Timestamp>,
}

impl Sensor {
    /// Cycles without a sample up to the tick `t` that no frame has accounted for.
    ///
    /// The stage clock's own device (`own_interval_s`) has a cycle at every tick. Cycles of others lie anywhere between
    /// ticks, and some ticks have none: one is missed once it is overdue, or when the sample after it comes.
    fn missed(
        &mut self,
        device: &Device,
        samples: &[FrameSample],
        t: Timestamp,
        own_interval_s: Option<f64>,
    ) -> u32 {
        let newest = samples.iter().rev().find(|sample| !sample.late).map(|sample| sample.measured.t_valid);
        // Nothing is expected of a device that has stopped; what it had said before still counts.
        let Some(period_s) = device.period_s().filter(|_| device.is_running() || newest.is_some()) else {
            return 0;
        };
        if let Some(interval_s) = own_interval_s {
            // Ticks since then that were not its own: it was away while others measured, or its cycles fell between
            // the ticks of the one that kept the clock before.
            let away_s = self.accounted.map_or(0.0, |before| t.seconds_since(before) - interval_s);
            let away = (away_s / period_s).round().max(0.0) as u32;
            let between = samples.iter().filter(|sample| !sample.late).count().saturating_sub(1) as u32;
            let begins = self.accounted.replace(t).is_none();
            if begins && samples.is_empty() {
                // The first cycle of a device that was met in the middle of one.
                return 0;
            }
            return away.saturating_sub(between)
                + u32::from(samples.is_empty() && period_s < 1.5 * interval_s);
        }
        let (missed, accounted) = match (newest, self.accounted) {
            (Some(newest), None) => (0, Some(newest)),
            (None, None) => (0, None),
            (Some(newest), Some(before)) => {
                let cycles = (newest.seconds_since(before) / period_s).round() as i64;
                ((cycles - samples.len() as i64).max(0), Some(newest.max(before)))
            }
            (None, Some(before)) => {
                let cycles = (t.seconds_since(before) / period_s - OVERDUE).floor().max(0.0);
                (cycles as i64, Some(before + Duration::from_secs_f64(cycles * period_s)))
            }
        };
        self.accounted = accounted;
        missed as u32
    }
}

/// Sorts samples into frames. What it calls a device is whatever has a clock of its own: a device, or one unit of a device.
///
/// Push in order of arrival: [`Self::stamp`] and [`Self::sample`] for each sample, then [`Self::poll`] until `None`.
#[derive(Clone, Debug, State)]
pub struct Assembler {
    /// Fixed interval of the ticks, s; `None`: they follow the fastest device.
    #[state(keep)]
    grid_s: Option<f64>,
    #[state(keep)]
    wait_s: f64,
    devices: Vec<Device>,
    sensors: Vec<Sensor>,
    reference: Option<usize>,
    pending: VecDeque<Tick>,
    last_scheduled: Option<Timestamp>,
    /// The device of that tick.
    scheduled_by: Option<usize>,
    last_closed: Option<Timestamp>,
    sigma_t_s: f64,
    /// Ticks of the grid left out before the next one.
    left_out: u64,
    frame: Frame,
}

impl Assembler {
    /// An assembler before its first sample, for `devices` clocks and for `sensors`, each given by its clock, from 0.
    ///
    /// `frame_rate_hz` (Hz, above 0) fixes the ticks to multiples of its period since the stage's epoch; with `None` they follow
    /// the fastest device. `frame_wait_ms` (ms, at least 0) is how long a frame waits for its last sensors beyond their lag.
    /// The pipeline takes both from the stage file. A sensor of a clock that is not there makes later calls panic.
    pub fn new(
        devices: usize,
        sensors: &[DeviceIndex],
        frame_rate_hz: Option<f64>,
        frame_wait_ms: f64,
    ) -> Self {
        let queue = || VecDeque::with_capacity(16);
        Self {
            grid_s: frame_rate_hz.map(f64::recip),
            wait_s: frame_wait_ms * 1e-3,
            devices: (0..devices).map(|_| Device::default()).collect(),
            sensors: sensors
                .iter()
                .map(|&device| Sensor {
                    device: usize::from(device),
                    queue: queue(),
                    newest: None,
                    accounted: None,
                })
                .collect(),
            reference: None,
            pending: VecDeque::with_capacity(64),
            last_scheduled: None,
            scheduled_by: None,
            last_closed: None,
            sigma_t_s: 0.0,
            left_out: 0,
            frame: Frame {
                sensors: sensors
                    .iter()
                    .map(|_| FrameSensor { samples: Vec::with_capacity(16), missed: 0 })
                    .collect(),
                ..Frame::default()
            },
        }
    }

    /// A device has measured: takes the stamp of one of its samples, the interval of its cycles, s, above 0, as its clock knows
    /// it (`None`: not yet), and the host time. The device counts as running from now on.
    ///
    /// # Panics
    /// There is no such device.
    pub fn stamp(&mut self, device: DeviceIndex, stamp: &Stamp, period_s: Option<f64>, now: Timestamp) {
        let index = usize::from(device);
        self.devices[index].stamp(stamp.t_valid, period_s, now);
        if stamp.begins_cycle {
            self.choose_reference(now);
            if self.grid_s.is_none() && self.reference == Some(index) {
                self.sigma_t_s = stamp.sigma_s;
                self.schedule_cycle(index, stamp.t_valid);
            } else if let Some(grid_s) = self.grid_s {
                self.sigma_t_s = stamp.sigma_s;
                self.anchor_grid(stamp.t_valid, grid_s);
            }
        }
    }

    /// Takes a sample of one sensor, whose capture times must not go back. It joins the first frame whose tick is not before it;
    /// one that is not after the last closed tick is late and joins the next frame, and so is one that was `queued`
    /// ([`Stamp::queued`]).
    ///
    /// # Panics
    /// There is no such sensor.
    pub fn sample(&mut self, sensor: SensorIndex, measured: Measured, queued: bool) {
        let late = queued || self.last_closed.is_some_and(|closed| measured.t_valid <= closed);
        let sensor = &mut self.sensors[usize::from(sensor)];
        sensor.newest = sensor.newest.max(Some(measured.t_valid));
        sensor.queue.push_back(FrameSample { measured, late });
    }

    /// A device has stopped: nothing more is expected of it until its next [`Self::stamp`].
    ///
    /// # Panics
    /// There is no such device.
    pub fn stop(&mut self, device: DeviceIndex) {
        self.devices[usize::from(device)].stop();
    }

    /// Frame `number` with the tick `t` has been published, though this assembler does not know it: those that follow have higher
    /// numbers and later ticks.
    pub(crate) fn go_on_after(&mut self, number: u64, t: Timestamp) {
        self.frame.number = self.frame.number.max(number);
        self.last_closed = self.last_closed.max(Some(t));
        self.last_scheduled = self.last_scheduled.max(Some(t));
        self.pending.retain(|tick| tick.t > t);
    }

    /// The next frame that at the host time `now` is complete or has waited long enough; call until `None`.
    ///
    /// # Panics
    /// `frame_wait_ms` was negative or not finite.
    pub fn poll(&mut self, now: Timestamp) -> Option<&Frame> {
        self.schedule_model(now);
        let tick = *self.pending.front()?;
        if self.deadline(tick.t, now).is_some_and(|deadline| now < deadline) {
            return None;
        }
        self.pending.pop_front();
        self.close(tick, now);
        Some(&self.frame)
    }

    /// Host time at which [`Assembler::poll`] has something to do without further input, possibly `now` or before; `None` where
    /// only input can bring a frame.
    ///
    /// # Panics
    /// As [`Assembler::poll`].
    pub fn poll_timeout(&self, now: Timestamp) -> Option<Timestamp> {
        match self.pending.front() {
            Some(tick) => Some(self.deadline(tick.t, now).unwrap_or(now)),
            None => self.next_model_tick(now).map(|(_, due)| due),
        }
    }

    /// The stage clock's device: the fastest that is alive.
    fn choose_reference(&mut self, now: Timestamp) {
        let alive =
            |index: usize| self.devices[index].period_s().filter(|_| self.devices[index].is_alive(now));
        let mut best = self.reference.and_then(|index| alive(index).map(|period| (index, period * FASTER)));
        for index in 0..self.devices.len() {
            if let Some(period) = alive(index)
                && best.is_none_or(|(_, shortest)| period < shortest)
            {
                best = Some((index, period * FASTER));
            }
        }
        self.reference = best.map(|(index, _)| index).or(self.reference);
    }

    /// A tick at a cycle of the reference device, and those of the cycles lost before it. Where it has begun anew and its new period
    /// is not known yet, the old one has to do.
    fn schedule_cycle(&mut self, device: usize, t: Timestamp) {
        let Some(period_s) = self.devices[device].period_s() else { return };
        let mut left_out = 0;
        if let Some(last) = self.last_scheduled {
            let gap_s = t.seconds_since(last);
            if gap_s < 0.5 * period_s {
                return;
            }
            let missed = (gap_s / period_s).round() as u32 - 1;
            if gap_s <= COAST_S {
                let step = Duration::from_secs_f64(gap_s / f64::from(missed + 1));
                let lost = self.scheduled_by.filter(|before| *before == device);
                for i in 1..=missed {
                    self.schedule(Tick { t: last + step * i, device: lost, by_model: true, left_out: 0 });
                }
            } else {
                left_out = u64::from(missed);
            }
        }
        self.schedule(Tick { t, device: Some(device), by_model: false, left_out });
    }

    fn schedule(&mut self, tick: Tick) {
        self.last_scheduled = Some(tick.t);
        self.scheduled_by = tick.device;
        self.pending.push_back(tick);
    }

    /// Ticks that no cycle announces: the grid's, and those of a reference device that is late.
    fn schedule_model(&mut self, now: Timestamp) {
        while self.pending.is_empty()
            && let Some((tick, due)) = self.next_model_tick(now)
            && due <= now
        {
            self.left_out = 0;
            self.schedule(tick);
        }
    }

    /// The next such tick, and the host time at which it is due.
    fn next_model_tick(&self, now: Timestamp) -> Option<(Tick, Timestamp)> {
        if let Some(grid_s) = self.grid_s {
            return self.next_grid_tick(grid_s, now);
        }
        let device = &self.devices[self.reference?];
        let (last, latest, period_s) = (self.last_scheduled?, device.latest()?, device.period_s()?);
        // It has begun anew in another phase: its cycles follow ticks of the old one too closely to get ticks of their own.
        let has_shifted = (0.0..0.5 * period_s).contains(&latest.seconds_since(last));
        let t = if has_shifted { latest } else { last } + Duration::from_secs_f64(period_s);
        // After a longer silence ticks begin again with the next cycle: see `schedule_cycle`.
        let silent = latest.seconds_since(last) > COAST_S;
        let alive = !silent && t.seconds_since(latest) <= COAST_S && device.is_running();
        let due = t + Duration::from_secs_f64(device.lag_s() + self.wait_s);
        let device = self.reference.filter(|_| self.scheduled_by == self.reference);
        alive.then_some((Tick { t, device, by_model: true, left_out: 0 }, due))
    }

    /// Where the grid begins, at first and after a silence.
    fn anchor_grid(&mut self, t: Timestamp, grid_s: f64) {
        let floor = Timestamp::from_secs_f64((t.as_secs_f64() / grid_s).floor() * grid_s);
        match self.last_scheduled {
            None => self.last_scheduled = Some(floor),
            Some(last) if t.seconds_since(last) > COAST_S + grid_s => {
                self.left_out = (floor.seconds_since(last) / grid_s).round() as u64;
                self.last_scheduled = Some(floor);
            }
            Some(_) => {}
        }
    }

    fn next_grid_tick(&self, grid_s: f64, now: Timestamp) -> Option<(Tick, Timestamp)> {
        let latest =
            self.devices.iter().filter(|device| device.is_running()).filter_map(Device::latest).max()?;
        let n = (self.last_scheduled?.as_secs_f64() / grid_s).round() + 1.0;
        let t = Timestamp::from_secs_f64(n * grid_s);
        (t.seconds_since(latest) <= COAST_S).then_some(())?;
        // Due once the fastest device has gone past it, though never before it is: the times of packets that have waited rise a
        // little beyond their arrival. The deadline sees to those that have not gone past it.
        let due = if latest >= t { t } else { self.deadline(t, now).map_or(t, |deadline| deadline.max(t)) };
        Some((Tick { t, device: None, by_model: false, left_out: self.left_out }, due))
    }

    /// How long a tick waits for its sensors; `None` if all have said what they have to say.
    fn deadline(&self, t: Timestamp, now: Timestamp) -> Option<Timestamp> {
        let mut lag_s: Option<f64> = None;
        for sensor in &self.sensors {
            let device = &self.devices[sensor.device];
            if !self.is_settled(sensor, device, t, now) {
                lag_s = Some(lag_s.map_or(device.lag_s(), |lag| lag.max(device.lag_s())));
            }
        }
        lag_s.map(|lag_s| t + Duration::from_secs_f64(lag_s + self.wait_s))
    }

    fn is_settled(&self, sensor: &Sensor, device: &Device, t: Timestamp, now: Timestamp) -> bool {
        let (Some(latest), Some(period_s)) = (device.latest(), device.period_s()) else { return true };
        if !device.is_alive(now) || sensor.newest.is_some_and(|newest| newest >= t) || latest > t {
            return true;
        }
        let Some(newest) = sensor.newest else { return true };
        let unheard = latest.seconds_since(newest) > UNHEARD_CYCLES * period_s;
        let next_is_later = latest.seconds_since(t) + period_s > SLACK * period_s;
        unheard || (newest >= latest && next_is_later)
    }

    fn close(&mut self, tick: Tick, now: Timestamp) {
        let interval_s = self.last_closed.map_or(f64::INFINITY, |last| tick.t.seconds_since(last));
        // That of the device whose cycle it is, though another one be the reference by now.
        let clock = tick.device.or(self.reference);
        let clock_s = clock.and_then(|index| self.devices[index].period_s());
        let tick_s = self.grid_s.or(clock_s).unwrap_or(interval_s);
        let frame = &mut self.frame;
        frame.number += u64::from(self.last_closed.is_some());
        frame.t_valid = tick.t;
        frame.t_closed = now;
        frame.sigma_t_s = self.sigma_t_s;
        frame.ticks_left_out = tick.left_out;
        frame.by_model = tick.by_model;
        for (sensor, slot) in self.sensors.iter_mut().zip(&mut frame.sensors) {
            slot.samples.clear();
            let device = &self.devices[sensor.device];
            let longest_s = (WAITS_PERIODS * device.period_s().unwrap_or(0.0)).max(WAITS_S);
            while let Some(sample) = sensor.queue.front()
                && sample.measured.t_valid <= tick.t
            {
                let waited_s = tick.t.seconds_since(sample.measured.t_valid);
                let late = sample.late || waited_s > longest_s;
                slot.samples.push(FrameSample { late, ..*sample });
                sensor.queue.pop_front();
            }
            let is_clock = tick.device == Some(sensor.device);
            let period_s = device.period_s().filter(|period_s| *period_s <= SAME_RATE * tick_s);
            if let (true, Some(period_s)) = (slot.samples.is_empty(), period_s)
                && let Some(next) = sensor.queue.front()
                && next.measured.t_valid.seconds_since(tick.t) <= SLACK * period_s
            {
                slot.samples.push(*next);
                sensor.queue.pop_front();
            }
            slot.missed = sensor.missed(device, &slot.samples, tick.t, is_clock.then_some(interval_s));
            if is_clock && slot.expected() {
                // Others count the gap by cycles of their own.
                slot.missed = slot.missed.saturating_add(tick.left_out.try_into().unwrap_or(u32::MAX));
            }
        }
        self.last_closed = Some(tick.t);
    }
}

#[cfg(test)]
mod tests;
