//! The line between a device and the host: UART, USB adapter, and what damages the bytes on it.
//!
//! What comes in: bytes with the time at which each has arrived at the host's end of the wire. What goes
//! out: chunks at the times at which the host can read them, and the coming and going of the port.

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::Timestamp;

use crate::faults::{Damage, Fault, FaultHit, damage_schedule};
use crate::random::Random;
use crate::truth::Loss;

/// A byte on the wire.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WireByte {
    /// When its last bit is at the host's end, on the stage's clock.
    pub t: Timestamp,
    /// The byte as the device sent it.
    pub byte: u8,
    /// The record that it belongs to; absent for answers.
    pub record: Option<RecordByte>,
}

/// Where a byte stands in its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordByte {
    /// Measurement cycle, as in [`TruthCycle`](crate::truth::TruthCycle).
    pub cycle: u64,
    /// Address of the sensor; absent where the record holds those of all sensors of the device.
    pub address: Option<u16>,
    /// Place in the record, from 0.
    pub index: u16,
    /// Place in the frame, from 0.
    pub frame_index: u16,
    /// Bytes of the frame: the records of all birds in this cycle.
    pub frame_len: u16,
}

impl RecordByte {
    /// The record, as one that is lost.
    pub(crate) fn loss(&self) -> Loss {
        Loss { cycle: self.cycle, address: self.address }
    }
}

/// What the host sees of a line.
#[derive(Clone, Debug, PartialEq)]
pub enum LineOutput {
    /// Bytes that the host can read now.
    Data(Vec<u8>),
    /// The port is gone.
    Unplugged,
    /// The port is back.
    Replugged,
    /// A fault of the script hit something.
    Fault(FaultHit),
    /// A record did not reach the host, or not as it was sent.
    Lost(Loss),
}

/// Settings of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineConfig {
    /// Line rate of the device, bit/s.
    pub baud: u32,
    /// Bytes that the UART collects before the host gets them, at least 1; it delivers at once when the line falls idle.
    pub fifo_bytes: usize,
    /// Time between two deliveries of the adapter; zero: it delivers at once.
    pub burst: Duration,
}

/// What is left of bytes that were sent.
#[derive(Debug, Default)]
struct Pieces {
    bytes: Vec<WireByte>,
    /// Records that the script has damaged.
    damaged: Vec<Loss>,
}

#[derive(Debug)]
struct Chunk {
    deliver: Timestamp,
    pieces: Pieces,
}

