//! Minimum durations: the best sequence of labels in which none is shorter than it can be.
//!
//! What comes in: probabilities of the classes, frame by frame. What goes out: the class of each frame, when it is
//! certain or at the latest a stated number of frames later. What it never does: hold a frame back for longer.
//!
//! Each class is a chain of as many states as its minimum has frames; only the last one may stay, or go over to
//! the first of another class. The chains are decoded by the short-time Viterbi algorithm.

use posed_state::Plain;

use crate::exercise::{ShortTimeViterbi, Topology};

/// Least probability of a class, so that one frame does not decide alone.
const LEAST: f64 = 1e-3;

/// Decodes classes with minimum durations from probabilities per frame, as a stream.
#[derive(Clone, Debug, Plain)]
pub struct Decoder {
    viterbi: ShortTimeViterbi,
    /// Class of each state.
    class: Vec<u16>,
    log_density: Vec<f64>,
}

impl Decoder {
    /// For classes that last at least `minimum` frames each. `switch` is the log probability of a change of class, per
    /// frame; `bound` the most frames that a decision may take.
    pub fn new(minimum: &[usize], switch: f64, bound: usize) -> Self {
        let mut class = Vec::new();
        let mut ends = Vec::new();
        for (index, minimum) in minimum.iter().enumerate() {
            class.extend(std::iter::repeat_n(index as u16, (*minimum).max(1)));
            ends.push((class.len() - (*minimum).max(1), class.len() - 1));
        }
        // A stream may begin in the middle of something.
        let mut initial = vec![f64::NEG_INFINITY; class.len()];
        let mut transitions = Vec::new();
        for (first, last) in &ends {
            initial[*last] = 0.0;
            transitions.extend((*first..*last).map(|state| (state, state + 1, 0.0)));
            transitions.push((*last, *last, 0.0));
            for (other, _) in ends.iter().filter(|other| other.0 != *first) {
                transitions.push((*last, *other, switch));
            }
        }
        let log_density = vec![0.0; class.len()];
        Self {
            viterbi: ShortTimeViterbi::new(Topology::new(initial, &transitions), Some(bound)),
            class,
            log_density,
        }
    }

    /// Takes the probabilities of the next frame, one per class; `emit` gets frame number and class of each frame that
    /// became certain, in order. The first and the last segment of a stream may be shorter than the minimum.
    pub fn push(&mut self, probabilities: &[f32], emit: &mut dyn FnMut(u64, usize)) {
        for (log_density, class) in self.log_density.iter_mut().zip(&self.class) {
            *log_density = libm::log(f64::from(probabilities[usize::from(*class)]).max(LEAST));
        }
        let class = &self.class;
        self.viterbi.push(&self.log_density, &mut |frame, state| emit(frame, usize::from(class[state])));
    }

    /// Class in which the best path ends now; `None` before the first frame.
    pub fn best(&self) -> Option<usize> {
        self.viterbi.best().map(|state| usize::from(self.class[state]))
    }

    /// Ends the stream; `emit` gets frame number and class of the frames that are left.
    pub fn finish(&mut self, emit: &mut dyn FnMut(u64, usize)) {
        let class = &self.class;
        self.viterbi.finish(&mut |frame, state| emit(frame, usize::from(class[state])));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(minimum: &[usize], bound: usize, frames: &[usize]) -> Vec<usize> {
        let mut decoder = Decoder::new(minimum, -2.0, bound);
        let mut classes = Vec::new();
        let mut emit = |frame: u64, class| {
            assert_eq!(frame, classes.len() as u64);
            classes.push(class);
        };
        for class in frames {
            let mut probabilities = vec![0.1; minimum.len()];
            probabilities[*class] = 0.8;
            decoder.push(&probabilities, &mut emit);
        }
        decoder.finish(&mut emit);
        classes
    }

    #[test]
    fn what_is_too_short_is_swallowed_and_the_rest_stays() {
        let frames = [[0; 10].as_slice(), &[1; 3], &[0; 10], &[2; 6], &[1; 8]].concat();
        let expected = [[0; 23].as_slice(), &[2; 6], &[1; 8]].concat();
        assert_eq!(decode(&[5, 5, 5], 40, &frames), expected);
        // The first and the last segment may be cut off.
        let frames = [[1; 2].as_slice(), &[0; 9], &[2; 2]].concat();
        assert_eq!(decode(&[5, 5, 5], 40, &frames), frames);
    }

    #[test]
    fn a_bound_holds_no_frame_back_for_longer() {
        let mut decoder = Decoder::new(&[4, 4], -1.0, 6);
        let mut last = None;
        for frame in 0..50_u64 {
            decoder.push(&[0.5, 0.5], &mut |frame, _| last = Some(frame));
            assert!(frame < 6 || last.is_some_and(|last| last + 6 >= frame), "{frame} {last:?}");
        }
    }
}
