//! The host of a stage in simulated time: it reads virtual devices, sometimes late, and tells what the pipeline is given.

use std::collections::VecDeque;

use posed_drivers::{LineEvent, Timestamp};
use posed_simulator::stage::{Output, VirtualStage};
use posed_simulator::truth::{Loss, TruthCycle};
use posed_stage::input::Input;

/// So often the same moment may come in turn; more, and somebody asks for it without end.
const STANDS_STILL: u32 = 200;

/// A host that is now and then late with a read, and then reads all that has come meanwhile.
pub struct Sleepy {
    random: u64,
    /// Share of reads that it is late with.
    share: f64,
    longest_s: f64,
    /// It does not sleep before.
    from: Timestamp,
    until: Timestamp,
    /// Bytes that can be read, by device.
    waiting: Vec<(u16, Vec<u8>)>,
}

impl Sleepy {
    /// A host that from `from_s` on is late with a share of its reads, by up to `longest_ms`.
    pub fn new(seed: u64, share: f64, longest_ms: f64, from_s: f64) -> Self {
        Self {
            random: seed,
            share,
            longest_s: longest_ms * 1e-3,
            from: Timestamp::from_secs_f64(from_s),
            until: Timestamp::ZERO,
            waiting: Vec::new(),
        }
    }

    /// Uniform in [0, 1): splitmix64.
    fn uniform(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Bytes that can be read: given back unless it sleeps.
    fn read(&mut self, now: Timestamp, device: u16, bytes: Vec<u8>) -> Option<Vec<u8>> {
        if now > self.from && now >= self.until && self.uniform() < self.share {
            let sleep_s = self.uniform() * self.longest_s;
            self.until = Timestamp::from_secs_f64(now.as_secs_f64() + sleep_s);
        }
        if now >= self.until {
            return Some(bytes);
        }
        match self.waiting.iter_mut().find(|(waiting, _)| *waiting == device) {
            Some((_, held)) => held.extend(bytes),
            None => self.waiting.push((device, bytes)),
        }
        None
    }

    fn wakes(&self) -> Option<Timestamp> {
        (!self.waiting.is_empty()).then_some(self.until)
    }
}

/// Virtual devices, and who reads them.
pub struct Host {
    /// The devices.
    pub devices: VirtualStage,
    /// Time of the last input.
    pub now: Timestamp,
    /// Is late with its reads, or `None`.
    pub sleepy: Option<Sleepy>,
    /// True poses, of all cycles.
    pub truth: Vec<TruthCycle>,
    /// Records that did not reach the host, by device and time.
    pub losses: Vec<(usize, Timestamp, Loss)>,
    modem_lines: Vec<bool>,
    /// What a host that has woken up reads.
    woken: VecDeque<(u16, Vec<u8>)>,
    /// Whether the devices know that it is `now`, and the pipeline.
    stepped: bool,
    timed: bool,
    /// How often it has been `now`.
    still: u32,
}

impl Host {
    /// A host at time zero, and by device whether its system knows when bytes came.
    pub fn new(devices: VirtualStage, modem_lines: Vec<bool>) -> Self {
        Self {
            devices,
            now: Timestamp::ZERO,
            sleepy: None,
            truth: Vec::new(),
            losses: Vec::new(),
            modem_lines,
            woken: VecDeque::new(),
            stepped: true,
            timed: true,
            still: 0,
        }
    }

    /// All lines open.
    pub fn opened(&self) -> Vec<Input> {
        (0..self.modem_lines.len()).map(|device| self.opens(device as u16)).collect()
    }

    fn opens(&self, device: u16) -> Input {
        let modem_lines = self.modem_lines[usize::from(device)];
        Input::Line { device, event: LineEvent::Opened { modem_lines } }
    }

    /// What the pipeline, whose next timer is `due`, is given next, at [`Host::now`]; `None` when it is `end`.
    ///
    /// # Panics
    /// When time stands still.
    pub fn next(&mut self, due: Option<Timestamp>, end: Timestamp) -> Option<Input> {
        loop {
            if let Some((device, bytes)) = self.woken.pop_front() {
                return Some(Input::Bytes { device, bytes });
            }
            if !std::mem::replace(&mut self.stepped, true) {
                self.devices.step(self.now);
            }
            if let Some(input) = self.event() {
                return Some(input);
            }
            let is_due = due.is_some_and(|due| due <= self.now);
            if !std::mem::replace(&mut self.timed, true) && is_due {
                return Some(Input::Timer);
            }
            if self.now >= end {
                return None;
            }
            let wakes = self.sleepy.as_ref().and_then(Sleepy::wakes);
            let all = [self.devices.poll_timeout(), due, wakes];
            let next = all.into_iter().flatten().min().unwrap_or(end).clamp(self.now, end);
            self.still = if next == self.now { self.still + 1 } else { 0 };
            assert!(self.still < STANDS_STILL, "time stands still at {:.6} s", next.as_secs_f64());
            self.now = next;
            (self.stepped, self.timed) = (false, false);
            if let Some(sleepy) = self.sleepy.as_mut().filter(|sleepy| sleepy.until <= next) {
                self.woken.extend(sleepy.waiting.drain(..));
            }
        }
    }

    /// Nobody sleeps any more: what waits is read.
    pub fn wake_for_good(&mut self) {
        self.woken.extend(self.sleepy.take().into_iter().flat_map(|sleepy| sleepy.waiting));
    }

    /// Of what the devices have done, the next that reaches the pipeline.
    fn event(&mut self) -> Option<Input> {
        while let Some(event) = self.devices.poll_event() {
            let device = event.device as u16;
            match event.output {
                Output::Data(bytes) => {
                    let bytes = match &mut self.sleepy {
                        Some(sleepy) => sleepy.read(self.now, device, bytes),
                        None => Some(bytes),
                    };
                    if let Some(bytes) = bytes {
                        return Some(Input::Bytes { device, bytes });
                    }
                }
                Output::Unplugged => {
                    let event = LineEvent::Closed { reason: "unplugged".into() };
                    return Some(Input::Line { device, event });
                }
                Output::Replugged => return Some(self.opens(device)),
                Output::Truth(cycle) => self.truth.push(cycle),
                Output::Lost(loss) => self.losses.push((event.device, event.t, loss)),
                Output::Fault(_) => {}
            }
        }
        None
    }
}
