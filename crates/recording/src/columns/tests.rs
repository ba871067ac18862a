use std::collections::BTreeMap;

use proptest::prelude::*;
use serde::Deserialize;

use super::*;
use crate::testing::STAGE;
use posed_protocol::{Fields, Publisher};
use posed_stage::output::{Inertial, Measured, Outcome, OutcomeKind, PoseEstimate};

/// A part as a reader finds it.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Found {
    of: String,
    names: Vec<String>,
    imus: Vec<String>,
    states: Vec<String>,
    rows: usize,
    width: usize,
    values: serde_bytes_like::Bytes,
    messages: Vec<String>,
}

mod serde_bytes_like {
    use serde::{Deserialize, Deserializer, de};

    #[derive(Debug, Default)]
    pub(super) struct Bytes(pub(super) Vec<u8>);

    impl<'de> Deserialize<'de> for Bytes {
        fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
            struct Visitor;
            impl de::Visitor<'_> for Visitor {
                type Value = Bytes;
                fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                    f.write_str("bytes")
                }
                fn visit_bytes<E>(self, bytes: &[u8]) -> Result<Bytes, E> {
                    Ok(Bytes(bytes.to_vec()))
                }
            }
            deserializer.deserialize_bytes(Visitor)
        }
    }
}

fn unpacked(rows: usize, width: usize, bytes: &[u8]) -> Vec<Vec<i32>> {
    let plane = rows * width;
    assert_eq!(bytes.len(), 4 * plane);
    let number = |at: usize| i32::from_le_bytes(std::array::from_fn(|byte| bytes[byte * plane + at]));
    let mut columns = vec![Vec::new(); width];
    for (at, column) in columns.iter_mut().enumerate() {
        let mut before = 0_i32;
        for row in 0..rows {
            let packed = number(at * rows + row).cast_unsigned();
            before = before.wrapping_add((packed >> 1).cast_signed() ^ -(packed & 1).cast_signed());
            column.push(before);
        }
    }
    (0..rows).map(|row| columns.iter().map(|column| column[row]).collect()).collect()
}

fn parts(block: &Block) -> Vec<Found> {
    let mut parts = Vec::new();
    block
        .each_message(|message| {
            parts.push(rmp_serde::from_slice(message)?);
            Ok::<(), Box<dyn std::error::Error>>(())
        })
        .unwrap_or_else(|error| panic!("{error}"));
    parts
}

fn estimate(t_s: f64, sensors: Vec<SensorEstimate>) -> Estimate {
    Estimate { t_valid: Timestamp::from_secs_f64(t_s), sensors, ..Estimate::default() }
}

fn posed() -> SensorEstimate {
    let pose = PoseEstimate {
        position_m: Some([0.123_456, -2.0, 1e9]),
        orientation_wxyz: [0.5, -0.5, 0.5, f64::NAN],
        velocity_m_s: None,
        angular_velocity_rad_s: [0.000_06, 0.0, -1.0],
        covariance: [0.0; 21],
        sigma_m: Some(1e-3),
    };
    SensorEstimate { state: SensorState::Extrapolated, pose: Some(pose), ..SensorEstimate::default() }
}

#[test]
fn a_row_has_the_numbers_of_the_message_and_what_is_not_known_is_said() {
    let stage = Stage::parse(STAGE).unwrap();
    let mut publisher = Publisher::new(&stage, Fields::all());
    let mut columns = Columns::new(&stage);
    let shown = estimate(1.234_567_8, vec![posed(), SensorEstimate::default()]);
    let payload = Payload::Estimate(&shown);
    assert!(columns.publish(&payload, &publisher.skip(&payload)).is_none());
    let [sensors, end] = &parts(&columns.finish())[..] else { panic!("sensors and the end") };
    assert_eq!((sensors.of.as_str(), end.of.as_str()), ("sensors", "end"));
    assert_eq!((&sensors.names[..], sensors.imus.len()), (&["left".to_owned(), "right".to_owned()][..], 0));
    let rows = unpacked(sensors.rows, sensors.width, &sensors.values.0);
    let none = i32::MIN;
    let [row] = &rows[..] else { panic!("one row") };
    assert_eq!(row[..5], [1, 234_568, none, none, none]);
    assert_eq!(sensors.states[row[5] as usize], "extrapolated");
    // A number that is too large is the largest, and NaN is none.
    assert_eq!(row[6..13], [12_346, -200_000, i32::MAX, 500_000, -500_000, 500_000, none]);
    assert_eq!(row[13..20], [1000, none, none, none, 1, 0, -10_000]);
    assert_eq!(sensors.states[row[20] as usize], "missing");
    assert!(row[21..].iter().all(|number| *number == none) && row.len() == 5 + 2 * 15);
}

#[test]
fn every_state_is_found_by_its_number() {
    for (at, state) in SENSOR_STATES.into_iter().enumerate() {
        assert_eq!(state as usize, at);
    }
    for (at, state) in SEGMENT_STATES.into_iter().enumerate() {
        assert_eq!(state as usize, at);
    }
}

