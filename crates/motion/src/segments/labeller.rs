//! Labels on a stream: positions of joints in, the name of every tick out.
//!
//! What comes in: positions of the model's joints with their times, at any rate. What goes out: per tick of the
//! model's clock a provisional class as soon as the network has seen enough, and its final one after minimum durations.
//! What it never does: allocate per frame once warm, give a tick two final classes, or bridge a gap or a jump: there the
//! stream ends and a new one begins.

use posed_state::State;

use super::durations::Decoder;
use super::input::{Memory, Position};
use super::loss::{best, softmax};
use super::model::Model;
use super::sequence::{GAP_S, Sequence, between};
use super::stream::Stream;

/// Nobody moves so fast as a whole, m/s: joints that do were put elsewhere, as a body is whose place is known from then on.
const FASTEST_M_S: f64 = 15.0;

/// Whether the joints as a whole have moved in `dt_s` as nothing moves.
fn is_elsewhere(before: &[Position], now: &[Position], dt_s: f64) -> bool {
    let (mut moved_m, mut joints) = ([0.0; 3], 0.0);
    for (before, now) in before.iter().zip(now).filter_map(|(before, now)| before.zip(*now)) {
        (0..3).for_each(|axis| moved_m[axis] += now[axis] - before[axis]);
        joints += 1.0;
    }
    let way_m = libm::sqrt(moved_m.iter().map(|way_m| way_m * way_m).sum());
    way_m > FASTEST_M_S * dt_s * joints
}

/// The class of one tick of the model's rate. Every tick comes provisional first and final later.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tick {
    /// Its time in the stream, s.
    pub t_s: f64,
    /// Index of the class among the model's labels.
    pub class: u16,
    /// The network's probability of this class at this tick, 0 to 1, before minimum durations.
    pub confidence: f64,
    /// Whether it may still change; a final one never does.
    pub provisional: bool,
}

/// Names what a stream of joint positions shows, tick by tick, with minimum durations.
///
/// No allocation once warm. Method: `docs/methods/segments.md`, after Cheema et al. 2019; accuracy and delay:
/// `docs/segments.md`.
#[derive(Clone, Debug, State)]
pub struct Labeller {
    memory: Memory,
    stream: Stream,
    decoder: Decoder,
    /// A decoder and rings before their first frame, for a new beginning.
    #[state(keep)]
    fresh: Box<(Stream, Decoder)>,
    /// Last frame.
    last_s: Option<f64>,
    last: Vec<Position>,
    tick: Vec<Position>,
    /// Time of the first tick, and number of the next ones: to sample, to score.
    start_s: f64,
    sampled: u64,
    scored: u64,
    /// Probabilities of the ticks that are not decided, a slot each.
    probabilities: Vec<f32>,
    buffer: Vec<f32>,
    slots: u64,
}

impl Labeller {
    /// A labeller for a stream of this model's joints. Give the same model to every call.
    pub fn new(model: &Model) -> Self {
        let card = &model.card;
        let ticks = |seconds: f64| (seconds * card.preparation.rate_hz).round() as usize;
        let minimum: Vec<usize> = card.decision.minimum_s.iter().map(|seconds| ticks(*seconds)).collect();
        let bound = ticks(card.decision.wait_s);
        let decoder = Decoder::new(&minimum, card.decision.switch, bound);
        let stream = Stream::new(&model.network);
        let slots = bound as u64 + 2;
        Self {
            memory: Memory::default(),
            fresh: Box::new((stream.clone(), decoder.clone())),
            stream,
            decoder,
            last_s: None,
            last: Vec::new(),
            tick: Vec::new(),
            start_s: 0.0,
            sampled: 0,
            scored: 0,
            probabilities: vec![0.0; slots as usize * card.labels.len()],
            buffer: Vec::with_capacity(card.labels.len()),
            slots,
        }
    }

    /// How long after its time a tick is final at the latest, s: delay of the network and wait of the decision.
    pub fn delay_s(model: &Model) -> f64 {
        let card = &model.card;
        card.shape.delay() as f64 / card.preparation.rate_hz + card.decision.wait_s
    }

