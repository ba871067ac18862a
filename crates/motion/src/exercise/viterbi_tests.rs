//! Short-time Viterbi against full Viterbi and against the set walk of the definition.

use super::*;

/// Small deterministic generator, so that a failing seed can be run again.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d)
    }

    /// From 0 up to 1.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, end: usize) -> usize {
        (self.unit() * end as f64) as usize
    }
}

struct Model {
    initial: Vec<f64>,
    transitions: Vec<(usize, usize, f64)>,
    density: Vec<Vec<f64>>,
}

/// Random model: dense, sparse or left-right, with ties (few distinct values) in half of the seeds.
fn model(seed: u64, frames: usize) -> Model {
    let mut random = Random::new(seed);
    let states = 1 + random.below(if seed.is_multiple_of(50) { 90 } else { 12 });
    let coarse = random.unit() < 0.5;
    let kind = random.below(3);
    let value = |random: &mut Random| {
        let value = -4.0 * random.unit();
        if coarse { value.round() } else { value }
    };
    let initial = (0..states)
        .map(|state| if kind == 2 && state > 0 { DEAD } else { value(&mut random) })
        .collect::<Vec<_>>();
    let mut transitions = Vec::new();
    for from in 0..states {
        for to in 0..states {
            let allowed = match kind {
                0 => true,
                1 => from == to || random.unit() < 0.3,
                _ => (from..from + 3).contains(&to) || (from + 2 >= states && to < 2),
            };
            if allowed {
                transitions.push((from, to, value(&mut random)));
            }
        }
    }
    let density =
        (0..frames).map(|_| (0..states).map(|_| 3.0 * value(&mut random)).collect::<Vec<_>>()).collect();
    Model { initial, transitions, density }
}

/// The textbook: all back pointers, one trace at the end. Subtracts the same maxima, so that ties are the same ones.
fn full_viterbi(model: &Model) -> Vec<usize> {
    let states = model.initial.len();
    let mut pointers: Vec<Vec<usize>> = Vec::new();
    let mut score: Vec<f64> = Vec::new();
    for (frame, density) in model.density.iter().enumerate() {
        let mut next = vec![DEAD; states];
        let mut pointer = vec![0; states];
        for to in 0..states {
            if frame == 0 {
                next[to] = model.initial[to];
            } else {
                for &(from, target, log_probability) in &model.transitions {
                    if target == to && score[from] + log_probability > next[to] {
                        next[to] = score[from] + log_probability;
                        pointer[to] = from;
                    }
                }
            }
            next[to] += density[to];
        }
        let best = next.iter().copied().fold(DEAD, f64::max);
        score = next.iter().map(|value| value - best).collect();
        pointers.push(pointer);
    }
    let mut state = 0;
    for candidate in 0..states {
        if score[candidate] > score[state] {
            state = candidate;
        }
    }
    let mut path = vec![state];
    for pointer in pointers[1..].iter().rev() {
        state = pointer[state];
        path.push(state);
    }
    path.reverse();
    path
}

fn decode(model: &Model, bound: Option<usize>) -> (Vec<usize>, u64) {
    let topology = Topology::new(model.initial.clone(), &model.transitions);
    let mut viterbi = ShortTimeViterbi::new(topology, bound);
    let (mut path, mut slowest) = (Vec::new(), 0);
    for (now, density) in model.density.iter().enumerate() {
        viterbi.push(density, &mut |frame, state| {
            assert_eq!(frame, path.len() as u64);
            slowest = slowest.max(now as u64 - frame);
            path.push(state);
        });
    }
    viterbi.finish(&mut |frame, state| {
        assert_eq!(frame, path.len() as u64);
        path.push(state);
    });
    (path, slowest)
}

fn exact(seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let model = model(seed, 120);
        assert_eq!(decode(&model, None).0, full_viterbi(&model), "seed {seed}");
    }
}

#[test]
fn given_random_models_it_emits_exactly_the_full_path() {
    exact(0..10_000);
}