#[test]
fn an_imu_s_record_is_there_where_the_frame_has_one() {
    let text = "name = \"imus\"\n[[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"/dev/null\"\n\
                [[sensor]]\nname = \"imu\"\ndevice = \"chain\"\naddress = 1\n";
    let stage = Stage::parse(text).unwrap();
    let mut publisher = Publisher::new(&stage, Fields::all());
    let mut columns = Columns::new(&stage);
    let measured = |gyro: Option<[f64; 3]>| Measured {
        t_valid: Timestamp::from_secs_f64(2.5),
        inertial: Some(Inertial {
            angular_velocity_rad_s: gyro,
            specific_force_m_s2: Some([0.0, 0.0, 9.81]),
            ..Inertial::default()
        }),
        position_m: None,
        orientation_wxyz: None,
        button: None,
        clipped: false,
    };
    for record in [None, Some(measured(Some([1.0, 2.0, 3.0]))), Some(measured(None))] {
        let imu = SensorEstimate { measured: record, ..SensorEstimate::default() };
        let shown = estimate(2.0, vec![imu]);
        let payload = Payload::Estimate(&shown);
        columns.publish(&payload, &publisher.skip(&payload));
    }
    let parts = parts(&columns.finish());
    assert_eq!(parts[0].imus, ["imu"]);
    let rows = unpacked(parts[0].rows, parts[0].width, &parts[0].values.0);
    let there: Vec<_> = rows.iter().map(|row| row[20]).collect();
    assert_eq!(there, [0, 1, 0]);
    let none = i32::MIN;
    let record = [2, 500_000, 1_000_000, 2_000_000, 3_000_000, 0, 0, 9_810_000, none, none, none];
    assert_eq!((&rows[0][21..], &rows[1][21..], &rows[2][21..]), (&[none; 11][..], &record[..], &record[..]));
}

#[test]
fn blocks_end_by_time_and_by_size_and_hold_every_row_and_event_once() {
    let stage = Stage::parse(STAGE).unwrap();
    let mut publisher = Publisher::new(&stage, Fields::all());
    let mut columns = Columns::new(&stage);
    let mut blocks = Vec::new();
    let mut give = |payload: &Payload<'_>| blocks.extend(columns.publish(payload, &publisher.skip(payload)));
    // A hundred seconds at 100 Hz, and then faster than any device.
    for frame in 0..20_000 {
        let t_s = if frame < 10_000 { f64::from(frame) * 0.01 } else { 100.0 + f64::from(frame) * 1e-5 };
        give(&Payload::Estimate(&estimate(t_s, vec![posed(), posed()])));
        if frame % 1000 == 0 {
            let t = Timestamp::from_secs_f64(t_s);
            let what = OutcomeKind::Mark { label: format!("{frame} \"quoted\"") };
            give(&Payload::Outcome(&Outcome { t_valid: t, t_decided: t, what }));
        }
    }
    blocks.push(columns.finish());
    let mut seen = BTreeMap::<_, Vec<usize>>::new();
    let mut marks = Vec::new();
    for block in &blocks {
        assert!(block.size() < 3 << 20);
        for part in parts(block) {
            seen.entry(part.of).or_default().push(part.rows);
            marks.extend(part.messages);
        }
    }
    assert_eq!(seen["sensors"].iter().sum::<usize>(), 20_000);
    assert_eq!(seen["sensors"][0], 1001, "ten seconds");
    assert!(
        seen["sensors"].iter().any(|rows| (7400..7500).contains(rows)),
        "{:?}: a mebibyte",
        seen["sensors"]
    );
    assert_eq!((marks.len(), seen["end"].len(), blocks.last().unwrap().is_last), (20, 1, true));
    let mark: serde_json::Value = serde_json::from_str(&marks[1]).unwrap();
    assert_eq!(
        (&mark["type"], &mark["event_id"], &mark["label"]),
        (&"marks".into(), &2.into(), &"1000 \"quoted\"".into())
    );
    assert!(mark.get("seq").is_none());
}

proptest! {
    #[test]
    fn what_is_packed_comes_back(width in 1..5_usize, numbers in prop::collection::vec(prop::num::i32::ANY, 0..200)) {
        let rows = numbers.len() / width;
        let mut table = Rows::default();
        for row in numbers.chunks_exact(width) {
            row.iter().for_each(|number| table.push(*number));
            table.end();
        }
        let expected: Vec<_> = numbers.chunks_exact(width).map(<[i32]>::to_vec).collect();
        let packed = table.table::<SensorState>(&[]);
        prop_assert_eq!(packed.as_ref().map(|table| (table.rows, table.width)), (rows > 0).then_some((rows, width)));
        let found = packed.map(|table| unpacked(table.rows, table.width, &table.values));
        prop_assert_eq!(found.unwrap_or_default(), expected);
    }
}
