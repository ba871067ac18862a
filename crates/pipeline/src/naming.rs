//! Segments live: positions of the stage's sensors in, beginnings of segments out.
//!
//! What comes in: the frames' estimates. What goes out: a segment as soon as it seems to begin (`provisional`), and later
//! that it did (`confirmed`) or did not (`withdrawn`). What it never does: take back what it confirmed, or begin before all that it
//! looks at is there.

use posed_state::{Plain, State};
use std::collections::VecDeque;

use posed_drivers::Timestamp;

use posed_fusion::body::BodySegment;
use posed_motion::segments::{Labeller, Model, Position, Tick};
use posed_stage::BodyIndex;
use posed_stage::input::SensorIndex;
use posed_stage::output::{self, Body, Estimate, Outcome, OutcomeKind, Output, SegmentEvent};

/// Segments that may wait for their confirmation; more are withdrawn, the oldest first.
const OPEN: usize = 64;
/// A provisional segment is given up so long after the last time at which it could have been confirmed, s.
const GRACE_S: f64 = 0.5;

/// It begins after so long, s, though a joint is not there: a sensor that is broken is no reason to say nothing.
const LATEST_START_S: f64 = 3.0;

/// A model at work on a stage's sensors, or on those of one body.
#[derive(Clone, Debug, State)]
pub(super) struct Naming {
    /// Whose motion it names; `None` on a stage without bodies.
    #[state(keep)]
    body: Option<BodyIndex>,
    #[state(keep)]
    model: Model,
    labeller: Labeller,
    /// What stands for each of the model's joints.
    #[state(keep)]
    joints: Vec<Joint>,
    positions: Vec<Position>,
    /// When the first frame came, and whether it has begun since.
    first: Option<Timestamp>,
    begun: bool,
    /// Said as provisional, neither confirmed nor withdrawn.
    open: VecDeque<Open>,
    /// Numbers given to segments so far.
    segments: u64,
    /// Class and time of the last tick: provisional, confirmed.
    last: [Option<(u16, f64)>; 2],
}

/// What stands for a joint of the model: the origin of a segment of the body, or a sensor where the body has no such place.
#[derive(Clone, Copy, Debug, Plain)]
struct Joint {
    sensor: Option<SensorIndex>,
    segment: Option<usize>,
}

/// A provisional segment.
#[derive(Clone, Copy, Debug, Plain)]
struct Open {
    segment: u64,
    class: u16,
    start_s: f64,
}

impl Naming {
    /// A model at work on sensors of these names, those that somebody else wears being left out, and on the segments that messages have of its human body: none where there is none.
    ///
    /// # Errors
    /// One sentence: most of its joints are no sensors here.
    pub(super) fn new<'a>(
        model: Model,
        names: impl Iterator<Item = Option<&'a str>> + Clone,
        body: Option<BodyIndex>,
        segments: &[BodySegment],
    ) -> Result<Self, String> {
        let of_body = segments.iter().map(|segment| segment.name());
        let _ = model.columns(names.clone().flatten().chain(of_body))?;
        let joint = |name: &String| Joint {
            sensor: names.clone().position(|known| known == Some(name)).map(|index| index as SensorIndex),
            segment: segments.iter().position(|segment| segment.name() == name),
        };
        let joints: Vec<Joint> = model.card.preparation.joints.iter().map(joint).collect();
        Ok(Self {
            labeller: Labeller::new(&model),
            positions: vec![None; joints.len()],
            joints,
            first: None,
            begun: false,
            body,
            model,
            open: VecDeque::with_capacity(OPEN),
            segments: 0,
            last: [None; 2],
        })
    }

    /// Takes the place of another model, whose open segments nobody will decide on.
    pub(super) fn follow(&mut self, before: &mut Self, t: Timestamp, emit: &mut dyn FnMut(Output<'_>)) {
        let Self { body, model, open, segments, last, .. } = before;
        self.segments = *segments;
        let gone = std::mem::take(open);
        let mut events = Events { body: *body, model, open, segments, last, t_decided: t, emit };
        gone.into_iter().for_each(|open| events.withdraw(open));
    }

    /// Whose motion it names; `None` on a stage without bodies.
    pub(super) fn body(&self) -> Option<BodyIndex> {
        self.body
    }

    /// Takes the next frame.
    pub(super) fn push(
        &mut self,
        estimate: &Estimate,
        body: Option<&Body>,
        emit: &mut dyn FnMut(Output<'_>),
    ) {
        for (position, joint) in self.positions.iter_mut().zip(&self.joints) {
            let sensor = joint.sensor.and_then(|sensor| estimate.sensors.get(usize::from(sensor)));
            let pose = sensor.and_then(|sensor| sensor.usable_pose());
            let segment = joint.segment.and_then(|segment| body?.segments[segment].position_m);
            *position = segment.or_else(|| pose?.position_m);
        }
        let first = *self.first.get_or_insert(estimate.t_valid);
        let waits = self.positions.iter().any(Option::is_none)
            && estimate.t_valid.seconds_since(first) < LATEST_START_S;
        self.begun |= !waits;
        let Self { body, model, labeller, positions, open, segments, last, .. } = self;
        let mut events =
            Events { body: *body, model, open, segments, last, t_decided: estimate.t_valid, emit };
        if self.begun {
            labeller.push(model, estimate.t_valid.as_secs_f64(), positions, &mut |tick| events.take(tick));
        }
    }
}

/// From ticks to events, during one frame.
struct Events<'a> {
    body: Option<BodyIndex>,
    model: &'a Model,
    open: &'a mut VecDeque<Open>,
    segments: &'a mut u64,
    last: &'a mut [Option<(u16, f64)>; 2],
    t_decided: Timestamp,
    emit: &'a mut dyn FnMut(Output<'_>),
}

