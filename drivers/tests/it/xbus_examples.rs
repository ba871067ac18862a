//! Worked examples of the Xbus protocol.

use posed_drivers::rate::Rate;
use posed_drivers::xbus::capture::{self, Record};
use posed_drivers::xbus::frame::{Frame, Framer};
use posed_drivers::xbus::message::{self, Configuration, Tracker};
use posed_drivers::xbus::mtdata::{Block, Layout, Orientation};

use super::hex;

const CONFIGURATION_X13: &str = "
    FA FF 0D 8A 00 10 00 21 04 80 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00
    00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00
    00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00
    00 00 00 00 00 02 00 32 03 E9 00 34 00 06 00 00 00 00 00 00 02 04 00 00 00 00 00 32 03 EA 00 34
    00 06 00 00 00 00 00 00 02 04 00 00 00 00 F6";

fn decode(bytes: &[u8]) -> Vec<Record> {
    let mut records = Vec::new();
    capture::decode(bytes, |record| records.push(record));
    records
}

/// The data of the only message in `bytes`.
fn data(bytes: &[u8]) -> (u8, u8, Vec<u8>) {
    let mut framer = Framer::default();
    framer.push(bytes);
    let found = framer.find().unwrap();
    assert_eq!(found.len, bytes.len());
    let frame = framer.frame(found);
    assert_eq!(frame.encode(), bytes);
    (frame.bid, frame.mid, frame.data.to_vec())
}

fn configured(trackers: &[Layout], master_id: u64) -> Vec<u8> {
    let configuration = Configuration {
        master_id,
        period_ticks: 1152,
        skip_factor: 0,
        trackers: trackers
            .iter()
            .map(|&layout| Tracker { device_id: 0x0032_03E9, data_len: layout.block_len() as u16, layout })
            .collect(),
    };
    message::request(0xFF, message::CONFIGURATION, &configuration.encode())
}

const CHAIN: u64 = 0x0010_0021;
const LONE: u64 = 0x0032_03E9;

#[test]
fn commands_and_their_answers() {
    for (text, bid, mid, contents) in [
        ("FA FF 30 00 D1", 0xFF, 0x30, ""),
        ("FA FF 31 00 D0", 0xFF, 0x31, ""),
        ("FA FF 04 02 09 00 F2", 0xFF, 0x04, "09 00"),
        (
            "FA FF 03 0C 00 32 03 E9 00 32 03 EA 00 32 03 EB 95",
            0xFF,
            0x03,
            "00 32 03 E9 00 32 03 EA 00 32 03 EB",
        ),
        ("FA 02 D0 02 00 06 26", 2, 0xD0, "00 06"),
        ("FA 02 D1 00 2D", 2, 0xD1, ""),
        ("FA FF 42 02 1D 03 9D", 0xFF, 0x42, "1D 03"),
        ("FA FF 42 01 04 BA", 0xFF, 0x42, "04"),
    ] {
        assert_eq!(data(&hex(text)), (bid, mid, hex(contents)), "{text}");
    }
    let (_, mid, list) = data(&hex(
        "FA FF C0 1C 10 20 FF FF 10 60 FF FF 20 10 00 64 40 20 00 64 80 20 00 64 C0 20 00 64 E0 20 FF FF EB",
    ));
    assert_eq!(mid, message::OUTPUT_CONFIGURATION);
    assert_eq!(
        message::output_configuration(&list).unwrap(),
        [(4128, 65535), (4192, 65535), (8208, 100), (16416, 100), (32800, 100), (49184, 100), (57376, 65535)]
    );
}

#[test]
fn configuration_of_a_master_with_two_trackers() {
    let (_, _, contents) = data(&hex(CONFIGURATION_X13));
    let configuration = Configuration::parse(&contents).unwrap();
    assert_eq!((configuration.master_id, configuration.period_ticks), (0x0010_0021, 1152));
    let tracker = |device_id| Tracker { device_id, data_len: 52, layout: Layout { mode: 6, settings: 0 } };
    assert_eq!(configuration.trackers, [tracker(0x0032_03E9), tracker(0x0032_03EA)]);
    assert!(configuration.trackers.iter().all(|tracker| tracker.layout.block_len() == 52));
    assert!(configuration.is_chain());
    assert_eq!(configuration.rate().map(Rate::hz), Ok(100.0));
}

#[test]
fn legacy_message_of_a_lone_tracker() {
    let mut bytes = configured(&[Layout { mode: 2, settings: 1 }], LONE);
    bytes.extend(hex(
        "FA FF 32 26 3E 80 00 00 BF 00 00 00 41 1D 00 00 3C 80 00 00 BD 00 00 00 3D 80 00 00 3F 00 00 00 BE 80 00 00
         3F 40 00 00 02 01 99",
    ));
    let items = &decode(&bytes)[1].items;
    assert_eq!(items.acceleration, Some([0.25, -0.5, 9.8125]));
    assert_eq!(items.rate_of_turn, Some([0.015625, -0.03125, 0.0625]));
    assert_eq!(items.magnetic_field, Some([0.5, -0.25, 0.75]));
    assert_eq!(items.packet_counter, Some(513));

    let mut bytes = configured(&[Layout { mode: 4, settings: 0x105 }], LONE);
    bytes.extend(hex("FA FF 32 0E 0B 40 00 00 FD 28 00 00 00 00 00 01 FF FE 53"));
    let items = &decode(&bytes)[1].items;
    assert_eq!(items.euler_deg, Some([180.0, -45.5, 1.0 / 1_048_576.0]));
    assert_eq!(items.packet_counter, Some(65534));
}

