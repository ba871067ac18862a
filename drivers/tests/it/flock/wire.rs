//! The worked examples of the protocol sheet, and round trips of everything that can be written.

use posed_drivers::flock::Family;
use posed_drivers::flock::wire::{
    Addressed, Addressing, BirdStatus, Command, CommandParser, Format, Hemisphere, QuaternionSense, Range,
    RecordError, Refused, ReportRate, Scale, Shape, Tolerance, UnitStatus, record, rotation, value,
};
use proptest::prelude::*;

const INCH: f64 = 0.0254;

fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

fn shape(format: Format, button: bool, group: bool) -> Shape {
    Shape { format, button, group }
}

fn scale(range: Range) -> Scale {
    Scale { range, quaternion_sense: QuaternionSense::Vendor }
}

/// Decodes; position in inches, angles in degrees.
fn decode(text: &str, shape: Shape, range: Range) -> (Option<[f64; 3]>, Option<[f64; 3]>, record::Record) {
    let decoded = record::decode(&hex(text), shape, scale(range), Tolerance::CAPTURE).unwrap();
    (
        decoded.position_m.map(|p| p.map(|c| c / INCH)),
        decoded.orientation_wxyz.map(|q| rotation::to_angles(q).map(f64::to_degrees)),
        decoded,
    )
}

fn close<const N: usize>(got: [f64; N], expected: [f64; N], tolerance: f64) {
    let off = got.iter().zip(expected).map(|(g, e)| (g - e).abs()).fold(0.0, f64::max);
    assert!(off <= tolerance, "{got:?} is not {expected:?}");
}

#[test]
fn a_coordinate_at_the_end_of_the_words_is_clipped() {
    let shape = shape(Format::Position, false, false);
    let clipped = |x_m: f64| {
        let mut bytes = Vec::new();
        record::encode([x_m, 0.1, -0.2], [1.0, 0.0, 0.0, 0.0], (0, 0), shape, scale(Range::In36), &mut bytes);
        record::decode(&bytes, shape, scale(Range::In36), Tolerance::CAPTURE).unwrap().is_clipped(Range::In36)
    };
    let end_m = Range::In36.metres();
    assert_eq!([0.0, 0.999 * end_m, end_m, 1.5 * end_m].map(clipped), [false, false, true, true]);
    assert_eq!([-0.999 * end_m, -end_m, -1.5 * end_m].map(clipped), [false, true, true]);
}

#[test]
fn example_1_position_angles() {
    let (p, _, _) = decode(
        "AA 15 63 79 00 24 55 0A 55 7A 00 20",
        shape(Format::PositionAngles, false, false),
        Range::In36,
    );
    close(p.unwrap(), [11.9971, -3.5024, 20.25], 6e-5);
    let words = record::words(
        &hex("AA 15 63 79 00 24 55 0A 55 7A 00 20"),
        shape(Format::PositionAngles, false, false),
    );
    assert_eq!(words.unwrap()[..6], [10920, -3188, 18432, 5460, -2732, 16384]);
}

#[test]
fn example_2_group_of_two_extended_range() {
    let group = shape(Format::PositionAngles, false, true);
    let (p, a, r) = decode("AA 15 55 72 55 1A 2A 55 47 03 7B 3F 02", group, Range::In144);
    close(p.unwrap(), [47.9883, -30.0059, 59.9941], 6e-5);
    close(a.unwrap(), [-120.0146, 9.9976, 179.8901], 6e-5);
    assert_eq!(r.address, Some(2));
    let (p, a, r) = decode("C7 7B 1C 20 39 05 00 00 00 00 00 70 03", group, Range::In144);
    close(p.unwrap(), [-10.0020, 72.4922, 12.2520], 6e-5);
    close(a.unwrap(), [0.0, 0.0, -45.0], 6e-5);
    assert_eq!(r.address, Some(3));
}

#[test]
fn example_3_position() {
    let (p, a, _) = decode("9C 3E 63 41 39 00", shape(Format::Position, false, false), Range::In72);
    close(p.unwrap(), [69.9961, -70.0049, 0.5010], 6e-5);
    assert_eq!(a, None);
}

