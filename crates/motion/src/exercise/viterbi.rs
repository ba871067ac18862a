//! Short-time Viterbi: the best state path of a hidden Markov model while the observations still come in.
//!
//! What comes in: per frame the log density of each state. What goes out: the states of the path, each as soon as it
//! cannot change any more. What it never does: emit a state that the full Viterbi path would not have (without a
//! bound), or two states that no transition joins (with one).
//!
//! All surviving paths share a common stem; whatever comes later, the best path runs through it (Bloit & Rodet 2008;
//! Sramek, Brejova, Vinar 2007). The survivors are kept as the lattice of back pointers itself: per frame a set of
//! the states that still have a living descendant, and per state the number of its children. A state that loses
//! its last child dies and takes its childless ancestors with it. A frame with one living state is fused.

use posed_state::Plain;

/// No path leads here.
const DEAD: f64 = f64::NEG_INFINITY;

/// Which state of a hidden Markov model may follow which, with the natural logarithms of the probabilities.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Topology {
    /// Log probability of each state at the first frame; minus infinity where it cannot begin.
    initial: Vec<f64>,
    /// Predecessors of state `j` are `from[ends[j - 1]..ends[j]]`, in rising order.
    ends: Vec<u32>,
    from: Vec<u16>,
    log_probability: Vec<f64>,
}

impl Topology {
    /// Topology from the log probabilities of the first state and `(from, to, log probability)` of each transition.
    /// Transitions of probability zero (minus infinity) are left out.
    ///
    /// # Panics
    /// There are no states or more than 65535, or a transition names a state that is not there.
    pub fn new(initial: Vec<f64>, transitions: &[(usize, usize, f64)]) -> Self {
        let states = initial.len();
        assert!(states > 0 && states <= usize::from(u16::MAX), "1 to 65535 states");
        let mut transitions: Vec<_> = transitions.iter().filter(|transition| transition.2 > DEAD).collect();
        transitions.sort_by_key(|(from, to, _)| (*to, *from));
        let mut topology =
            Self { initial, ends: vec![0; states], from: Vec::new(), log_probability: Vec::new() };
        for (from, to, log_probability) in transitions {
            assert!(*from < states && *to < states, "a transition between states that are there");
            topology.from.push(*from as u16);
            topology.log_probability.push(*log_probability);
            topology.ends[*to] += 1;
        }
        let mut end = 0;
        for count in &mut topology.ends {
            end += *count;
            *count = end;
        }
        topology
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.initial.len()
    }
}

/// Short-time Viterbi decoder (Bloit & Rodet 2008): emits the states of the best path as soon as all paths agree on
/// them.
///
/// With no bound the path is that of the full Viterbi algorithm. Memory grows with the frames on which paths disagree.
#[derive(Clone, Debug, Plain)]
pub struct ShortTimeViterbi {
    topology: Topology,
    /// Most frames that may wait for fusion.
    bound: Option<usize>,
    /// Log probability of the best path to each state, the best one being 0.
    score: Vec<f64>,
    next_score: Vec<f64>,
    /// Frame number of the oldest frame that is not emitted, and number of frames pushed.
    first: u64,
    now: u64,
    /// Rings with a slot per frame: predecessor and children per state, and the set of living states.
    capacity: usize,
    back: Vec<u16>,
    children: Vec<u16>,
    alive: Vec<u64>,
    /// Buffer of one path.
    path: Vec<u16>,
    /// How often every path died.
    restarts: u64,
}

impl ShortTimeViterbi {
    /// Decoder that emits a state at the latest `bound` frames after its own frame; without a bound, when it is
    /// certain.
    ///
    /// With a bound, the state of the path that is best now is taken, and all paths that contradict it are given
    /// up: the emitted path stays one that the model can walk.
    pub fn new(topology: Topology, bound: Option<usize>) -> Self {
        let states = topology.states();
        // A power of two: a division per step would be a tenth of its cost.
        let capacity = bound.map_or(64, |bound| (bound + 2).next_power_of_two());
        let words = states.div_ceil(64);
        Self {
            topology,
            bound,
            score: vec![DEAD; states],
            next_score: vec![DEAD; states],
            first: 0,
            now: 0,
            capacity,
            back: vec![0; capacity * states],
            children: vec![0; capacity * states],
            alive: vec![0; capacity * words],
            path: Vec::with_capacity(capacity),
            restarts: 0,
        }
    }

