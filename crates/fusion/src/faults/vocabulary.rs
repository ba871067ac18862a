//! The words for what is wrong with a measurement: one set for detectors, filters, the fault map, messages and files.
//!
//! A [`Label`] states what a measurement is ([`Class`]) and why ([`Cause`]); [`Repair`] what was done about it; [`Verdict`] what a
//! filter made of it. A [`Finding`] is all of that for one sensor in one frame; the sensor's published state follows from
//! it alone.

use posed_state::Plain;
use serde::{Deserialize, Serialize};

/// What a measurement, or a frame, is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "FaultClass"))]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// Nothing is known against it.
    Clean,
    /// On the wrong side of the transmitter.
    Inverted,
    /// Wrong in another way.
    Anomalous,
    /// Cannot be decided.
    Unknown,
}

impl Class {
    /// The word for it in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Inverted => "inverted",
            Self::Anomalous => "anomalous",
            Self::Unknown => "unknown",
        }
    }
}

/// Why a measurement, or a sensor, is not simply good.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "FaultCause"))]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Hemisphere inversion: the position is mirrored through the transmitter.
    HemisphereInversion,
    /// The position is mirrored in the vertical axis alone.
    VerticalInversion,
    /// The same words again and again where they should have changed.
    Stuck,
    /// Outside the innovation gate, or not yet confirmed.
    Gate,
    /// Nothing arrives.
    Missing,
    /// A number that is not finite.
    NotFinite,
    /// At the end of its range.
    Saturated,
    /// Does not fit its body segment: the strap has slipped, or two sensors are swapped.
    Misfit,
    /// Sits on another body segment than the stage says, as movements have shown; it counts where it sits.
    Swapped,
    /// A jump that no motion makes.
    Jump,
    /// A place, or a distance to another sensor, that joints do not allow.
    Bone,
    /// The fault map knows such frames as faulty.
    Map,
    /// Far from all that was seen when the fault map was learnt.
    Distance,
}

impl Cause {
    /// The word for it in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::HemisphereInversion => "hemisphere_inversion",
            Self::VerticalInversion => "vertical_inversion",
            Self::Stuck => "stuck",
            Self::Gate => "gate",
            Self::Missing => "missing",
            Self::NotFinite => "not_finite",
            Self::Saturated => "saturated",
            Self::Misfit => "misfit",
            Self::Swapped => "swapped",
            Self::Jump => "jump",
            Self::Bone => "bone",
            Self::Map => "map",
            Self::Distance => "distance",
        }
    }

    /// What it is, for people.
    pub fn words(self) -> &'static str {
        match self {
            Self::HemisphereInversion => "mirrored through the transmitter, and mirrored back",
            Self::VerticalInversion => "mirrored in the vertical axis, and mirrored back",
            Self::Stuck => "the device repeats its last words",
            Self::Gate => "the pose is not where it can be",
            Self::Missing => "nothing arrives",
            Self::NotFinite => "it sends numbers that are not finite",
            Self::Saturated => "it is at the end of its range",
            Self::Misfit => "it does not move as its body segment can",
            Self::Swapped => "it sits on another body segment than the stage says, and counts where it sits",
            Self::Jump => "it jumped as no motion does",
            Self::Bone => "it is where joints do not allow it",
            Self::Map | Self::Distance => "it is where the fault map has not seen it",
        }
    }
}

/// The ways in which a tracker mirrors a position; the orientation stays. Each undoes itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub enum Mirror {
    /// p to -p: the field of a dipole is the same there.
    Point,
    /// z to -z: the figure stands on its head, its left and right as they are (Miller et al. 2006, "inverted in the vertical axis").
    Vertical,
}

impl Mirror {
    /// The image of a position in transmitter axes, z up.
    pub fn apply(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Point => [-x, -y, -z],
            Self::Vertical => [x, y, -z],
        }
    }

    const fn cause(self) -> Cause {
        match self {
            Self::Point => Cause::HemisphereInversion,
            Self::Vertical => Cause::VerticalInversion,
        }
    }
}

/// What a measurement, or a frame, is, and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub struct Label {
    /// What it is.
    pub class: Class,
    /// Why; `None` where it is clean.
    pub cause: Option<Cause>,
}

impl Label {
    /// Nothing is known against it.
    pub const CLEAN: Self = Self { class: Class::Clean, cause: None };
    /// On the wrong side of the transmitter.
    pub const INVERTED: Self = Self::inverted(Mirror::Point);
    /// Not there.
    pub const MISSING: Self = Self { class: Class::Unknown, cause: Some(Cause::Missing) };

    /// Mirrored so.
    pub const fn inverted(mirror: Mirror) -> Self {
        Self { class: Class::Inverted, cause: Some(mirror.cause()) }
    }

    /// How it is mirrored, if it is.
    pub fn mirror(self) -> Option<Mirror> {
        let vertical = self.cause == Some(Cause::VerticalInversion);
        (self.class == Class::Inverted).then_some(if vertical { Mirror::Vertical } else { Mirror::Point })
    }

    /// Wrong in another way than by an inversion.
    pub const fn anomalous(cause: Cause) -> Self {
        Self { class: Class::Anomalous, cause: Some(cause) }
    }
}

/// How a published pose differs from the record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Repair {
    /// Mirrored back, through the transmitter or in the vertical axis.
    Mirrored,
    /// Predicted from the records before, for the record is withheld; the sensor's state is not that of a good one.
    Coasted,
}

/// What a filter made of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
pub enum Verdict {
    /// Inside its gate and used.
    Used,
    /// Outside its gate, or not yet confirmed by others; with [`Label::CLEAN`] of a filter that has just begun.
    Suspect,
    /// Not looked at: withheld, not a number, or too old.
    Dropped,
}

/// All that was found out about a sensor's newest record of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What the filter made of it.
    pub verdict: Verdict,
    /// What it is.
    pub label: Label,
    /// What was done about that.
    pub repair: Option<Repair>,
    /// Corrected outside the calibrated hull.
    pub extrapolated: bool,
    /// It belongs to an earlier frame, which had closed when it arrived.
    pub late: bool,
}

impl Finding {
    /// Its filter has just begun and may not be relied on yet; nothing is wrong with the sensor.
    pub const SETTLING: Self = Self::new(Verdict::Suspect, Label::CLEAN);

    /// In time, not repaired, not extrapolated.
    pub const fn new(verdict: Verdict, label: Label) -> Self {
        Self { verdict, label, repair: None, extrapolated: false, late: false }
    }
}