/// The line of one device. Its damage is seeded.
///
/// Modelled: the UART's collecting, bursts of a USB adapter, damaged bytes, unplugging, and the garbage that a wrong line rate
/// makes. The script damages bytes of records alone, never answers, nor what the host sends.
#[derive(Debug)]
pub struct Line {
    config: LineConfig,
    faults: Vec<Fault>,
    random: Random,
    /// Bytes still to damage, next one first, with the name of the fault.
    damage: VecDeque<(Timestamp, Damage, &'static str)>,
    /// Damage whose time has come, and its place in the frame being sent: (frame index, what, name).
    aimed: Vec<(u16, Damage, &'static str)>,
    /// Bytes of the present frame that a phase cut still swallows.
    cut: u16,
    /// Phase cuts to come.
    phase_cuts: VecDeque<Timestamp>,
    /// Comings and goings of the port: time, whether it is there afterwards.
    plugging: VecDeque<(Timestamp, bool)>,
    plugged: bool,
    chunks: VecDeque<Chunk>,
    /// What the host believes the rate to be, where it is known.
    host_baud: Option<u32>,
    /// The last record that was reported to be lost, so that each is reported once.
    last_loss: Option<Loss>,
    output: VecDeque<(Timestamp, LineOutput)>,
}

impl Line {
    pub(crate) fn new(config: LineConfig, faults: Vec<Fault>, mut random: Random) -> Self {
        let damage = damage_schedule(&faults, &mut random).into();
        let mut plugging: Vec<(Timestamp, bool)> = Vec::new();
        let mut phase_cuts: Vec<Timestamp> = Vec::new();
        for fault in &faults {
            let (start_s, end_s) = fault.span_s();
            match fault {
                Fault::Unplug { .. } => {
                    plugging.push((Timestamp::from_secs_f64(start_s), false));
                    if end_s.is_finite() {
                        plugging.push((Timestamp::from_secs_f64(end_s), true));
                    }
                }
                Fault::PhaseCut { .. } => phase_cuts.push(Timestamp::from_secs_f64(start_s)),
                _ => {}
            }
        }
        plugging.sort();
        phase_cuts.sort();
        Self {
            config,
            faults,
            random,
            damage,
            aimed: Vec::new(),
            cut: 0,
            phase_cuts: phase_cuts.into(),
            plugging: plugging.into(),
            plugged: true,
            chunks: VecDeque::new(),
            host_baud: None,
            last_loss: None,
            output: VecDeque::new(),
        }
    }

    /// Whether the port is there.
    pub(crate) fn is_plugged(&self) -> bool {
        self.plugged
    }

    /// The rate that the host has set; bytes at another rate than the device's are garbage.
    pub(crate) fn set_host_baud(&mut self, baud: u32) {
        self.host_baud = Some(baud);
    }

    /// Whether the host can understand the device and be understood.
    pub(crate) fn rates_agree(&self) -> bool {
        // A UART forgives about two percent.
        self.host_baud.is_none_or(|host| host.abs_diff(self.config.baud) * 50 <= self.config.baud)
    }

    /// Takes bytes that the device sends in one go.
    pub(crate) fn send(&mut self, bytes: &[WireByte]) {
        let mut in_fifo = 0;
        let mut fifo = Pieces::default();
        for (i, wire) in bytes.iter().enumerate() {
            self.damage(wire, &mut fifo);
            in_fifo += 1;
            if i + 1 == bytes.len() || in_fifo == self.config.fifo_bytes {
                self.push_chunk(wire.t, std::mem::take(&mut fifo));
                in_fifo = 0;
            }
        }
    }

    /// The device was reset at `t`: what has not left it by then never will.
    pub(crate) fn cut_after(&mut self, t: Timestamp) {
        for chunk in &mut self.chunks {
            let Pieces { bytes, damaged } = &mut chunk.pieces;
            bytes.retain(|byte| {
                if byte.t > t {
                    damaged.extend(byte.record.map(|record| record.loss()));
                }
                byte.t <= t
            });
        }
    }

    /// Applies the script to one byte; what is left of it goes to `fifo`.
    fn damage(&mut self, wire: &WireByte, fifo: &mut Pieces) {
        let Some(record) = wire.record else {
            fifo.bytes.push(*wire);
            return;
        };
        if record.frame_index == 0 {
            self.aim(wire.t, &record);
        }
        let hit = |fault| {
            LineOutput::Fault(FaultHit {
                t: wire.t,
                fault,
                address: record.address,
                cycle: Some(record.cycle),
                byte: Some(record.index),
            })
        };
        if record.frame_index < self.cut {
            if record.frame_index == 0 {
                self.output.push_back((wire.t, hit("phase-cut")));
            }
            fifo.damaged.push(record.loss());
            return;
        }
        let mut byte = Some(wire.byte);
        while let Some(at) = self.aimed.iter().position(|&(index, ..)| index == record.frame_index) {
            let (_, damage, name) = self.aimed.swap_remove(at);
            match damage {
                Damage::Lose => byte = None,
                Damage::Insert => {
                    fifo.bytes.push(WireByte { byte: self.random.byte(), ..*wire });
                }
                Damage::FlipBit7 => byte = byte.map(|b| b ^ 0x80),
                Damage::FlipData => {
                    let bit = self.random.integer(0, 6);
                    byte = byte.map(|b| b ^ (1 << bit));
                }
            }
            self.output.push_back((wire.t, hit(name)));
            fifo.damaged.push(record.loss());
        }
        fifo.bytes.extend(byte.map(|byte| WireByte { byte, ..*wire }));
    }

    /// Picks the bytes of a frame that begins now which the script is to damage.
    ///
    /// One fault hits one byte; what is due beyond the frame's bytes waits for the next frame.
    fn aim(&mut self, t: Timestamp, record: &RecordByte) {
        self.aimed.clear();
        self.cut = 0;
        if self.phase_cuts.front().is_some_and(|&due| due <= t) {
            self.phase_cuts.pop_front();
            let longest = u64::from(record.frame_len.min(13)) - 1;
            self.cut = self.random.integer(1, longest.max(1)) as u16;
        }
        while let Some(&(due, damage, name)) = self.damage.front() {
            if due > t || self.aimed.len() >= usize::from(record.frame_len - self.cut) {
                break;
            }
            self.damage.pop_front();
            let index = loop {
                let index = self.random.integer(u64::from(self.cut), u64::from(record.frame_len) - 1) as u16;
                if !self.aimed.iter().any(|&(taken, ..)| taken == index) {
                    break index;
                }
            };
            self.aimed.push((index, damage, name));
        }
    }

    /// Puts bytes that the UART hands over at `t` in line for delivery.
    fn push_chunk(&mut self, t: Timestamp, pieces: Pieces) {
        let burst = self.burst_at(t).as_nanos() as i64;
        let deliver = if burst == 0 {
            t
        } else {
            Timestamp::from_nanos((t.as_nanos() + burst - 1).div_euclid(burst) * burst)
        };
        // Never before what was handed over earlier, also where bursts begin or end.
        let deliver = self.chunks.back().map_or(deliver, |last| deliver.max(last.deliver));
        match self.chunks.back_mut() {
            Some(last) if burst != 0 && last.deliver == deliver => {
                last.pieces.bytes.extend(pieces.bytes);
                last.pieces.damaged.extend(pieces.damaged);
            }
            _ => self.chunks.push_back(Chunk { deliver, pieces }),
        }
    }

    fn burst_at(&self, t: Timestamp) -> Duration {
        let scripted = self.faults.iter().find_map(|fault| match *fault {
            Fault::Bursts { burst_ms, .. } if fault.is_active(t) => Some(burst_ms),
            _ => None,
        });
        scripted.map_or(self.config.burst, |ms| Duration::from_secs_f64(ms.max(0.0) * 1e-3))
    }

    /// When something happens next.
    pub(crate) fn poll_timeout(&self) -> Option<Timestamp> {
        let chunk = self.chunks.front().map(|chunk| chunk.deliver);
        let plug = self.plugging.front().map(|&(t, _)| t);
        [chunk, plug].into_iter().flatten().min()
    }

    /// Does what is due at or before `now`.
    pub(crate) fn handle_timeout(&mut self, now: Timestamp) {
        while let Some(due) = self.poll_timeout().filter(|&due| due <= now) {
            if let Some(&(t, plugged)) = self.plugging.front()
                && t == due
            {
                self.plugging.pop_front();
                self.plugged = plugged;
                for chunk in std::mem::take(&mut self.chunks) {
                    self.lose(t, &chunk.pieces);
                }
                let change = if plugged { LineOutput::Replugged } else { LineOutput::Unplugged };
                self.output.push_back((t, change));
                if !plugged {
                    let hit = FaultHit { t, fault: "unplug", address: None, cycle: None, byte: None };
                    self.output.push_back((t, LineOutput::Fault(hit)));
                }
            } else if let Some(Chunk { pieces, .. }) = self.chunks.pop_front() {
                if !self.plugged {
                    self.lose(due, &pieces);
                    continue;
                }
                let mut bytes: Vec<u8> = pieces.bytes.iter().map(|byte| byte.byte).collect();
                if self.rates_agree() {
                    pieces.damaged.iter().for_each(|&loss| self.report(due, loss));
                } else {
                    self.lose(due, &pieces);
                    self.garble(&mut bytes);
                }
                if !bytes.is_empty() {
                    self.output.push_back((due, LineOutput::Data(bytes)));
                }
            }
        }
    }

    /// All records of these pieces are lost.
    fn lose(&mut self, t: Timestamp, pieces: &Pieces) {
        pieces.damaged.iter().for_each(|&loss| self.report(t, loss));
        pieces.bytes.iter().flat_map(|byte| &byte.record).for_each(|record| self.report(t, record.loss()));
    }

    /// Tells that a record is lost; its bytes come one after the other, perhaps in several pieces.
    fn report(&mut self, t: Timestamp, loss: Loss) {
        if self.last_loss.replace(loss) != Some(loss) {
            self.output.push_back((t, LineOutput::Lost(loss)));
        }
    }

    /// What a receiver at another rate makes of bytes: about as many as its bit time allows, of any value.
    fn garble(&mut self, bytes: &mut Vec<u8>) {
        let ratio = f64::from(self.host_baud.unwrap_or_default()) / f64::from(self.config.baud);
        let count = (bytes.len() as f64 * ratio.clamp(0.1, 8.0)).round() as usize;
        bytes.clear();
        bytes.extend((0..count).map(|_| self.random.byte()));
    }

    /// The next output and its time, until `None`.
    pub(crate) fn poll_output(&mut self) -> Option<(Timestamp, LineOutput)> {
        self.output.pop_front()
    }
}
