//! Units with known intrinsics: whose samples are corrected by what.
//!
//! In: intrinsics, each for a unit; records, with the unit that measured them. Out: the same records with what orientation
//! filters are to take. What the unit said stays beside it: recordings, raw fields and the next calibration need that. A unit is
//! identified by the serial number that its device reports, else by that of the stage file, else by its sensor's name.

use super::input_error::InputError;
use posed_fusion::intrinsics::Intrinsics;
use posed_stage::input::SensorIndex;
use posed_stage::output::Measured;
use posed_state::Plain;

/// Units whose intrinsics can be known at a time.
const UNITS: usize = 1024;
/// Longest name of a unit, bytes.
const UNIT_BYTES: usize = 64;

#[derive(Clone, Debug, Plain)]
pub(super) struct Units {
    /// By unit.
    known: Vec<Known>,
    /// By sensor: the number of the intrinsics that its last record was corrected by, 0 for none.
    in_use: Vec<u32>,
    /// The highest number given.
    newest: u32,
}

#[derive(Clone, Debug, Plain)]
struct Known {
    unit: String,
    number: u32,
    intrinsics: Intrinsics,
}

impl Units {
    pub(super) fn new(sensors: usize) -> Self {
        Self { known: Vec::new(), in_use: vec![0; sensors], newest: 0 }
    }

    /// Whether no unit is known, so that nobody needs to be asked who it is.
    pub(super) fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// Whether a unit's intrinsics can be taken.
    ///
    /// # Errors
    /// Its name is too long, or there are too many units.
    pub(super) fn check_load(&self, unit: &str) -> Result<(), InputError> {
        let known = self.known.binary_search_by(|known| known.unit.as_str().cmp(unit)).is_ok();
        if unit.len() > UNIT_BYTES {
            Err(InputError::OutOfRange {
                key: "unit",
                expected: format!("a name of at most {UNIT_BYTES} bytes"),
            })
        } else if !known && self.known.len() >= UNITS {
            Err(InputError::Full { key: "unit", limit: UNITS })
        } else {
            Ok(())
        }
    }

    /// Takes a unit's intrinsics, in place of those before.
    pub(super) fn load(&mut self, unit: &str, intrinsics: &Intrinsics) {
        self.newest += 1;
        let known = Known { unit: unit.to_owned(), number: self.newest, intrinsics: intrinsics.clone() };
        match self.known.binary_search_by(|known| known.unit.as_str().cmp(unit)) {
            Ok(at) => self.known[at] = known,
            Err(at) => self.known.insert(at, known),
        }
    }

    /// Whether the last record of a sensor was corrected.
    pub(super) fn corrects(&self, sensor: SensorIndex) -> bool {
        self.in_use.get(usize::from(sensor)).is_some_and(|number| *number > 0)
    }

    /// Corrects a record of a sensor, which this unit measured. True where the one before was corrected by other numbers: what
    /// filters have learnt of the sensor does not hold any more.
    pub(super) fn correct(&mut self, sensor: SensorIndex, unit: &str, measured: &mut Measured) -> bool {
        let at = self.known.binary_search_by(|known| known.unit.as_str().cmp(unit));
        let known = at.ok().and_then(|at| self.known.get(at));
        if let (Some(known), Some(inertial)) = (known, &mut measured.inertial) {
            inertial.corrected = inertial.uncorrected().map(|sample| known.intrinsics.apply(&sample));
        }
        let Some(in_use) = self.in_use.get_mut(usize::from(sensor)) else { return false };
        let number = known.map_or(0, |known| known.number);
        std::mem::replace(in_use, number) != number
    }
}
