//! From readings to the [`Relation`]: believes what agrees, holds over gaps, finds jumps.
//!
//! A sound card counts samples by its own crystal, so that two lines are found: code against samples, which is exact but for noise, and
//! samples against the host's clock, of which only is known by when each was read ([`Envelope`]). MIDI has no samples: there the code
//! itself is the clock that is read late.

use posed_geometry::Timestamp;
use posed_state::Plain;

use crate::envelope::{CODE, Envelope, SOUND_CARD};
use crate::{Counting, Frame, Reading, Relation};

/// Readings in a row that agree before a code is believed that does not go on where the one before was.
const AGREEING: usize = 4;
/// Frames that may be missing between them.
const MISSED: u32 = 4;
/// How far the pace of frames may be off while they are distinguished, as a share: sound is exact, 24 and 25 differ by 4 %.
const PACE: f64 = 0.02;
const PACE_OF_MIDI: f64 = 0.2;
/// A reading further off the line of its samples is damaged or has jumped, s, and for each second since the one before.
const OFF_S: f64 = 1e-3;
const OFF_PER_S: f64 = 2e-4;
/// How much earlier and later than expected the same code may come, s: nothing is early, and reads may be late.
const EARLY_S: f64 = 3e-3;
const LATE_S: f64 = 0.05;
/// Time of a new clock that must have been read before it takes the place of a code that is held, s.
const SETTLES_S: f64 = 1.5;
/// Frames that the line of samples is made of: some fifteen seconds.
const POINTS: usize = 400;
/// How exactly a frame's place among samples is known at best, s.
const PLACE_S: f64 = 5e-6;
/// Longest time that a reading may have waited in its read, s, and the latest place in a stream.
const MOST_BEHIND_S: f64 = 60.0;
const MOST_POSITION_S: f64 = 1e9;

/// A reading that waits for others to agree.
#[derive(Clone, Copy, Debug, Plain)]
struct Waiting {
    frame: Frame,
    position_s: Option<f64>,
    read_by: Timestamp,
}

impl Waiting {
    /// Time from one to the other by the better clock, s.
    fn seconds_since(&self, earlier: &Self) -> f64 {
        match (self.position_s, earlier.position_s) {
            (Some(position_s), Some(before_s)) => position_s - before_s,
            _ => self.read_by.seconds_since(earlier.read_by),
        }
    }
}

/// The line of frames against samples.
#[derive(Clone, Debug, Default, Plain)]
struct Places {
    /// Number and place, s, of the latest frames, the oldest first.
    points: Vec<(f64, f64)>,
    line: Option<PlaceLine>,
}

/// A frame begins at `at_s` for `number`, and `period_s` later for each that follows.
#[derive(Clone, Copy, Debug, Plain)]
struct PlaceLine {
    number: f64,
    at_s: f64,
    period_s: f64,
    sigma_s: f64,
    period_sigma: f64,
}

impl PlaceLine {
    fn place_s(&self, number: f64) -> f64 {
        self.at_s + (number - self.number) * self.period_s
    }

    fn number(&self, place_s: f64) -> f64 {
        self.number + (place_s - self.at_s) / self.period_s
    }
}

impl Places {
    fn clear(&mut self) {
        self.points.clear();
        self.line = None;
    }

    fn push(&mut self, number: f64, place_s: f64) {
        if self.points.len() == POINTS {
            self.points.remove(0);
        }
        self.points.push((number, place_s));
        self.line = self.fit();
    }

    fn fit(&self) -> Option<PlaceLine> {
        let (number, place_s) = *self.points.last()?;
        let count = self.points.len() as f64;
        let each = || self.points.iter().map(|(n, s)| (n - number, s - place_s));
        let (n, s) = each().fold((0.0, 0.0), |sum, one| (sum.0 + one.0 / count, sum.1 + one.1 / count));
        let (nn, ns) = each().fold((0.0, 0.0), |sum, one| {
            (sum.0 + (one.0 - n) * (one.0 - n), sum.1 + (one.0 - n) * (one.1 - s))
        });
        if nn <= 0.0 || ns <= 0.0 {
            return None;
        }
        let period_s = ns / nn;
        let rest = |one: (f64, f64)| one.1 - s - period_s * (one.0 - n);
        let squares: f64 = each().map(|one| rest(one) * rest(one)).sum();
        let noise_s = libm::hypot(PLACE_S, libm::sqrt(squares / count));
        Some(PlaceLine {
            number,
            at_s: place_s + s - period_s * n,
            period_s,
            sigma_s: 2.0 * noise_s / libm::sqrt(count),
            period_sigma: noise_s / libm::sqrt(nn) / period_s,
        })
    }
}

