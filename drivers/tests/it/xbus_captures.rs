//! Real MTi recordings against the values published with them.

use std::path::PathBuf;

use posed_drivers::xbus::capture::{self, Items, Record, Summary};

fn recordings() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../tests/recordings/xbus")
}

fn decode(bytes: &[u8]) -> (Vec<Record>, Summary) {
    let mut records = Vec::new();
    let summary = capture::decode(bytes, |record| records.push(record));
    (records, summary)
}

/// Follows one block of the golden text through `items`; returns how many values it compared.
fn compare(block: &str, items: &Items) -> usize {
    let mut compared = 0;
    let mut title = "";
    let mut index = 0;
    for line in block.lines() {
        if !line.starts_with(' ') {
            title = line.trim_end_matches(':');
            index = 0;
            continue;
        }
        let text = line.trim();
        let (label, number) = text.split_once(':').unwrap_or(("", text));
        let triple = |values: Option<[f64; 3]>| values.expect(title)[index];
        let number = || number.parse::<f64>().unwrap();
        let kind = title.split('(').next().unwrap();
        match kind {
            "PacketCounter" => assert_eq!(items.packet_counter, Some(text.parse().unwrap())),
            "SampleTimeFine" => assert_eq!(items.sample_time_fine, Some(text.parse().unwrap())),
            "UTCTime" => assert_eq!(items.utc.as_deref(), Some(text)),
            "StatusWord" => assert_eq!(items.status_word, Some(u32::from_str_radix(text, 2).unwrap())),
            "StatusByte" => assert_eq!(items.status_byte, Some(u8::from_str_radix(text, 2).unwrap())),
            "EulerAngles" => assert_eq!(triple(items.euler_deg), number()),
            "Acceleration" => assert_eq!(triple(items.acceleration), number()),
            "DeltaV" => assert_eq!(triple(items.delta_v), number()),
            "RateOfTurn" => assert_eq!(triple(items.rate_of_turn), number()),
            "VelocityXYZ" => assert_eq!(triple(items.velocity), number()),
            "DeltaQ" => assert_eq!(items.delta_q.unwrap()[index], number()),
            "LatLon" => assert_eq!(items.lat_lon_deg.unwrap()[index], number()),
            "AltitudeEllipsoid" => assert_eq!(items.altitude_m, Some(text.parse().unwrap())),
            "GNSSPVTData" => {
                // The fields travel in this order, and the text names all of them.
                let pvt = serde_json::to_value(items.gnss_pvt.unwrap()).unwrap();
                let field = match label {
                    "ITOW" => "itow_ms",
                    "Year" => "year",
                    "Month" => "month",
                    "Day" => "day",
                    "Hour" => "hour",
                    "Min" => "min",
                    "Sec" => "sec",
                    "Valid" => "valid",
                    "TAcc" => "tacc_ns",
                    "Nano" => "nano_ns",
                    "FixType" => "fix_type",
                    "Flags" => "flags",
                    "NumSV" => "num_sv",
                    "Reserved1" => "reserved1",
                    "Lon" => "lon_deg_e7",
                    "Lat" => "lat_deg_e7",
                    "Height" => "height_mm",
                    "HMSL" => "hmsl_mm",
                    "HAcc" => "hacc_mm",
                    "VAcc" => "vacc_mm",
                    "VelN" => "vel_n_mm_s",
                    "VelE" => "vel_e_mm_s",
                    "VelD" => "vel_d_mm_s",
                    "GSpeed" => "gspeed_mm_s",
                    "HeadMot" => "head_mot_deg_e5",
                    "SAcc" => "sacc_mm_s",
                    "HeadAcc" => "head_acc_deg_e5",
                    "HeadVeh" => "head_veh_deg_e5",
                    "GDOP" => "gdop_e2",
                    "PDOP" => "pdop_e2",
                    "TDOP" => "tdop_e2",
                    "VDOP" => "vdop_e2",
                    "HDOP" => "hdop_e2",
                    "NDOP" => "ndop_e2",
                    "EDOP" => "edop_e2",
                    _ => panic!("{label} is not known"),
                };
                assert_eq!(pvt[field].as_f64(), Some(number()), "{label}");
            }
            _ => panic!("{title} is not known"),
        }
        index += 1;
        compared += 1;
    }
    compared
}

