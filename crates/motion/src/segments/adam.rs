//! Adam (Kingma & Ba 2015) with decoupled weight decay (Loshchilov & Hutter 2019).
//!
//! What comes in: parameters and their gradient. What goes out: the parameters a step further.

/// The optimiser and what it remembers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Adam {
    /// Steps taken.
    pub(super) steps: u64,
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
}

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

impl Adam {
    /// For so many parameters.
    pub(super) fn new(parameters: usize) -> Self {
        Self { steps: 0, first: vec![0.0; parameters], second: vec![0.0; parameters] }
    }

    /// One step of length `rate` down the gradient, and `decay * rate` towards zero.
    pub(super) fn step(&mut self, parameters: &mut [f32], gradient: &[f32], rate: f32, decay: f32) {
        self.steps += 1;
        let steps = self.steps.min(1 << 24) as i32;
        let unbias_1 = 1.0 / (1.0 - BETA_1.powi(steps));
        let unbias_2 = 1.0 / (1.0 - BETA_2.powi(steps));
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((parameter, slope), (first, second)) in parameters.iter_mut().zip(gradient).zip(moments) {
            *first = BETA_1 * *first + (1.0 - BETA_1) * slope;
            *second = BETA_2 * *second + (1.0 - BETA_2) * slope * slope;
            let step = (*first * unbias_1) / ((*second * unbias_2).sqrt() + EPSILON);
            *parameter -= rate * (step + decay * *parameter);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first step is `rate` against the sign of the gradient, whatever its size.
    #[test]
    fn first_steps_have_the_length_of_the_rate() {
        let mut adam = Adam::new(3);
        let mut parameters = [1.0, 1.0, 1.0];
        adam.step(&mut parameters, &[1e-3, -50.0, 0.0], 0.1, 0.0);
        for (got, expected) in parameters.iter().zip([0.9, 1.1, 1.0]) {
            assert!((got - expected).abs() < 1e-5, "{parameters:?}");
        }
    }

    #[test]
    fn finds_the_lowest_point_of_a_bowl() {
        let mut adam = Adam::new(2);
        let mut at = [3.0_f32, -2.0];
        for _ in 0..2000 {
            let slope = [2.0 * (at[0] - 1.0), 20.0 * (at[1] - 0.5)];
            adam.step(&mut at, &slope, 0.02, 0.0);
        }
        assert!((at[0] - 1.0).abs() < 1e-2 && (at[1] - 0.5).abs() < 1e-2, "{at:?}");
    }
}