    /// Takes the log density of every state at the next frame, and returns the states that became certain, with the
    /// numbers of their frames, in order.
    ///
    /// A frame in which no state can be (all minus infinity) ends all paths: the best one is emitted as far
    /// as it came, and the next frame begins anew.
    ///
    /// # Panics
    /// `log_density` has another length than the model has states.
    pub fn push(&mut self, log_density: &[f64], emit: &mut dyn FnMut(u64, usize)) {
        let states = self.topology.states();
        assert_eq!(log_density.len(), states, "one log density per state");
        if self.now - self.first + 1 >= self.capacity as u64 {
            self.grow();
        }
        let begins = self.now == self.first && self.score.iter().all(|score| *score == DEAD);
        let slot = self.slot(self.now);
        let best = if begins { self.begin(log_density) } else { self.step(slot, log_density) };
        if best == DEAD || best.is_nan() {
            self.restart(emit);
            return;
        }
        for (score, next) in self.score.iter_mut().zip(&self.next_score) {
            *score = next - best;
        }
        self.now += 1;
        let words = states.div_ceil(64);
        self.children[slot * states..(slot + 1) * states].fill(0);
        for (chunk, word) in self.score.chunks(64).zip(&mut self.alive[slot * words..(slot + 1) * words]) {
            *word =
                chunk.iter().enumerate().fold(0, |set, (bit, score)| set | (u64::from(*score > DEAD) << bit));
        }
        if !begins {
            self.link(slot);
        }
        self.emit_fused(emit);
        if let Some(bound) = self.bound {
            while self.now - self.first > bound as u64 {
                self.force(emit);
                self.emit_fused(emit);
            }
        }
    }

    /// Ends the stream: emits the rest of the best path, and is as new afterwards but for the frame number.
    pub fn finish(&mut self, emit: &mut dyn FnMut(u64, usize)) {
        if self.now > self.first {
            self.trace();
            for (index, state) in self.path.iter().enumerate() {
                emit(self.first + index as u64, usize::from(*state));
            }
        }
        self.first = self.now;
        self.score.fill(DEAD);
    }

    /// The best path as it looks now, of the frames that are not emitted: number of its first frame, and states.
    pub fn provisional(&mut self) -> (u64, &[u16]) {
        if self.now > self.first {
            self.trace();
        } else {
            self.path.clear();
        }
        (self.first, &self.path)
    }

    /// State in which the best path ends now; `None` before the first frame.
    pub fn best(&self) -> Option<usize> {
        let mut best = None;
        let mut highest = DEAD;
        for (state, score) in self.score.iter().enumerate() {
            if *score > highest {
                (best, highest) = (Some(state), *score);
            }
        }
        best
    }

    /// Number of frames pushed.
    pub fn frames(&self) -> u64 {
        self.now
    }

    /// How often no state was possible and the path began anew.
    pub fn restarts(&self) -> u64 {
        self.restarts
    }

    fn slot(&self, frame: u64) -> usize {
        (frame & (self.capacity as u64 - 1)) as usize
    }

    fn begin(&mut self, log_density: &[f64]) -> f64 {
        let mut best = DEAD;
        for ((next, initial), density) in
            self.next_score.iter_mut().zip(&self.topology.initial).zip(log_density)
        {
            *next = initial + density;
            best = best.max(*next);
        }
        best
    }

    /// One step of the recursion; the highest score.
    fn step(&mut self, slot: usize, log_density: &[f64]) -> f64 {
        let states = self.topology.states();
        let back = &mut self.back[slot * states..(slot + 1) * states];
        let mut start = 0;
        let mut best = DEAD;
        for (((next, back), end), density) in
            self.next_score.iter_mut().zip(back).zip(&self.topology.ends).zip(log_density)
        {
            let end = *end as usize;
            let (mut highest, mut origin) = (DEAD, 0);
            for (from, log_probability) in
                self.topology.from[start..end].iter().zip(&self.topology.log_probability[start..end])
            {
                let score = self.score[usize::from(*from)] + log_probability;
                // Strictly greater: of equal ones the lowest index wins.
                if score > highest {
                    (highest, origin) = (score, *from);
                }
            }
            start = end;
            *back = origin;
            *next = highest + density;
            best = best.max(*next);
        }
        best
    }

    /// Counts the children of the frame before, and buries its childless states.
    fn link(&mut self, slot: usize) {
        let states = self.topology.states();
        let words = states.div_ceil(64);
        let before = self.slot(self.now - 2);
        if self.now - 2 < self.first {
            return; // that frame is emitted
        }
        for word in 0..words {
            for state in bits(self.alive[slot * words + word]) {
                let parent = self.back[slot * states + 64 * word + state];
                self.children[before * states + usize::from(parent)] += 1;
            }
        }
        for word in 0..words {
            for state in bits(self.alive[before * words + word]) {
                if self.children[before * states + 64 * word + state] == 0 {
                    self.bury(self.now - 2, 64 * word + state);
                }
            }
        }
    }

