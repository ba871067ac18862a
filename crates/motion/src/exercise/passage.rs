//! From states to repetitions: where on a path one begins and where it is complete.
//!
//! What comes in: the states of a path, frame by frame. What goes out: the beginning of a repetition once its movement
//! begins, and its end once the last state is reached. A path may wait in the first and in the last states, which look
//! like rest: the waiting belongs to no repetition. What it never does: begin before the movement began.

use posed_state::Plain;

use super::align::{waits_after, waits_before};
use super::exercise_topology::{ExerciseTopology, PathState};

/// Frames of waiting in the first state that count as the beginning of the movement.
const BEFORE: u64 = 2;

/// What a frame on the path means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub(super) enum Mark {
    /// A repetition of `exercise` began at frame `start`.
    Begun { exercise: usize, start: u64 },
    /// It is complete with frame `end - 1`.
    Complete { exercise: usize, start: u64, end: u64 },
}

/// Follows a path; a copy follows what it may become.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Plain)]
pub(super) struct Passage {
    before: usize,
    /// First frame of the repetition that goes on.
    open: Option<u64>,
    /// Frames of waiting in the first state.
    waiting: u64,
    /// Frames in the present state.
    dwell: u64,
    /// The repetition is complete; the path waits in its last state.
    complete: bool,
}

impl Passage {
    /// First frame of the repetition that goes on.
    pub(super) fn open(&self) -> Option<u64> {
        self.open
    }

    /// Takes the path's state at the next frame.
    pub(super) fn step(
        &mut self,
        exercise_topology: &ExerciseTopology,
        frame: u64,
        state: usize,
        mark: &mut dyn FnMut(Mark),
    ) {
        let before = std::mem::replace(&mut self.before, state);
        if before == 0 || exercise_topology.is_boundary(before, state) {
            if let (Some(start), PathState::Within { exercise, .. }) =
                (self.open.take(), exercise_topology.place(before))
            {
                mark(Mark::Complete { exercise, start, end: frame });
            }
            (self.waiting, self.complete) = (0, false);
        }
        self.dwell = if before == state { self.dwell + 1 } else { 1 };
        let PathState::Within { exercise, state: within, .. } = exercise_topology.place(state) else {
            return;
        };
        let states = exercise_topology.range(exercise, 0).len();
        if within == 0 {
            self.waiting += 1;
        } else if self.open.is_none() && !self.complete {
            let start = frame - self.waiting.min(BEFORE);
            self.open = Some(start);
            mark(Mark::Begun { exercise, start });
        }
        if waits_before(within, states, self.dwell) && self.open.is_some() {
            self.open = Some(frame - BEFORE);
        }
        let arrived = before == state && within + 1 == states;
        if (arrived || waits_after(within, states, self.dwell))
            && let Some(start) = self.open.take()
        {
            self.complete = true;
            mark(Mark::Complete { exercise, start, end: frame + 1 });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marks(path: &[usize]) -> Vec<Mark> {
        let exercise_topology = ExerciseTopology::new([(6, 1), (6, 1)].into_iter());
        let (mut passage, mut marks) = (Passage::default(), Vec::new());
        for (frame, state) in path.iter().enumerate() {
            passage.step(&exercise_topology, frame as u64, *state, &mut |mark| marks.push(mark));
        }
        marks
    }

    #[test]
    fn waiting_before_and_after_belongs_to_no_repetition() {
        let path = [0, 1, 1, 1, 1, 2, 3, 4, 5, 6, 6, 6, 6, 0];
        let complete = Mark::Complete { exercise: 0, start: 3, end: 11 };
        assert_eq!(marks(&path), [Mark::Begun { exercise: 0, start: 3 }, complete]);
    }

    #[test]
    fn repetitions_follow_each_other_without_rest_and_of_several_exercises() {
        let path = [0, 2, 4, 5, 1, 3, 5, 6, 0, 7, 9, 11, 12, 8, 10];
        let begun = |exercise, start| Mark::Begun { exercise, start };
        let complete = |exercise, start, end| Mark::Complete { exercise, start, end };
        assert_eq!(
            marks(&path),
            [
                begun(0, 1),
                complete(0, 1, 4),
                begun(0, 4),
                complete(0, 4, 8),
                begun(1, 9),
                complete(1, 9, 13),
                begun(1, 13)
            ]
        );
    }
}