#[test]
fn examples_4_and_5_say_the_same_pose() {
    let (p, a, m) = decode(
        "E3 01 47 03 2A 05 44 35 53 71 00 20 74 1E 5C 77 49 48 48 10 68 3D 00 00",
        shape(Format::PositionMatrix, false, false),
        Range::In36,
    );
    close(p.unwrap(), [0.9976, 1.9995, 2.9971], 6e-5);
    close(a.unwrap(), [30.0, -15.0, 90.0], 0.02);
    let (_, a, q) = decode(
        "E3 01 47 03 2A 05 67 29 11 53 0C 7A 57 6E",
        shape(Format::PositionQuaternion, false, false),
        Range::In36,
    );
    close(a.unwrap(), [30.0, -15.0, 90.0], 0.02);
    close(q.orientation_wxyz.unwrap(), [0.6533, 0.7011, 0.0923, 0.2706], 2e-4);
    assert_eq!(m.position_m, q.position_m);
    let direct = Scale { quaternion_sense: QuaternionSense::Direct, ..Scale::default() };
    let bytes = hex("E3 01 47 03 2A 05 67 29 11 53 0C 7A 57 6E");
    let decoded =
        record::decode(&bytes, shape(Format::PositionQuaternion, false, false), direct, Tolerance::LIVE)
            .unwrap();
    close(decoded.orientation_wxyz.unwrap(), [0.6533, -0.7011, -0.0923, -0.2706], 2e-4);
}

#[test]
fn example_6_extremes() {
    let angles = record::words(&hex("80 40 7F 3F 7F 7F"), shape(Format::Angles, false, false)).unwrap();
    assert_eq!(angles[..3], [-32768, 32764, -4]);
    let position = record::words(&hex("80 00 01 00 7F 7F"), shape(Format::Position, false, false)).unwrap();
    assert_eq!(position[..3], [0, 4, -4]);
}

#[test]
fn example_7_button_and_group() {
    let (p, a, r) = decode(
        "F1 08 00 00 63 11 2D 00 5B 00 08 01 10 04",
        shape(Format::PositionAngles, true, true),
        Range::In36,
    );
    close(p.unwrap(), [4.9966, 0.0, 9.9976], 6e-5);
    close(a.unwrap(), [0.9888, 1.9995, 2.9883], 6e-5);
    assert_eq!((r.button, r.address), (Some(0x10), Some(4)));
}

#[test]
fn example_8_commands() {
    let change = |parameter, data: &[u8]| Command::Change { parameter, data: data.to_vec() };
    let normal = Addressing::Normal;
    for (bytes, to, addressing, command) in [
        ("F3 4C 0C 01", Some(3), normal, Command::Hemisphere(Hemisphere::Upper.bytes())),
        ("72 00 20 00 00 00 C0", None, normal, Command::ReferenceFrame2([8192, 0, -16384])),
        ("50 32 03", None, normal, change(0x32, &[3])),
        ("50 07 4D 67", None, normal, change(7, &value::rate_word(103.3).to_le_bytes())),
        ("50 23 01", None, normal, change(0x23, &[1])),
        ("30 10", None, normal, Command::NextTransmitter { address: 1, number: 0 }),
        ("E4 42", Some(20), Addressing::Expanded, Command::Point),
        ("A0 64 4F 00", Some(100), Addressing::SuperExpanded, Command::Examine(0)),
    ] {
        assert_eq!(command.to_bytes(to, addressing), hex(bytes));
        let mut parser = CommandParser::new(addressing);
        let parsed: Vec<_> = hex(bytes).into_iter().filter_map(|byte| parser.push(byte)).collect();
        assert_eq!(parsed, [Ok(Addressed { to, command })]);
        assert!(!parser.is_open());
    }
}

#[test]
fn example_10_flock_status() {
    let [erc, bird, _] = [0xD1, 0xE0, 0xE0].map(UnitStatus);
    assert!(erc.has(UnitStatus::ACCESSIBLE | UnitStatus::RUNNING | UnitStatus::EXTENDED_RANGE));
    assert_eq!(erc.transmitter(), Some(0));
    assert!(!erc.has(UnitStatus::SENSOR));
    assert!(bird.has(UnitStatus::ACCESSIBLE | UnitStatus::RUNNING | UnitStatus::SENSOR));
    assert_eq!(bird.transmitter(), None);
}