    /// Takes the positions of the model's joints at `t_s` (s), z up, m; `emit` gets ticks. A frame that is not after
    /// the last one, or whose time is not finite, is left out; positions are interpolated to ticks, and a longer gap
    /// ends the stream, and so does a jump of all joints at more than 15 m/s.
    ///
    /// # Panics
    /// The positions are not as many as the model's joints.
    pub fn push(&mut self, model: &Model, t_s: f64, positions: &[Position], emit: &mut dyn FnMut(Tick)) {
        let preparation = &model.card.preparation;
        assert_eq!(positions.len(), preparation.joints.len(), "joints");
        if !t_s.is_finite() {
            return;
        }
        match self.last_s {
            Some(last_s) if t_s <= last_s => return,
            Some(last_s)
                if t_s - last_s <= GAP_S.max(1.5 / preparation.rate_hz)
                    && !is_elsewhere(&self.last, positions, t_s - last_s) => {}
            _ => {
                self.finish(model, emit);
                self.start_s = t_s;
                self.last_s = Some(t_s);
                self.last.clear();
                self.last.extend_from_slice(positions);
            }
        }
        let last_s = self.last_s.unwrap_or(t_s);
        loop {
            let tick_s = self.start_s + self.sampled as f64 / preparation.rate_hz;
            // Frames and ticks of one rate differ by rounding only.
            if tick_s > t_s + 1e-9 {
                break;
            }
            self.tick.clear();
            between(tick_s, (last_s, &self.last), (t_s, positions), &mut self.tick);
            self.sampled += 1;
            let features = preparation.push(&self.tick, &mut self.memory);
            if let Some(scores) = self.stream.push(&model.network, features) {
                self.buffer.clear();
                self.buffer.extend_from_slice(scores);
                self.score(model, emit);
            }
        }
        self.last_s = Some(t_s);
        self.last.clear();
        self.last.extend_from_slice(positions);
    }

    /// Ends the stream: `emit` gets all ticks that are left, final, and the next frame begins a new stream.
    pub fn finish(&mut self, model: &Model, emit: &mut dyn FnMut(Tick)) {
        if self.last_s.take().is_none() {
            return;
        }
        let mut stream = std::mem::take(&mut self.stream);
        stream.finish(&model.network, &mut |scores| {
            self.buffer.clear();
            self.buffer.extend_from_slice(scores);
            self.score(model, emit);
        });
        let Self { decoder, probabilities, slots, start_s, .. } = self;
        let rate_hz = model.card.preparation.rate_hz;
        decoder.finish(&mut |tick, class| {
            emit(decision(tick, class, *start_s, rate_hz, probabilities, *slots, model.card.labels.len()));
        });
        let (stream, decoder) = (*self.fresh).clone();
        (self.stream, self.decoder) = (stream, decoder);
        self.memory = Memory::default();
        (self.sampled, self.scored) = (0, 0);
    }

    /// Takes the scores in `buffer` for the next tick.
    fn score(&mut self, model: &Model, emit: &mut dyn FnMut(Tick)) {
        let classes = model.card.labels.len();
        let rate_hz = model.card.preparation.rate_hz;
        softmax(&mut self.buffer);
        // Scores that no number holds, of weights or positions without sense, say nothing of any class.
        if !self.buffer.iter().all(|probability| probability.is_finite()) {
            self.buffer.fill(1.0 / classes as f32);
        }
        let slot = (self.scored % self.slots) as usize * classes;
        self.probabilities[slot..slot + classes].copy_from_slice(&self.buffer);
        let Self { decoder, buffer, probabilities, slots, start_s, .. } = self;
        decoder.push(buffer, &mut |tick, class| {
            emit(decision(tick, class, *start_s, rate_hz, probabilities, *slots, classes));
        });
        // Provisional is what the best path reports about its end: one odd frame changes nothing.
        let class = self.decoder.best().unwrap_or_else(|| best(&self.buffer));
        emit(Tick {
            t_s: self.start_s + self.scored as f64 / rate_hz,
            class: class as u16,
            confidence: f64::from(self.buffer[class]),
            provisional: true,
        });
        self.scored += 1;
    }
}

fn decision(
    tick: u64,
    class: usize,
    start_s: f64,
    rate_hz: f64,
    probabilities: &[f32],
    slots: u64,
    classes: usize,
) -> Tick {
    Tick {
        t_s: start_s + tick as f64 / rate_hz,
        class: class as u16,
        confidence: f64::from(probabilities[(tick % slots) as usize * classes + class]),
        provisional: false,
    }
}

/// Names every frame of a sequence: index of its class and confidence (0 to 1), by the same code as live. The nearest
/// tick in time counts; class 0 with confidence 0 where there is no tick at all.
///
/// # Panics
/// The sequence has another number of joints than the model.
pub fn label(model: &Model, sequence: &Sequence) -> Vec<(u16, f64)> {
    let mut labeller = Labeller::new(model);
    let mut ticks: Vec<Tick> = Vec::new();
    let mut emit = |tick: Tick| {
        if !tick.provisional {
            ticks.push(tick);
        }
    };
    for (frame, t_s) in sequence.t_s.iter().enumerate() {
        labeller.push(model, *t_s, sequence.positions(frame), &mut emit);
    }
    labeller.finish(model, &mut emit);
    let mut next = 0;
    let mut frames = Vec::with_capacity(sequence.frames());
    for t_s in &sequence.t_s {
        while next + 1 < ticks.len() && (ticks[next + 1].t_s - t_s).abs() <= (ticks[next].t_s - t_s).abs() {
            next += 1;
        }
        frames.push(ticks.get(next).map_or((0, 0.0), |tick| (tick.class, tick.confidence)));
    }
    frames
}
