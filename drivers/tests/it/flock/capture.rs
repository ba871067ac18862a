//! Captures of real units, and captures made here to know every byte.

use posed_drivers::flock::capture::{CaptureError, Decoded, Options, decode};
use posed_drivers::flock::wire::{Format, Range, Scale, Shape, record, rotation};

/// A session with real units.
fn real(name: &str) -> Decoded {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/recordings/flock-of-birds");
    decode(&std::fs::read(folder.join(name)).unwrap(), Options::default()).unwrap()
}

fn degrees(decoded: &Decoded, i: usize) -> [f64; 3] {
    rotation::to_angles(decoded.records[i].record.orientation_wxyz.unwrap()).map(f64::to_degrees)
}

fn inches(decoded: &Decoded, i: usize) -> [f64; 3] {
    decoded.records[i].record.position_m.unwrap().map(|c| c / 0.0254)
}

fn close(got: [f64; 3], expected: [f64; 3], tolerance: f64) {
    assert!(got.iter().zip(expected).all(|(g, e)| (g - e).abs() <= tolerance), "{got:?} is not {expected:?}");
}

#[test]
fn a_polled_stand_alone_unit() {
    let decoded = real("flockofbirds_stream_03_21_2006.txt");
    assert_eq!(decoded.summary.records, 10);
    assert_eq!(decoded.summary.answers, 3);
    assert_eq!((decoded.summary.rejected, decoded.summary.bytes_skipped), (0, 0));
    let first = &decoded.records[0];
    assert_eq!(first.t.as_deref(), Some("24431916642.108955"));
    assert_eq!((first.address, first.format), (0, Format::PositionQuaternion));
    close(inches(&decoded, 0), [10.784, 3.081, 1.538], 6e-4);
    assert!(decoded.warnings.is_empty(), "{:?}", decoded.warnings);
}

#[test]
fn two_streaming_birds() {
    let decoded = real("flockofbirds_stream_06_06_2006.txt");
    assert_eq!((decoded.summary.rejected, decoded.summary.bytes_skipped), (0, 0));
    assert_eq!(decoded.summary.answers, 13);
    assert_eq!(decoded.summary.records, 22);
    let formats: Vec<_> = decoded.records.iter().map(|r| (r.format, r.record.button)).collect();
    assert_eq!(formats[0], (Format::PositionMatrix, Some(0x70)));
    assert_eq!(formats[1], (Format::PositionMatrix, Some(0)));
    assert!(formats[2..].iter().all(|&format| format == (Format::PositionAngles, Some(0))));
    assert_eq!(decoded.records.iter().map(|r| r.address).collect::<Vec<_>>(), [1, 2].repeat(11));
    assert_eq!(decoded.records[2].t.as_deref(), Some("24438598969.224308"));
    close(inches(&decoded, 2), [8.802, 3.059, 0.435], 6e-4);
    close(degrees(&decoded, 2), [54.514, 7.009, 9.075], 1e-3);
    close(inches(&decoded, 3), [16.378, -0.352, -7.620], 6e-4);
    close(degrees(&decoded, 3), [-2.922, -30.366, 164.905], 1e-3);
}

fn escaped(bytes: &[u8]) -> String {
    bytes
        .iter()
        .map(|&byte| match byte {
            0x20..=0x7E => char::from(byte).to_string(),
            _ => format!("\\x{byte:02X}"),
        })
        .collect()
}

#[derive(Default)]
struct Log(String);

impl Log {
    fn line(&mut self, word: &str, bytes: &[u8]) {
        let n = self.0.lines().count();
        self.0 += &format!("{n}.5 : (INFO) {n}. {word}[{}] {}\n", bytes.len(), escaped(bytes));
    }
    fn host(&mut self, bytes: &[u8]) {
        self.line("command", bytes);
    }
    fn unit(&mut self, bytes: &[u8]) {
        self.line("receive", bytes);
    }
    fn decode(&self) -> Decoded {
        decode(self.0.as_bytes(), Options::default()).unwrap()
    }
}

fn pose(format: Format, button: Option<u8>, address: Option<u8>, range: Range, i: usize) -> Vec<u8> {
    let shape = Shape { format, button: button.is_some(), group: address.is_some() };
    let t = i as f64;
    let q = rotation::from_angles([0.01 * t, 0.2, -0.4]);
    let mut bytes = Vec::new();
    let tail = (button.unwrap_or(0), address.unwrap_or(0));
    let scale = Scale { range, ..Scale::default() };
    record::encode([0.3, 0.01 * t, -0.2], q, tail, shape, scale, &mut bytes);
    bytes
}