#[test]
fn example_11_status_words() {
    let alone = BirdStatus::from_bytes([0x08, 0xD1]);
    assert_eq!(alone.0, 0xD108);
    assert!(
        alone.has(BirdStatus::MASTER | BirdStatus::INITIALISED | BirdStatus::RUNNING | BirdStatus::NO_SYNC)
    );
    assert!(!alone.has(BirdStatus::ASLEEP) && !alone.has(BirdStatus::STREAMING));
    assert_eq!(alone.format(), Some(Format::PositionAngles));
    let master = BirdStatus(0x8108);
    assert!(master.has(BirdStatus::MASTER) && !master.has(BirdStatus::INITIALISED));
    for format in Format::ALL {
        assert_eq!(alone.with_format(format).format(), Some(format));
    }
}

#[test]
fn examples_12_to_14_real_units() {
    let (p, a, r) = decode(
        "B2 09 05 79 51 7E 44 02 5E 48 69 5F 5B 3F 3E 7F 74 05 50 7A 5F 5F 00 37 00",
        shape(Format::PositionMatrix, true, false),
        Range::In36,
    );
    close(p.unwrap(), [5.282, -3.916, -0.769], 6e-4);
    assert_eq!(r.button, Some(0));
    let (_, b, _) = decode(
        "B2 09 05 79 50 7E 19 1F 5B 01 17 75 00",
        shape(Format::PositionAngles, true, false),
        Range::In36,
    );
    close(b.unwrap(), [87.737, 4.812, -30.432], 6e-4);
    close(a.unwrap(), b.unwrap(), 0.1);
    let (p, _, r) = decode(
        "96 13 3D 05 5E 02 53 06 2C 39 48 1B 47 01",
        shape(Format::PositionQuaternion, false, false),
        Range::In36,
    );
    close(p.unwrap(), [10.784, 3.081, 1.538], 6e-4);
    close(r.orientation_wxyz.unwrap(), [0.1039, -0.8961, -0.4308, -0.0243], 2e-4);
    let group = shape(Format::PositionAngles, true, true);
    let (p, a, _) = decode("D3 0F 38 05 63 00 31 13 3F 02 1D 03 00 01", group, Range::In36);
    close(p.unwrap(), [8.802, 3.059, 0.435], 6e-4);
    close(a.unwrap(), [54.514, 7.009, 9.075], 6e-4);
    let (p, a, _) = decode("8F 1D 30 7F 3A 72 7B 7E 1A 75 51 3A 00 02", group, Range::In36);
    close(p.unwrap(), [16.378, -0.352, -7.620], 6e-4);
    close(a.unwrap(), [-2.922, -30.366, 164.905], 6e-4);
}

#[test]
fn all_codes_survive() {
    for code in (i16::MIN..=i16::MAX).step_by(4) {
        let [low, high] = record::word_to_bytes(code);
        assert!(low < 0x80 && high < 0x80);
        assert_eq!(record::word_from_bytes(low, high), code);
    }
}

#[test]
fn measurement_rates() {
    assert_eq!(value::count_of_rate(103.3, 20), 5863);
    assert_eq!(value::count_of_rate(103.3, 25), 7329);
    assert_eq!(value::count_of_rate(103.3, 40), 11726);
    assert_eq!(value::count_of_rate(103.3, 0), 5863);
    assert!((value::rate_of_count_hz(5863, 20) - 103.3).abs() < 0.01);
    assert!((value::rate_hz(value::rate_word(103.3)) - 103.3).abs() < 1.0 / 256.0);
}

