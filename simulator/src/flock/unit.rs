//! One unit of a flock: settings, parameters, last measurement.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use nalgebra::{UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_drivers::flock::wire::value::{self, parameter, rate_word};
use posed_drivers::flock::wire::{Format, Hemisphere, Range, rotation};

use super::FlockConfig;
use crate::random::Random;

/// A parameter by its first revision: older firmware does not know it.
const SINCE: [(u8, [u8; 2]); 11] = [
    (0x11, [3, 45]),
    (0x12, [3, 66]),
    (0x13, [3, 67]),
    (0x14, [3, 67]),
    (0x15, [3, 67]),
    (0x16, [3, 67]),
    (0x17, [3, 67]),
    (0x18, [3, 67]),
    (0x19, [3, 67]),
    (0x1A, [3, 71]),
    (0x1B, [3, 71]),
];

/// Whether firmware of this revision knows a parameter.
pub(super) fn knows(revision: [u8; 2], number: u8) -> bool {
    SINCE.iter().all(|&(since_number, since)| number != since_number || revision >= since)
}

/// What a unit reports: the device's idea of a pose, before it becomes words.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    /// In the transmitter frame, m.
    pub(super) position_m: Vector3<f64>,
    /// Sensor to transmitter.
    pub(super) orientation: UnitQuaternion<f64>,
    /// Factor on the words of a matrix or quaternion; 1 for a rotation.
    pub(super) gain: f64,
}

/// One unit.
#[derive(Debug)]
pub(super) struct Unit {
    /// 0 stand-alone, else from 1.
    pub(super) address: u8,
    pub(super) format: Format,
    pub(super) hemisphere: Hemisphere,
    pub(super) button_mode: bool,
    /// Code and detail; `error_waiting` until read.
    pub(super) error: [u8; 2],
    pub(super) error_waiting: bool,
    /// Settings that only parameters hold.
    pub(super) parameters: BTreeMap<u8, Vec<u8>>,
    /// Turns what is reported: reported R = frame' R align.
    pub(super) reference_frame: UnitQuaternion<f64>,
    pub(super) angle_align: UnitQuaternion<f64>,
    /// Offset of the reported point from the sensor's centre, sensor axes, in fractions of the range.
    pub(super) offset: Vector3<f64>,
    /// When it began to measure; the first half second after that is bad.
    pub(super) started: Option<Timestamp>,
    /// Where the bad start leads, m: seeded.
    pub(super) start_error_m: Vector3<f64>,
    /// The last measurement that is ready to be sent.
    pub(super) present: Option<Measured>,
    /// The last one taken, which repeats while the sensor is out of range.
    pub(super) latest: Option<Measured>,
    /// It repeats.
    pub(super) stuck: bool,
    /// It answered on the bus in the last cycle.
    pub(super) accessible: bool,
    /// The sensor was too near in the last cycle.
    pub(super) saturated: bool,
}

impl Unit {
    /// A unit with its power-up settings.
    pub(super) fn new(config: &FlockConfig, index: usize, random: &mut Random) -> Self {
        let address = if config.stand_alone { 0 } else { index as u8 + 1 };
        let mut direction = || Vector3::new(random.normal(), random.normal(), random.normal());
        let start_error_m = 0.15 * direction().try_normalize(1e-9).unwrap_or(Vector3::x());
        Self {
            address,
            format: Format::PositionAngles,
            hemisphere: Hemisphere::Forward,
            button_mode: false,
            error: [0, 0],
            error_waiting: false,
            parameters: defaults(address, config),
            reference_frame: UnitQuaternion::identity(),
            angle_align: UnitQuaternion::identity(),
            offset: Vector3::zeros(),
            started: None,
            start_error_m,
            present: None,
            latest: None,
            stuck: false,
            accessible: true,
            saturated: false,
        }
    }

    /// Full scale of its position words.
    pub(super) fn range(&self, extended: bool) -> Range {
        let scaling = self.parameters.get(&parameter::POSITION_SCALING).and_then(|bytes| bytes.first());
        match (extended, scaling) {
            (true, _) => Range::In144,
            (false, Some(1)) => Range::In72,
            (false, _) => Range::In36,
        }
    }

    /// The measurement in the frame and of the point that the host asked for.
    pub(super) fn adjusted(&self, measured: &Measured, range: Range) -> Measured {
        let frame = self.reference_frame.inverse();
        let moves_positions = self.parameters.get(&0x11).is_some_and(|bytes| bytes.first() == Some(&1));
        let position = measured.position_m + measured.orientation * (self.offset * range.metres());
        Measured {
            position_m: if moves_positions { frame * position } else { position },
            orientation: frame * measured.orientation * self.angle_align,
            gain: measured.gain,
        }
    }
}

/// The power-up values of the parameters that are only stored.
fn defaults(address: u8, config: &FlockConfig) -> BTreeMap<u8, Vec<u8>> {
    let table = |word: u16| word.to_le_bytes().repeat(7);
    let vm = [2u16, 4, 8, 32, 64, 256, 512].iter().flat_map(|word| word.to_le_bytes()).collect();
    let rate = rate_word(config.rate_hz);
    let crystal_mhz = 25;
    let serial = 5000 + u16::from(address);
    BTreeMap::from([
        (parameter::CRYSTAL_SPEED, vec![crystal_mhz, 0]),
        (parameter::POSITION_SCALING, vec![0, 0]),
        (parameter::FILTER_STATUS, vec![0, 0]),
        (0x05, table(0x028F)),
        (
            parameter::RATE_COUNT,
            value::count_of_rate(value::rate_hz(rate), crystal_mhz).to_le_bytes().to_vec(),
        ),
        (parameter::MEASUREMENT_RATE, rate.to_le_bytes().to_vec()),
        (0x08, vec![0]),
        (0x09, vec![b',']),
        (0x0B, vec![0]),
        (0x0C, vm),
        (0x0D, table(0x7333)),
        (parameter::SUDDEN_OUTPUT_CHANGE, vec![0]),
        (0x11, vec![0]),
        (0x12, vec![1]),
        (0x14, vec![60]),
        (0x17, vec![0; 6]),
        (0x18, vec![0; 6]),
        (0x19, serial.to_le_bytes().to_vec()),
        (parameter::SENSOR_SERIAL, (serial + 1000).to_le_bytes().to_vec()),
        (0x1B, (serial + 2000).to_le_bytes().to_vec()),
        (0x1C, vec![0; 10]),
        (0x20, vec![0; 2]),
        (0x21, vec![0; 7]),
        (0x22, vec![0; 30]),
    ])
}

/// A rotation from azimuth, elevation, roll words (180 degrees at full scale).
pub(super) fn rotation_of_angles(words: [i16; 3]) -> UnitQuaternion<f64> {
    let angles = words.map(|word| f64::from(word) * PI / 32768.0);
    crate::motion::quaternion(rotation::from_angles(angles))
}

/// A rotation from sines and cosines of azimuth, elevation, roll.
pub(super) fn rotation_of_sines(words: [i16; 6]) -> UnitQuaternion<f64> {
    let angle = |i: usize| libm::atan2(f64::from(words[i]), f64::from(words[i + 1]));
    crate::motion::quaternion(rotation::from_angles([angle(0), angle(2), angle(4)]))
}