impl Events<'_> {
    fn take(&mut self, tick: Tick) {
        let which = usize::from(!tick.provisional);
        // After a gap everything begins anew.
        let gap = 1.5 / self.model.card.preparation.rate_hz;
        let goes_on =
            self.last[which].is_some_and(|(class, t_s)| class == tick.class && tick.t_s - t_s < gap);
        self.last[which] = Some((tick.class, tick.t_s));
        match (tick.provisional, goes_on) {
            (true, true) => {}
            (true, false) => {
                if self.open.len() == OPEN
                    && let Some(oldest) = self.open.pop_front()
                {
                    self.withdraw(oldest);
                }
                let segment = self.number();
                self.open.push_back(Open { segment, class: tick.class, start_s: tick.t_s });
                self.event(SegmentEvent::Provisional, segment, tick.class, tick.t_s, tick.confidence);
            }
            (false, false) => {
                // Borders move a little until they are final: the class and the order tell which one it is.
                let near = self.model.card.decision.wait_s + GRACE_S;
                let same = |open: &Open| open.class == tick.class && (open.start_s - tick.t_s).abs() <= near;
                let segment = match self.open.iter().position(same) {
                    Some(at) => {
                        for _ in 0..at {
                            if let Some(open) = self.open.pop_front() {
                                self.withdraw(open);
                            }
                        }
                        self.open.pop_front().map(|open| open.segment)
                    }
                    None => None,
                };
                let segment = segment.unwrap_or_else(|| self.number());
                self.event(SegmentEvent::Confirmed, segment, tick.class, tick.t_s, tick.confidence);
            }
            (false, true) => {
                let near = self.model.card.decision.wait_s + GRACE_S;
                while let Some(open) =
                    self.open.front().copied().filter(|open| open.start_s + near < tick.t_s)
                {
                    self.open.pop_front();
                    self.withdraw(open);
                }
            }
        }
    }

    fn number(&mut self) -> u64 {
        *self.segments += 1;
        *self.segments
    }

    fn withdraw(&mut self, open: Open) {
        self.event(SegmentEvent::Withdrawn, open.segment, open.class, open.start_s, 0.0);
    }

    fn event(&mut self, event: SegmentEvent, segment: u64, class: u16, start_s: f64, confidence: f64) {
        let label = self.model.card.labels[usize::from(class)].clone();
        let delay_s = Labeller::delay_s(self.model);
        let what = OutcomeKind::MotionSegment(output::MotionSegment {
            event,
            body: self.body,
            segment,
            label,
            confidence,
            delay_s,
        });
        let t_valid = Timestamp::from_secs_f64(start_s);
        (self.emit)(Output::Outcome(&Outcome { t_valid, t_decided: self.t_decided, what }));
    }
}