#[test]
fn message_of_a_chain() {
    let layout = Layout { mode: 4, settings: 0 };
    let mut bytes = configured(&[layout, layout], CHAIN);
    bytes.extend(hex(
        "FA FF 32 22 12 34 3F 80 00 00 00 00 00 00 00 00 00 00 00 00 00 00 3F 00 00 00 3F 00 00 00 BF 00 00 00 3F 00 00
         00 2C",
    ));
    let records = decode(&bytes);
    assert_eq!((records[1].bid, records[2].bid), (1, 2));
    assert_eq!((records[0].tracker(), records[2].tracker()), (None, Some(2)));
    assert_eq!(records[1].items.quaternion, Some([1.0, 0.0, 0.0, 0.0]));
    assert_eq!(records[2].items.quaternion, Some([0.5, 0.5, -0.5, 0.5]));
    assert!(records[1..].iter().all(|record| record.items.packet_counter == Some(0x1234)));

    // Without its configuration a message keeps its bytes, and nobody guesses what they mean.
    let unknown = decode(&bytes[configured(&[layout, layout], CHAIN).len()..]);
    assert_eq!(unknown.len(), 1);
    assert_eq!(unknown[0].items, capture::Items::default());
    assert!(unknown[0].data.as_deref().unwrap().starts_with("12343F80"));
}

#[test]
fn message_of_a_chain_beyond_254_bytes() {
    let layout = Layout { mode: 2, settings: 0 };
    let mut contents = vec![0xFF, 0xFF];
    for k in 1..=8 {
        let value = |j: i32| f64::from(k) + f64::from(j) / 16.0;
        let block = Block {
            acceleration: Some([value(0), value(1), value(2)]),
            rate_of_turn: Some([value(3), value(4), value(5)]),
            magnetic_field: Some([value(6), value(7), value(8)]),
            ..Block::default()
        };
        layout.encode(&block, &mut contents);
    }
    let message = Frame { bid: 0xFF, mid: message::MTDATA, data: &contents }.encode();
    assert_eq!(message.len(), 297);
    assert_eq!(message[..14], hex("FA FF 32 FF 01 22 FF FF 3F 80 00 00 3F 88")[..]);
    assert_eq!(message[290..], hex("00 00 41 08 00 00 AB")[..]);
    let records = decode(&[configured(&[layout; 8], CHAIN), message].concat());
    assert_eq!(records.len(), 9);
    assert_eq!(records[8].items.magnetic_field, Some([8.375, 8.4375, 8.5]));
    assert_eq!(records[8].items.packet_counter, Some(65535));
}

#[test]
fn items_in_fixed_point_and_other_axes() {
    let records = decode(&hex(
        "FA FF 36 3D 10 20 02 00 07 10 60 04 00 00 03 E8 20 16 18 80 00 00 00 00 00 80 00 00 00 FF FF 40 00 00 00 00 00 00
         00 00 00 FF FF 40 21 0C 00 00 00 00 FF 63 00 00 00 18 00 00 E0 80 04 00 32 03 EB 01",
    ));
    let items = &records[0].items;
    assert_eq!((items.packet_counter, items.sample_time_fine), (Some(7), Some(1000)));
    assert_eq!(items.quaternion, Some([0.5, -0.5, 0.25, -1.0]));
    assert_eq!(items.acceleration, Some([0.0, -9.8125, 1.5]));
    let json = serde_json::to_value(items).unwrap();
    assert_eq!(json["axes"], "ned");
    assert_eq!(json["other"][0], serde_json::json!({"id": "E080", "name": "device_id", "data": "003203EB"}));
}

#[test]
fn a_matrix_travels_column_by_column_in_mtdata2() {
    let mut contents = Vec::new();
    posed_drivers::xbus::mtdata2::encode_numbers(
        0x2023,
        &[0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        &mut contents,
    );
    let records = decode(&message::request(0xFF, message::MTDATA2, &contents));
    // The first column, (0, 1, 0), is where the sensor's x axis points: a quarter turn about z.
    assert_eq!(records[0].items.rotation_matrix, Some([0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]));
    assert_eq!(Layout { mode: 4, settings: 8 }.block_len(), 36);
    assert!(matches!(
        Layout { mode: 4, settings: 8 }.decode(&[0; 36]).unwrap().orientation,
        Some(Orientation::Matrix(_))
    ));
}

/// A record of two trackers whose data hold a whole message with a right sum (as seen in a simulated walk).
#[test]
fn a_record_that_holds_the_picture_of_a_message_is_a_record() {
    let record = hex(
        "FA FF 32 6A 03 B9 BC 3E 57 8E 41 07 33 62 3F B2 FA 12 C0 10 AD 5D 3D 64 E2 E3 BE C5 1C C4 BE F7 CA 9E BF 60 0F 61 BD
         53 B7 20 BE E8 8C FC BE BA D7 70 3F 00 39 13 3F 23 DA 1C 40 72 BD 9C BF F5 63 C3 C1 18 77 85 BD FC AD B7 BE DD DA 5E
         3C 1A 56 81 3C EE 80 5F 3E F8 5D 48 3F 5F 37 88 BE BA A5 CF 3F 25 B0 F3 3F 2B 62 7D BB 19 3A 77 11",
    );
    let plain = Frame { bid: 0xFF, mid: 0x32, data: &[0; 106] }.encode();
    let mut framer = Framer::default();
    let mut offsets = Vec::new();
    for byte in [&plain[..], &record, &plain, &plain[..60], &plain, &plain].concat() {
        framer.push(&[byte]);
        offsets.extend(std::iter::from_fn(|| framer.find()).map(|found| found.offset));
    }
    // Of one that is cut off nothing is left, and it costs no other.
    assert_eq!(offsets, [0, 111, 222, 333 + 60, 333 + 60 + 111]);
}