/// Follows one source of time code. Causal; it allocates nothing per reading.
#[derive(Clone, Debug, Plain)]
pub struct Follower {
    delay_s: f64,
    pictures: u8,
    /// Begins with the first reading: times are seconds since then.
    origin: Option<Timestamp>,
    stream: u32,
    places: Places,
    envelope: Envelope,
    counting: Option<Counting>,
    /// Number of the latest frame that was believed.
    latest: f64,
    /// Readings that do not go on where the code was, and how they are counted.
    waiting: Vec<Waiting>,
    waiting_counting: Option<Counting>,
    /// The clock begins anew while the code is held.
    settles: bool,
    relation: Option<Relation>,
    jumps: u64,
}

impl Follower {
    /// Follows a source whose signal takes so long to the read that brings it, s, beyond what a read tells; a frame of the code
    /// stands for so many pictures.
    pub fn new(delay_s: f64, pictures: u8) -> Self {
        Self {
            delay_s,
            pictures: pictures.max(1),
            origin: None,
            stream: 0,
            places: Places { points: Vec::with_capacity(POINTS), line: None },
            envelope: Envelope::new(SOUND_CARD),
            counting: None,
            latest: 0.0,
            waiting: Vec::with_capacity(AGREEING),
            waiting_counting: None,
            settles: false,
            relation: None,
            jumps: 0,
        }
    }

    /// Where the code lies; `None` before enough of it was read. What it says of a moment grows less certain with time.
    pub fn relation(&self) -> Option<&Relation> {
        self.relation.as_ref()
    }

    /// How often the code has gone on somewhere else.
    pub fn jumps(&self) -> u64 {
        self.jumps
    }

    /// Takes the next reading, from a read at that host time. Whether the relation is another one now.
    pub fn push(&mut self, t_read: Timestamp, reading: &Reading) -> bool {
        let position_s = reading.position_s;
        let is_sound = (0.0..MOST_BEHIND_S).contains(&reading.behind_s)
            && position_s.is_none_or(|position_s| (0.0..MOST_POSITION_S).contains(&position_s));
        if !is_sound || reading.reversed {
            self.waiting.clear();
            return false;
        }
        let before_read = ((reading.behind_s + self.delay_s) * 1e9).round() as i64;
        let read_by = Timestamp::from_nanos(t_read.as_nanos().saturating_sub(before_read));
        let origin = *self.origin.get_or_insert(read_by);
        if reading.stream != self.stream {
            self.stream = reading.stream;
            self.places.clear();
            self.waiting.clear();
            self.begin_clock(position_s.is_some());
        }
        let waiting = Waiting { frame: reading.frame, position_s, read_by };
        if let Some(number) = self.goes_on(&waiting, reading.drop) {
            self.waiting.clear();
            self.take(number, &waiting, origin);
            return self.relate(origin);
        }
        if !self.agrees(&waiting, reading) {
            return false;
        }
        self.adopt(origin);
        self.relate(origin)
    }

    /// Begins the clock anew; the relation stays until it has settled.
    fn begin_clock(&mut self, has_samples: bool) {
        self.envelope.restart(if has_samples { SOUND_CARD } else { CODE });
        self.settles = self.relation.is_some();
    }

    /// The number of a frame next to where it is expected: names begin again every day.
    fn number_near(counting: Counting, frame: Frame, expected: f64) -> Option<f64> {
        let day = f64::from(counting.day());
        let number = f64::from(counting.number(frame)?);
        Some(number + day * ((expected - number) / day).round())
    }

    /// The number of a frame that comes where it should, within the same code; `None` for all others.
    fn goes_on(&self, waiting: &Waiting, drop: bool) -> Option<f64> {
        let counting = self.counting.filter(|counting| counting.drop == drop)?;
        if let Some(position_s) = waiting.position_s {
            let line = self.places.line?;
            let number = Self::number_near(counting, waiting.frame, line.number(position_s))?;
            let since_s = position_s - line.at_s;
            let off_s = position_s - line.place_s(number);
            return (since_s > 0.0 && off_s.abs() < OFF_S + OFF_PER_S * since_s).then_some(number);
        }
        let relation = self.relation.filter(|_| self.envelope.line().is_some())?;
        let number = Self::number_near(counting, waiting.frame, relation.number_at(waiting.read_by))?;
        (self.is_same(&relation, number, waiting) && number > relation.number).then_some(number)
    }

    /// Whether a frame comes when the relation expects it.
    fn is_same(&self, relation: &Relation, number: f64, waiting: &Waiting) -> bool {
        let late_s = waiting.read_by.seconds_since(relation.at) - relation.since_at_s(number);
        let unsure_s = 3.0 * relation.sigma_s(waiting.read_by);
        (-EARLY_S - unsure_s..LATE_S + unsure_s).contains(&late_s)
    }