/// Those of the 3D Guidance sheet: words as a Flock's, behind a prefix for each sensor; the scaling is written as one byte.
#[test]
fn examples_of_3d_guidance_units() {
    let angles = shape(Format::PositionAngles, false, false);
    let (p, angles, _) = decode("E4 11 0E 77 39 04 55 0A 55 7A 00 20", angles, Range::In36);
    close(p.unwrap(), [10.002, -5.001, 2.5], 1e-3);
    close(angles.unwrap(), [29.993, -15.007, 90.0], 1e-3);
    let quaternion = shape(Format::PositionQuaternion, false, false);
    let (p, _, record) = decode("F2 08 47 7B 1C 02 00 20 00 20 00 60 00 20", quaternion, Range::In72);
    // A step of a word is 72 / 8192 inches.
    close(p.unwrap(), [10.002, -5.010, 2.496], 9.5e-3);
    // The vendor's sense is conjugated.
    close(record.orientation_wxyz.unwrap(), [0.5, -0.5, 0.5, -0.5], 1e-9);
    let change = |parameter, data: &[u8]| Command::Change { parameter, data: data.to_vec() };
    let rate = |hz| change(0x07, &value::rate_word(hz).to_le_bytes());
    let commands = [
        (Some(1), Command::Point, "F1 42"),
        (None, change(0x32, &[1]), "50 32 01"),
        (None, Command::Examine(0x03), "4F 03"),
        (None, rate(80.0), "50 07 00 50"),
        // 68.3 Hz, cut where we round.
        (None, change(0x07, &[0x4C, 0x44]), "50 07 4C 44"),
        (Some(3), Command::Examine(0x1A), "F3 4F 1A"),
        (Some(1), Command::Hemisphere(Hemisphere::Aft.bytes()), "F1 4C 00 01"),
        (None, change(0x03, &[1]), "50 03 01"),
    ];
    for (to, command, bytes) in commands {
        assert_eq!(command.to_bytes(to, Addressing::Normal), hex(bytes));
        let mut parser = CommandParser::default();
        parser.family = Family::Guidance;
        let parsed: Vec<_> = hex(bytes).into_iter().filter_map(|byte| parser.push(byte)).collect();
        assert_eq!(parsed, [Ok(Addressed { to, command })], "{bytes}");
    }
}

#[test]
fn what_is_no_rotation_is_refused() {
    let quaternion = shape(Format::Quaternion, false, false);
    let mut bytes = Vec::new();
    record::encode([0.0; 3], [1.0, 0.0, 0.0, 0.0], (0, 0), quaternion, Scale::default(), &mut bytes);
    assert!(record::decode(&bytes, quaternion, Scale::default(), Tolerance::LIVE).is_ok());
    bytes[3] ^= 0x08;
    let refused = record::decode(&bytes, quaternion, Scale::default(), Tolerance::LIVE);
    assert!(matches!(refused, Err(RecordError::NotARotation { .. })), "{refused:?}");
}

#[test]
fn a_parser_refuses_what_no_unit_knows() {
    let mut parser = CommandParser::default();
    let mut feed =
        |text: &str| -> Vec<_> { hex(text).into_iter().filter_map(|byte| parser.push(byte)).collect() };
    assert_eq!(feed("01"), [Err(Refused::UnknownCommand(1))]);
    assert_eq!(feed("4F 7E"), [Err(Refused::Parameter { parameter: 0x7E, change: false })]);
    assert_eq!(feed("F2 50 01"), [Err(Refused::Parameter { parameter: 1, change: true })]);
    assert_eq!(feed("42"), [Ok(Addressed { to: None, command: Command::Point })]);
}

fn any_shape() -> impl Strategy<Value = Shape> {
    (0usize..7, any::<bool>(), any::<bool>())
        .prop_map(|(i, button, group)| shape(Format::ALL[i], button, group))
}

fn any_range() -> impl Strategy<Value = Range> {
    prop_oneof![Just(Range::In36), Just(Range::In72), Just(Range::In144)]
}

fn any_rotation() -> impl Strategy<Value = [f64; 4]> {
    prop::array::uniform4(-1.0..1.0f64)
        .prop_filter("too short to normalise", |q| rotation::norm(*q) > 0.1)
        .prop_map(rotation::normalised)
}

fn any_command() -> impl Strategy<Value = Command> {
    let simple = prop::sample::select(vec![
        Command::Point,
        Command::Stream,
        Command::StreamStop,
        Command::ReportRate(ReportRate::Every8),
        Command::Run,
        Command::Sleep,
        Command::Boresight,
        Command::RemoveBoresight,
        Command::MetalError,
        Command::ButtonRead,
        Command::FbbReset,
        Command::Xon,
        Command::Xoff,
        Command::FactoryTest,
    ]);
    let change = (0..value::PARAMETERS.len(), prop::collection::vec(any::<u8>(), 126)).prop_filter_map(
        "read-only",
        |(i, mut data)| {
            let parameter = value::PARAMETERS[i];
            data.truncate(parameter.write_len(Addressing::Normal)?);
            Some(Command::Change { parameter: parameter.number, data })
        },
    );
    prop_oneof![
        simple,
        change,
        (0usize..7).prop_map(|i| Command::Format(Format::ALL[i])),
        any::<[u8; 2]>().prop_map(Command::Hemisphere),
        any::<[u8; 2]>().prop_map(Command::Metal),
        any::<[i16; 6]>().prop_map(Command::ReferenceFrame1),
        any::<[i16; 6]>().prop_map(Command::AngleAlign1),
        any::<[i16; 3]>().prop_map(Command::ReferenceFrame2),
        any::<[i16; 3]>().prop_map(Command::AngleAlign2),
        any::<[i16; 3]>().prop_map(Command::Offset),
        any::<bool>().prop_map(Command::ButtonMode),
        any::<u8>().prop_map(Command::Sync),
        (0u8..16, 0u8..4).prop_map(|(address, number)| Command::NextTransmitter { address, number }),
        (0..value::PARAMETERS.len()).prop_map(|i| Command::Examine(value::PARAMETERS[i].number)),
        (any::<bool>(), any::<u16>()).prop_map(|(prom, address)| Command::ReadMemory { prom, address }),
        (0x80u8..=0x90).prop_map(Command::FactoryWord),
    ]
}