#[test]
fn given_a_bound_it_keeps_it_and_walks_only_transitions_that_are_there() {
    for seed in 0..400 {
        let model = model(seed, 120);
        for bound in [1, 5, 20] {
            let (path, slowest) = decode(&model, Some(bound));
            assert_eq!(path.len(), 120, "seed {seed}");
            assert!(slowest <= bound as u64, "seed {seed}: {slowest} frames late");
            assert!(model.initial[path[0]] > DEAD, "seed {seed}");
            for pair in path.windows(2) {
                let there = model.transitions.iter().any(|(from, to, _)| [*from, *to] == pair);
                assert!(there, "seed {seed}, bound {bound}: {pair:?} is no transition");
            }
        }
    }
}

#[test]
fn given_a_bound_beyond_the_recording_nothing_changes() {
    for seed in 0..200 {
        let model = model(seed, 60);
        assert_eq!(decode(&model, Some(100)).0, full_viterbi(&model), "seed {seed}");
    }
}

/// The fusion test of the definition: walk the set of all live states back until it has one element.
fn latest_fusion(model: &Model, frames: usize) -> Option<usize> {
    let states = model.initial.len();
    let mut score = vec![DEAD; states];
    let mut pointers: Vec<Vec<usize>> = Vec::new();
    for frame in 0..frames {
        let mut next = vec![DEAD; states];
        let mut pointer = vec![0; states];
        for to in 0..states {
            if frame == 0 {
                next[to] = model.initial[to];
            }
            for &(from, target, log_probability) in &model.transitions {
                if frame > 0 && target == to && score[from] + log_probability > next[to] {
                    next[to] = score[from] + log_probability;
                    pointer[to] = from;
                }
            }
            next[to] += model.density[frame][to];
        }
        let best = next.iter().copied().fold(DEAD, f64::max);
        score = next.iter().map(|value| value - best).collect();
        pointers.push(pointer);
    }
    let mut set: Vec<usize> = (0..states).filter(|state| score[*state] > DEAD).collect();
    for frame in (0..frames).rev() {
        if set.len() == 1 {
            return Some(frame);
        }
        set = set.iter().map(|state| pointers[frame][*state]).collect();
        set.sort_unstable();
        set.dedup();
    }
    None
}

#[test]
fn it_emits_as_early_as_the_set_walk_allows() {
    for seed in 0..60 {
        let model = model(seed, 60);
        let topology = Topology::new(model.initial.clone(), &model.transitions);
        let mut viterbi = ShortTimeViterbi::new(topology, None);
        let mut emitted = None;
        for frame in 0..60 {
            viterbi.push(&model.density[frame], &mut |number, _| emitted = Some(number as usize));
            // The walk looks at one frame of the past only; what was fused once stays so.
            assert_eq!(emitted, latest_fusion(&model, frame + 1).max(emitted), "seed {seed}, frame {frame}");
            assert!(emitted <= latest_fusion(&model, frame + 1), "seed {seed}, frame {frame}");
        }
    }
}

#[test]
fn given_a_frame_in_which_nothing_is_possible_it_begins_anew() {
    let topology = Topology::new(vec![0.0, DEAD], &[(0, 0, -0.7), (0, 1, -0.7), (1, 1, 0.0)]);
    let mut viterbi = ShortTimeViterbi::new(topology, None);
    let mut path = Vec::new();
    for density in [[0.0, -1.0], [-5.0, -1.0], [DEAD, DEAD], [0.0, 0.0], [0.0, 0.0]] {
        viterbi.push(&density, &mut |frame, state| path.push((frame, state)));
    }
    viterbi.finish(&mut |frame, state| path.push((frame, state)));
    assert_eq!(viterbi.restarts(), 1);
    assert_eq!(path, [(0, 0), (1, 1), (3, 0), (4, 0)]);
}

#[test]
fn given_a_snapshot_it_goes_on_as_before() {
    let model = model(7, 120);
    let topology = Topology::new(model.initial.clone(), &model.transitions);
    let mut restored = ShortTimeViterbi::new(topology.clone(), Some(20));
    let mut viterbi = ShortTimeViterbi::new(topology, Some(20));
    for density in &model.density[..60] {
        viterbi.push(density, &mut |_, _| {});
    }
    posed_state::restore(&mut restored, &posed_state::snapshot(&viterbi)).unwrap();
    let run = |viterbi: &mut ShortTimeViterbi| {
        let mut path = Vec::new();
        for density in &model.density[60..] {
            viterbi.push(density, &mut |frame, state| path.push((frame, state)));
        }
        path
    };
    assert_eq!(run(&mut viterbi), run(&mut restored));
}
