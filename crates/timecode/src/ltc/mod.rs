//! Linear (longitudinal) time code, SMPTE 12M: 80 bits a frame as sound, in bi-phase mark: the level changes at the beginning of every
//! bit, and in the middle of each that is one.

mod decode;
mod encode;
mod word;

pub use decode::Decoder;
pub use encode::Encoder;