#[test]
fn a_session_with_every_turn_a_host_can_take() {
    let mut log = Log::default();
    // The format is known from the status word; a question of an unknown parameter is never answered.
    log.host(b"O\x00");
    log.unit(&[0x08, 0xD1]);
    log.host(b"O\x7E");
    log.host(b"O\x12");
    log.host(b"O\x03");
    log.unit(&[0x01, 0x00]);
    log.host(b"B");
    log.unit(&pose(Format::PositionAngles, None, None, Range::In72, 0));
    // A record cut in two lines, two records in one line, a quaternion command (a lone backslash).
    log.host(b"\\");
    log.host(b"@");
    let (a, b) = (
        pose(Format::Quaternion, None, None, Range::In72, 1),
        pose(Format::Quaternion, None, None, Range::In72, 2),
    );
    log.unit(&a[..3]);
    log.unit(&a[3..]);
    log.unit(&[b.clone(), a.clone()].concat());
    // A question during the stream; its answer stands between two records.
    log.host(b"O\x01");
    log.unit(&[b.clone(), vec![0x03, 0x43], a.clone()].concat());
    // A damaged record, then buttons on.
    log.unit(&b[..7]);
    log.host(b"M\x01");
    log.unit(&pose(Format::Quaternion, Some(0x10), None, Range::In72, 3));
    let decoded = log.decode();
    assert_eq!(decoded.summary.answers, 3);
    assert_eq!(decoded.summary.records, 7);
    assert_eq!((decoded.summary.rejected, decoded.summary.bytes_skipped), (1, 7));
    assert_eq!(decoded.records.last().unwrap().record.button, Some(0x10));
    let x = decoded.records[0].record.position_m.unwrap()[0];
    assert!((x - 0.3).abs() < 1e-3, "the range is 72 inches: {x}");
}

#[test]
fn a_flock_of_mixed_formats_behind_an_extended_range_controller() {
    let mut log = Log::default();
    log.host(b"O$");
    log.unit(&[[0xD1, 0xE0, 0xE0].as_slice(), &[0; 11]].concat());
    log.host(b"P#\x01");
    log.host(&[0xF2, b'Z']);
    log.host(&[0xF3, b']', 0xF3, b'M', 1]);
    log.host(b"@");
    for i in 0..5 {
        let two = pose(Format::PositionMatrix, None, Some(2), Range::In144, i);
        let three = pose(Format::PositionQuaternion, Some(0x70), Some(3), Range::In144, i);
        log.unit(&[two, three].concat());
    }
    let decoded = log.decode();
    assert_eq!((decoded.summary.records, decoded.summary.rejected, decoded.summary.answers), (10, 0, 1));
    assert_eq!(decoded.records[1].record.button, Some(0x70));
    let x = decoded.records[9].record.position_m.unwrap()[0];
    assert!((x - 0.3).abs() < 1e-3, "the range is 144 inches: {x}");
}

#[test]
fn raw_bytes_say_themselves_what_they_are() {
    for format in Format::ALL {
        for (button, address) in [(None, None), (None, Some(2)), (Some(0x10), Some(1)), (Some(0), None)] {
            let file: Vec<u8> = (0..40).flat_map(|i| pose(format, button, address, Range::In36, i)).collect();
            let named = Options { format: Some(format), ..Options::default() };
            for options in [Options::default(), named] {
                let decoded = decode(&file, options).unwrap();
                assert_eq!(decoded.summary.records, 40, "{format} {button:?} {address:?}");
                let right = decoded.records.iter().all(|r| r.format == format && r.record.button == button);
                assert!(right || !decoded.warnings.is_empty(), "{format} {button:?} {address:?}");
            }
        }
    }
}

#[test]
fn what_is_no_capture_is_refused() {
    assert_eq!(decode(b"", Options::default()), Err(CaptureError::Empty));
    assert_eq!(decode(b"hello, world\n", Options::default()), Err(CaptureError::NoRecords));
    let error = decode(b"1.0 : (INFO) 1. receive[3] ab\n", Options::default()).unwrap_err();
    assert!(error.to_string().starts_with("line 1"), "{error}");
}

#[test]
fn a_status_between_two_records_costs_neither() {
    let mut log = Log::default();
    log.host(b"Y");
    log.host(b"M\x00");
    log.host(b"@");
    let record = |i| pose(Format::PositionAngles, None, None, Range::In36, i);
    for i in 0..5 {
        log.unit(&record(i));
    }
    let cut = record(5);
    log.unit(&cut[..4]);
    log.host(b"O\x00");
    log.unit(&[&cut[4..], &[0x09, 0xD1], &record(6)].concat());
    log.unit(&record(7));
    let decoded = log.decode();
    assert_eq!((decoded.summary.records, decoded.summary.answers), (8, 1), "{:?}", decoded.summary);
}

#[test]
fn a_damaged_record_does_not_end_in_an_answer() {
    let mut log = Log::default();
    for command in [b"]".as_slice(), b"M\x00", b"@"] {
        log.host(command);
    }
    let record = |i| pose(Format::PositionQuaternion, None, None, Range::In36, i);
    for i in 0..5 {
        log.unit(&record(i));
    }
    log.host(b"O\x00");
    let mut damaged = record(5);
    damaged.remove(4);
    log.unit(&[&damaged[..], &[0x11, 0xD1], &record(6)].concat());
    for i in 7..20 {
        log.unit(&record(i));
    }
    let decoded = log.decode();
    // The one behind the answer follows two first bytes in a row, of which one is not true.
    assert_eq!(decoded.summary.records, 18, "{:?}", decoded.summary);
}