proptest! {
    #[test]
    fn words_come_back(words in any::<[i16; 12]>(), shape in any_shape(), button in 0u8..128, address in 0u8..127) {
        let mut bytes = Vec::new();
        record::encode_words(&words, button, address, shape, &mut bytes);
        prop_assert_eq!(bytes.len(), shape.len());
        let decoded = record::words(&bytes, shape).unwrap();
        for i in 0..shape.format.words() {
            prop_assert_eq!(decoded[i], words[i] & !3);
        }
    }

    /// One count is 4 units of 1/32768 of full scale.
    #[test]
    fn poses_come_back_within_a_count(
        p in prop::array::uniform3(-0.999..0.999f64),
        q in any_rotation(),
        shape in any_shape(),
        range in any_range(),
        direct in any::<bool>(),
        tail in (0u8..128, 0u8..127),
    ) {
        let quaternion_sense = if direct { QuaternionSense::Direct } else { QuaternionSense::Vendor };
        let scale = Scale { range, quaternion_sense };
        let p = p.map(|c| c * range.metres());
        let mut bytes = Vec::new();
        record::encode(p, q, tail, shape, scale, &mut bytes);
        let decoded = record::decode(&bytes, shape, scale, Tolerance::LIVE).unwrap();
        let count = 4.0 / 32768.0;
        if let Some(got) = decoded.position_m {
            for i in 0..3 {
                prop_assert!((got[i] - p[i]).abs() <= count * range.metres(), "{:?} {:?}", got, p);
            }
        }
        if let Some(got) = decoded.orientation_wxyz {
            let dot: f64 = (0..4).map(|i| got[i] * q[i]).sum();
            let angle = 2.0 * libm::asin((1.0 - dot * dot).max(0.0).sqrt());
            // Three angles of one count (pi / 8192) each, or words of a quaternion or a matrix.
            let bound = if matches!(shape.format, Format::Angles | Format::PositionAngles) { 3.0 * count * std::f64::consts::PI } else { 8.0 * count };
            prop_assert!(angle <= bound, "{} rad", angle);
        }
        prop_assert_eq!(decoded.button, shape.button.then_some(tail.0));
        prop_assert_eq!(decoded.address, shape.group.then_some(tail.1));
    }

    #[test]
    fn commands_come_back_however_cut(
        commands in prop::collection::vec((any_command(), prop::option::of(0u8..127)), 1..20),
        mode in 0usize..3,
    ) {
        let addressing = [Addressing::Normal, Addressing::Expanded, Addressing::SuperExpanded][mode];
        let mut parser = CommandParser::new(addressing);
        for (command, to) in commands {
            if matches!(command, Command::Change { parameter: 0x21 | 0x22, .. }) {
                continue; // The two whose length depends on the addressing.
            }
            let to = to.map(|address| address % (addressing.max_address() + 1));
            let parsed: Vec<_> =
                command.to_bytes(to, addressing).into_iter().filter_map(|byte| parser.push(byte)).collect();
            prop_assert_eq!(parsed, [Ok(Addressed { to, command })]);
        }
    }

    #[test]
    fn garbage_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200), shape in any_shape()) {
        let mut parser = CommandParser::default();
        for &byte in &bytes {
            parser.push(byte);
        }
        let _ = record::decode(&bytes, shape, Scale::default(), Tolerance::LIVE);
    }
}
