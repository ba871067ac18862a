//! Pictures (SVG) of what commands found.

pub(crate) mod cascade;
pub(crate) mod exercise;
pub(crate) mod faults;
pub(crate) mod keyframes;
pub(crate) mod segments;
mod svg;