#[test]
fn recorded_streams_decode_to_their_published_values() {
    for folder in ["1", "2", "4"] {
        let folder = recordings().join("einride-mtig710").join(folder);
        let bytes = std::fs::read(folder.join("output.bin")).unwrap();
        let golden = std::fs::read_to_string(folder.join("output.golden")).unwrap();
        let blocks: Vec<&str> = golden.split("\n\n").filter(|block| !block.trim().is_empty()).collect();
        let (records, summary) = decode(&bytes);
        assert_eq!(summary, Summary { records: 100, ..Summary::default() });
        assert_eq!(blocks.len(), 100);
        let compared: usize =
            blocks.iter().zip(&records).map(|(block, record)| compare(block, &record.items)).sum();
        let published = golden.lines().filter(|line| line.starts_with(' ')).count();
        assert_eq!(compared, published, "{}", folder.display());
        assert!(records.iter().all(|record| record.items.other.is_empty()));
        for (record, expected) in records.iter().zip(0..) {
            assert_eq!(
                record.items.packet_counter,
                Some(expected + records[0].items.packet_counter.unwrap())
            );
        }
    }
}

#[test]
fn messages_shown_by_the_vendors_tool() {
    let lines = std::fs::read_to_string(recordings().join("scottapotamas-mti300/frames.jsonl")).unwrap();
    let mut compared = 0;
    for line in lines.lines() {
        let example: serde_json::Value = serde_json::from_str(line).unwrap();
        let (records, summary) = decode(&super::hex(example["frame"].as_str().unwrap()));
        assert_eq!(
            (records.len(), summary.bytes_skipped, summary.bad_checksums),
            (1, 0, 0),
            "{}",
            example["name"]
        );
        let items = serde_json::to_value(&records[0].items).unwrap();
        for (name, expected) in example["expect"].as_object().unwrap() {
            let field = match name.as_str() {
                "PacketCounter" => "packet_counter",
                "SampleTimeFine" => "sample_time_fine",
                "Quaternion" => "quaternion",
                "Acceleration" => "acceleration",
                "DeltaV" => "delta_v",
                "FreeAcceleration" => "free_acceleration",
                "RateOfTurn" => "rate_of_turn",
                "DeltaQ" => "delta_q",
                "MagneticField" => "magnetic_field",
                "BaroPressure" => "pressure_pa",
                "StatusWord" => "status_word",
                "mid" => {
                    assert_eq!(u64::from(records[0].mid), expected.as_u64().unwrap());
                    compared += 1;
                    continue;
                }
                "config" | "device_ids" | "version" | "build" | "svn" => continue,
                _ => panic!("{name} is not known"),
            };
            let numbers = |value: &serde_json::Value| match value.as_array() {
                Some(values) => values.iter().map(|value| value.as_f64().unwrap()).collect(),
                None => vec![value.as_f64().unwrap()],
            };
            let (ours, theirs) = (numbers(&items[field]), numbers(expected));
            assert_eq!(ours.len(), theirs.len());
            for (ours, theirs) in ours.iter().zip(theirs) {
                assert_eq!(format!("{ours:.8}"), format!("{theirs:.8}"), "{name} of {}", example["name"]);
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 88);
}

#[test]
fn a_stream_that_begins_within_a_message_and_has_holes_keeps_what_is_whole() {
    let bytes = std::fs::read(recordings().join("einride-mtig710/1/output.bin")).unwrap();
    let (whole, _) = decode(&bytes);
    let (records, summary) = decode(&bytes[22..]);
    assert_eq!(records, whole[1..]);
    assert_eq!((summary.bad_checksums, summary.packets_lost), (0, 0));
    assert!(summary.bytes_skipped > 0);

    // A flipped bit anywhere costs the message that holds it, and no other; nothing false comes out.
    for (flip, bit) in (0..bytes.len()).step_by(7).zip((0..8).cycle()) {
        let mut damaged = bytes.clone();
        damaged[flip] ^= 1 << bit;
        let (records, summary) = decode(&damaged);
        let false_ones = records.iter().filter(|record| !whole.contains(record)).count();
        assert_eq!((records.len(), false_ones), (99, 0), "bit {bit} of byte {flip}");
        assert!(summary.bytes_skipped > 0);
    }
}
