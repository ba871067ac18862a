//! What lasts, and is no single mishap.

use posed_state::Plain;

/// Whether something was so in each of the last five of a series: frames, or records. It lasts where it was in three of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
pub struct Debounce(u8);

impl Debounce {
    const RECENT: u8 = 0b1_1111;
    const LASTS: u32 = 3;

    /// Takes the next one.
    pub fn push(&mut self, is_so: bool) {
        self.0 = (self.0 << 1 | u8::from(is_so)) & Self::RECENT;
    }

    /// Whether it was so in three of the last five.
    pub fn lasts(self) -> bool {
        self.0.count_ones() >= Self::LASTS
    }

    /// The same, and it is so in the last one.
    pub fn still_lasts(self) -> bool {
        self.0 & 1 == 1 && self.lasts()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_of_the_last_five_last_and_the_sixth_is_forgotten() {
        let mut debounce = Debounce::default();
        let mut seen = |is_so| {
            debounce.push(is_so);
            (debounce.lasts(), debounce.still_lasts())
        };
        assert_eq!([true, false, true].map(&mut seen), [(false, false); 3]);
        assert_eq!([false, true, true].map(&mut seen), [(false, false), (true, true), (true, true)]);
        assert_eq!([false, false, false].map(&mut seen), [(true, false), (false, false), (false, false)]);
    }
}