    /// Whether so many readings agree with one another, this the last of them, that they are believed.
    fn agrees(&mut self, waiting: &Waiting, reading: &Reading) -> bool {
        let follows = self.waiting.last().and_then(|before| {
            let known = self.waiting_counting.filter(|_| self.waiting.len() > 1);
            let stated = |counted: &u8| reading.frames_per_s.is_none_or(|stated| stated == *counted);
            let mut countings = [24, 25, 30]
                .into_iter()
                .filter(stated)
                .map(|frames_per_s| Counting { frames_per_s, drop: reading.drop })
                .filter(|counting| known.is_none_or(|known| known == *counting));
            countings.find(|counting| {
                let numbers = counting.number(before.frame).zip(counting.number(waiting.frame));
                let Some((from, to)) = numbers else { return false };
                let steps = (to + counting.day() - from) % counting.day();
                let frames = waiting.seconds_since(before) * f64::from(counting.frames_per_s);
                let pace = if waiting.position_s.is_some() { PACE } else { PACE_OF_MIDI };
                (1..=MISSED).contains(&steps) && (frames / f64::from(steps) - 1.0).abs() < pace
            })
        });
        if follows.is_none() {
            self.waiting.clear();
        }
        self.waiting_counting = follows;
        self.waiting.push(*waiting);
        self.waiting.len() == AGREEING
    }

    /// Believes the readings that wait: the code goes on where they are.
    fn adopt(&mut self, origin: Timestamp) {
        let Some(counting) = self.waiting_counting else { return };
        let has_samples = self.waiting.iter().all(|waiting| waiting.position_s.is_some());
        let number = |waiting: &Waiting, expected: f64| Self::number_near(counting, waiting.frame, expected);
        // The same code as before, if it comes when it should: then it is samples that are missing, and their count is another.
        let same = self.relation.filter(|relation| relation.counting == counting).filter(|relation| {
            self.waiting.iter().any(|waiting| {
                let number = number(waiting, relation.number_at(waiting.read_by));
                number.is_some_and(|number| self.is_same(relation, number, waiting))
            })
        });
        self.counting = Some(counting);
        self.places.clear();
        match same {
            Some(_) => self.begin_clock(has_samples),
            None => {
                self.jumps += u64::from(self.relation.take().is_some());
                self.settles = false;
                if !has_samples || self.envelope.line().is_none() {
                    self.begin_clock(has_samples);
                }
            }
        }
        let mut expected = same.map(|relation| relation.number_at(self.waiting[0].read_by));
        for at in 0..self.waiting.len() {
            let waiting = self.waiting[at];
            let Some(number) = number(&waiting, expected.unwrap_or(0.0)) else { continue };
            expected = Some(number);
            self.take(number, &waiting, origin);
        }
        self.waiting.clear();
    }

    fn take(&mut self, number: f64, waiting: &Waiting, origin: Timestamp) {
        let read_by_s = waiting.read_by.seconds_since(origin);
        self.latest = number;
        match (waiting.position_s, self.counting) {
            (Some(position_s), _) => {
                self.places.push(number, position_s);
                self.envelope.push(position_s, read_by_s);
            }
            (None, Some(counting)) => {
                self.envelope.push(number / f64::from(counting.frames_per_s), read_by_s)
            }
            (None, None) => {}
        }
    }

    /// Draws the relation anew.
    fn relate(&mut self, origin: Timestamp) -> bool {
        let Some((counting, line)) = self.counting.zip(self.envelope.line()) else { return false };
        if self.settles && self.envelope.span_s() < SETTLES_S {
            return false;
        }
        self.settles = false;
        let (number, clock_s, period_s, sigma_s, period_sigma) = match self.places.line {
            Some(PlaceLine { number, at_s, period_s, sigma_s, period_sigma }) => {
                (number, at_s, period_s, sigma_s, period_sigma)
            }
            None => {
                let period_s = 1.0 / f64::from(counting.frames_per_s);
                (self.latest, self.latest * period_s, period_s, 0.0, 0.0)
            }
        };
        let host_ns = (line.host_s(clock_s) * 1e9).round() as i64;
        self.relation = Some(Relation {
            at: Timestamp::from_nanos(origin.as_nanos().saturating_add(host_ns)),
            number,
            frames_per_s: 1.0 / (period_s * (1.0 + line.drift)),
            pace_sigma: libm::hypot(line.drift_sigma, period_sigma),
            counting,
            pictures: self.pictures,
            sigma_s: libm::hypot(line.sigma_s, sigma_s),
        });
        true
    }
}
