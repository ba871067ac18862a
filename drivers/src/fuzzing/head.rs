//! Settings out of the first bytes of an input.

/// Bytes in front of the script. A byte of 0 always chooses the default, so that a head of zeros is a device as the stage file has
/// it without a word.
pub const HEAD: usize = 32;

/// Takes a choice from each byte; 0 where there are no more.
pub(super) struct Head<'a>(&'a [u8]);

impl<'a> Head<'a> {
    /// The head, and the script behind it.
    pub(super) fn of(data: &'a [u8]) -> (Self, &'a [u8]) {
        let (head, script) = data.split_at(data.len().min(HEAD));
        (Self(head), script)
    }

    pub(super) fn byte(&mut self) -> u8 {
        let Some((&byte, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        byte
    }

    /// `default` or not.
    pub(super) fn flag(&mut self, default: bool) -> bool {
        (self.byte() & 1 == 1) != default
    }

    pub(super) fn pick<T: Copy, const N: usize>(&mut self, all: [T; N]) -> T {
        all[usize::from(self.byte()) % N]
    }

    /// A byte as it is; absent with 0.
    pub(super) fn optional_byte(&mut self) -> Option<u8> {
        // Every number there is, 0 too.
        Some(self.byte()).filter(|byte| *byte != 0).map(|byte| byte.wrapping_add(1))
    }

    /// A number from `least` to `most`, one of them, or one that is neither; absent with 0.
    pub(super) fn number(&mut self, least: f64, most: f64) -> Option<f64> {
        Some(match self.byte() {
            0 => return None,
            1 => least,
            2 => most,
            3 => least - 1e-6,
            4 => most + 1e-6,
            5 => f64::NAN,
            6 => f64::INFINITY,
            7 => 0.0,
            8 => -1.0,
            9 => 1e-300,
            share => least + (most - least) * f64::from(share) / 255.0,
        })
    }

    /// Up to seven addresses; `default` with 0. Among them twice the same, 0 beside others, and what no device has.
    pub(super) fn addresses(&mut self, default: &[u16]) -> Vec<u16> {
        match self.byte() {
            0 => default.to_vec(),
            count => (0..count % 8).map(|_| u16::from_be_bytes([self.byte(), self.byte()])).collect(),
        }
    }
}