    /// Takes a childless state out, and its ancestors as far as it was their only child.
    fn bury(&mut self, mut frame: u64, mut state: usize) {
        let states = self.topology.states();
        let words = states.div_ceil(64);
        loop {
            let slot = self.slot(frame);
            self.alive[slot * words + state / 64] &= !(1 << (state % 64));
            if frame == self.first {
                return;
            }
            state = usize::from(self.back[slot * states + state]);
            frame -= 1;
            let parent = self.slot(frame) * states + state;
            let children = &mut self.children[parent];
            *children -= 1;
            if *children > 0 {
                return;
            }
        }
    }

    /// Emits the common stem.
    fn emit_fused(&mut self, emit: &mut dyn FnMut(u64, usize)) {
        let words = self.topology.states().div_ceil(64);
        while self.first < self.now {
            let slot = self.slot(self.first);
            let mut only = None;
            for (index, word) in self.alive[slot * words..(slot + 1) * words].iter().enumerate() {
                match (word.count_ones(), only) {
                    (0, _) => {}
                    (1, None) => only = Some(64 * index + word.trailing_zeros() as usize),
                    _ => return,
                }
            }
            let Some(state) = only else { return };
            emit(self.first, state);
            self.first += 1;
        }
    }

    /// Decides the oldest frame by the path that is best now, and gives up all paths that contradict.
    fn force(&mut self, emit: &mut dyn FnMut(u64, usize)) {
        let states = self.topology.states();
        let words = states.div_ceil(64);
        let Some(chosen) = self.best().map(|best| self.oldest(best)) else { return };
        let slot = self.slot(self.first);
        let set = &mut self.alive[slot * words..(slot + 1) * words];
        set.fill(0);
        set[chosen / 64] |= 1 << (chosen % 64);
        emit(self.first, chosen);
        for frame in self.first + 1..self.now {
            let (slot, before) = (self.slot(frame), self.slot(frame - 1));
            let mut removed = false;
            for word in 0..words {
                for state in bits(self.alive[slot * words + word]) {
                    let parent = usize::from(self.back[slot * states + 64 * word + state]);
                    if self.alive[before * words + parent / 64] >> (parent % 64) & 1 == 0 {
                        self.alive[slot * words + word] &= !(1 << state);
                        removed = true;
                        if frame + 1 == self.now {
                            self.score[64 * word + state] = DEAD;
                        }
                    }
                }
            }
            if !removed {
                break; // all later states descend from these
            }
        }
        self.first += 1;
    }

    /// The state at the oldest frame that is not emitted, on the path that ends in `state` now.
    fn oldest(&self, mut state: usize) -> usize {
        let states = self.topology.states();
        for frame in (self.first + 1..self.now).rev() {
            state = usize::from(self.back[self.slot(frame) * states + state]);
        }
        state
    }

    /// Writes the best path of the frames that are not emitted into `path`.
    fn trace(&mut self) {
        let states = self.topology.states();
        let Some(mut state) = self.best() else {
            self.path.clear();
            return;
        };
        self.path.clear();
        self.path.resize((self.now - self.first) as usize, 0);
        for frame in (self.first..self.now).rev() {
            self.path[(frame - self.first) as usize] = state as u16;
            if frame > self.first {
                state = usize::from(self.back[self.slot(frame) * states + state]);
            }
        }
    }

    fn restart(&mut self, emit: &mut dyn FnMut(u64, usize)) {
        self.finish(emit);
        self.now += 1;
        self.first = self.now;
        self.restarts += 1;
    }

    /// Doubles the rings; only without a bound.
    fn grow(&mut self) {
        let states = self.topology.states();
        let words = states.div_ceil(64);
        let capacity = 2 * self.capacity;
        let (mut back, mut children) = (vec![0; capacity * states], vec![0; capacity * states]);
        let mut alive = vec![0; capacity * words];
        for frame in self.first..self.now {
            let (old, new) = (self.slot(frame), (frame % capacity as u64) as usize);
            back[new * states..][..states].copy_from_slice(&self.back[old * states..][..states]);
            children[new * states..][..states].copy_from_slice(&self.children[old * states..][..states]);
            alive[new * words..][..words].copy_from_slice(&self.alive[old * words..][..words]);
        }
        (self.back, self.children, self.alive, self.capacity) = (back, children, alive, capacity);
    }
}

/// Indices of the bits that are set.
fn bits(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (word != 0).then(|| {
            let bit = word.trailing_zeros() as usize;
            word &= word - 1;
            bit
        })
    })
}

#[cfg(test)]
#[path = "viterbi_tests.rs"]
pub(super) mod tests;
