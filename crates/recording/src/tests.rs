//! Tests of writer, reader, repair, replay and export together.

use std::collections::{BTreeMap, BTreeSet};

use posed_drivers::Timestamp;

use super::testing::{
    Full, STAGE, chunk, header, items, lean_header, model, reader, record, record_with, sensors, write,
};
use super::*;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};

fn read_all(bytes: &[u8]) -> (Vec<Item>, Option<ReadError>, Option<Ending>) {
    let mut reader = reader(bytes).unwrap();
    let mut items = Vec::new();
    let mut error = None;
    for item in &mut reader {
        match item {
            Ok(item) => items.push(item),
            Err(e) => error = Some(e),
        }
    }
    let ending = reader.ending();
    (items, error, ending)
}

#[test]
fn everything_comes_back_in_exact_order() {
    let items = items();
    for (header, flush_every) in [header(), lean_header()].iter().flat_map(|h| [(h, 1), (h, 5), (h, 1000)]) {
        let bytes = record_with(header.clone(), &items, flush_every);
        let mut reader = reader(&bytes).unwrap();
        assert_eq!(reader.header(), header);
        let back: Vec<_> = reader.by_ref().map(Result::unwrap).collect();
        assert_eq!(back, items);
        assert_eq!((reader.ending(), reader.end_reason()), (Some(Ending::Complete), Some("test over")));
    }
}

#[test]
fn a_recording_holds_no_secret_of_the_stage_file() {
    let secrets = ["a-token-of-the-stage", "a-password-of-zenoh", "a-token-of-last-year"];
    let text = format!(
        "{STAGE}\n[server]\nlisten = \"0.0.0.0:8787\"\n[[server.token]]\nsecret = \"{}\"\nrole = \"watch\"\n[zenoh]\n\
         connect = [\"tcp/hub:7447\"]\nuser = \"stage\"\npassword = '{}'\n# secret = \"{}\"\n",
        secrets[0], secrets[1], secrets[2]
    );
    let stage = Stage::parse(&text).unwrap();
    let header = Header::new(&stage, &text, 0);
    let mut writer = Writer::new(Vec::new(), header.clone()).unwrap();
    for item in items() {
        write(&mut writer, &item).unwrap();
    }
    let bytes = writer.finish("test over").unwrap();
    // A chunk may be compressed, but not what is in front.
    for secret in secrets {
        assert!(!bytes.windows(secret.len()).any(|part| part == secret.as_bytes()), "{secret}");
    }
    let recorded = Stage::parse(&reader(&bytes).unwrap().header().stage_toml).unwrap();
    assert_eq!(recorded.shareable_toml(), stage.shareable_toml(), "it is replayed on the same stage");
    assert!(crate::Machine::as_recorded(&header).is_ok());
}

#[test]
fn other_programs_find_index_schemas_and_utc_times() {
    let items = items();
    let bytes = record(&items, 4);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.stats.unwrap().message_count, items.len() as u64);
    let by_topic: BTreeMap<_, _> =
        summary.channels.values().map(|channel| (channel.topic.as_str(), channel)).collect();
    let schema = by_topic["/posed/sensors"].schema.as_ref().unwrap();
    assert_eq!((schema.name.as_str(), schema.encoding.as_str()), ("posed.sensors", "jsonschema"));
    assert_eq!(by_topic["/input/über/flock/line"].metadata["device"], "über/flock");
    let first = mcap::MessageStream::new(&bytes).unwrap().next().unwrap().unwrap();
    assert_eq!(first.log_time, 1_700_000_000_123_456_789 + 1);
}

#[test]
fn bundles_take_little_more_than_what_is_in_them_and_the_index_names_what_that_is() {
    let chunks: Vec<_> = (0..10_000).map(|n| Item::Entry(chunk(n * 87_000))).collect();
    let [full, lean] = [header(), lean_header()].map(|header| record_with(header, &chunks, 5000));
    let payload = 78 * chunks.len();
    assert!(lean.len() < payload + 5 * chunks.len(), "{} for {payload}", lean.len());
    assert!(full.len() > payload + 25 * chunks.len(), "{} for {payload}", full.len());
    let summary = mcap::Summary::read(&lean).unwrap().unwrap();
    let topics: BTreeSet<_> = summary.channels.values().map(|channel| channel.topic.as_str()).collect();
    assert_eq!(topics, BTreeSet::from(["/input/flock/bytes", "/input/log"]));
}

#[test]
fn a_lean_recording_cut_at_any_byte_is_a_prefix_of_whole_flushes_and_is_completed() {
    let items = items();
    let bytes = record_with(lean_header(), &items, 6);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut longest = 0;
    for cut in 0..bytes.len() {
        if reader(&bytes[..cut]).is_err() {
            continue;
        }
        let (back, error, ending) = read_all(&bytes[..cut]);
        assert!(error.is_none() && ending == Some(Ending::Torn) && back == items[..back.len()], "{cut}");
        assert!(back.len() >= longest && (back.len() % 6 == 0 || back.len() == items.len()), "{cut}");
        longest = back.len();
        if cut % 499 == 0 {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            repair(&path, |_| ()).unwrap();
            let repaired = std::fs::read(&path).unwrap();
            let (again, error, ending) = read_all(&repaired);
            assert!(error.is_none() && ending == Some(Ending::Complete) && again == back, "{cut}");
            let (before, after) = (topics(&bytes[..cut]), Outline::read(&path).unwrap().topics);
            assert!(before.is_subset(&after), "{before:?} {after:?}");
        }
    }
    assert_eq!(longest, items.len());
}

/// The channels in the chunks of a file.
fn topics(bytes: &[u8]) -> BTreeSet<String> {
    let mut records = super::records::Records::new(bytes, 0);
    while let Ok(Some(_)) = records.next() {}
    records.channels().map(|channel| channel.topic.clone()).collect()
}

#[test]
fn what_a_newer_version_wrote_is_not_cut() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let metadata = |kind: &str| BTreeMap::from([("kind".to_owned(), kind.to_owned())]);
    for (kind, data, what) in [
        ("weather", &b"rain"[..], "`weather`"),
        ("model", b"\x81\xa4kind\xa5cloud", "a model"),
        ("bundle", &[0x16, 0, 0], "the place 11"),
        ("bytes", b"of no device", "its device"),
    ] {
        let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
        for super::header::Part { name, data, .. } in header().attachments().unwrap() {
            let (name, media_type) = (name.to_owned(), String::new());
            let attachment =
                mcap::Attachment { log_time: 0, create_time: 0, name, media_type, data: data.into() };
            writer.attach(&attachment).unwrap();
        }
        writer.write_metadata(&header().metadata().unwrap()).unwrap();
        for (sequence, kind, data) in [(0, "timer", &[][..]), (1, kind, data), (2, "timer", &[])] {
            let topic = format!("/input/{kind}");
            let channel_id = writer.add_channel(0, &topic, "", &metadata(kind)).unwrap();
            let header = mcap::records::MessageHeader { channel_id, sequence, log_time: 0, publish_time: 0 };
            writer.write_to_known_channel(&header, data).unwrap();
        }
        writer.finish().unwrap();
        let bytes = writer.into_inner().into_inner();
        for end in [bytes.len(), bytes.len() - 100] {
            std::fs::write(&path, &bytes[..end]).unwrap();
            let error = repair(&path, |_| ()).unwrap_err().to_string();
            assert!(error.contains(what) && error.contains("newer version"), "{error}");
            assert!(std::fs::read(&path).unwrap() == bytes[..end]);
        }
    }
}

#[test]
fn the_largest_piece_is_as_large_as_the_refusal_of_a_larger_one_says() {
    let entry = |len| Entry { t: Timestamp::ZERO, input: Input::Bytes { device: 0, bytes: vec![0; len] } };
    for header in [header(), lean_header()] {
        let mut writer = Writer::new(Vec::new(), header).unwrap();
        writer.entry(&entry(1000)).unwrap();
        let error = writer.entry(&entry(MAX_PIECE_BYTES + 1)).unwrap_err().to_string();
        assert!(error.contains(&format!("at most {MAX_PIECE_BYTES} ")), "{error}");
        writer.entry(&entry(MAX_PIECE_BYTES)).unwrap();
        writer.entry(&entry(1)).unwrap();
        let (items, error, ending) = read_all(&writer.finish("x").unwrap());
        assert_eq!((items.len(), ending), (3, Some(Ending::Complete)), "{error:?}");
    }
}

#[test]
fn cut_at_any_byte_it_is_a_prefix_of_whole_chunks() {
    let items = items();
    let flush_every = 6;
    let bytes = record(&items, flush_every);
    let (mut longest, mut torn) = (0, 0);
    for cut in 0..bytes.len() {
        match reader(&bytes[..cut]) {
            Err(ReadError::NotARecording(_)) => {}
            Err(error) => panic!("cut at {cut}: {error}"),
            Ok(_) => {
                let (back, error, ending) = read_all(&bytes[..cut]);
                assert!(error.is_none(), "cut at {cut}: {error:?}");
                assert_eq!(ending, Some(Ending::Torn), "cut at {cut}");
                assert_eq!(back, items[..back.len()], "cut at {cut}");
                assert!(back.len() % flush_every == 0 || back.len() == items.len());
                assert!(back.len() >= longest, "a longer file never says less");
                longest = back.len();
                torn += 1;
            }
        }
    }
    assert_eq!(longest, items.len());
    assert!(torn > 1000, "most cuts leave a readable front part: {torn}");
}

#[test]
fn a_tail_of_zeros_as_after_a_power_cut_is_a_torn_file() {
    let items = items();
    let mut writer = Writer::new(Vec::new(), header()).unwrap();
    items.iter().for_each(|item| write(&mut writer, item).unwrap());
    let bytes = writer.finish("x").unwrap();
    let index = bytes.windows(9).rposition(|window| window == [15, 4, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    let mut bytes = bytes[..index].to_vec();
    bytes.extend([0; 4096]);
    let (back, error, ending) = read_all(&bytes);
    assert!(error.is_none() && back == items && ending == Some(Ending::Torn), "{error:?}");
}

#[test]
fn a_changed_byte_is_noticed_and_never_changes_an_item() {
    let items = items();
    let bytes = record(&items, 6);
    let mut refused = 0;
    for at in 0..bytes.len() {
        let mut bytes = bytes.clone();
        bytes[at] ^= 0x41;
        let Ok(mut reader) = reader(&bytes) else {
            refused += 1;
            continue;
        };
        let same_header = *reader.header() == header();
        let (mut count, mut failed) = (0, false);
        for item in &mut reader {
            match item {
                // Times hang on the epoch, which stands in the header.
                Ok(item) => {
                    assert!(item == items[count] || !same_header, "byte {at}, item {count}");
                    count += 1;
                }
                Err(_) => failed = true,
            }
        }
        let complete = reader.ending() == Some(Ending::Complete);
        assert!(!complete || count == items.len(), "byte {at}: a loss went unnoticed");
        assert!(!complete || same_header, "byte {at}: another header went unnoticed");
        refused += usize::from(failed || !complete);
    }
    // What may go unnoticed is in the index, which is not needed.
    assert!(refused > bytes.len() / 2, "{refused} of {}", bytes.len());
}

#[test]
fn a_hole_in_the_log_is_named() {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    for super::header::Part { name, data, .. } in header().attachments().unwrap() {
        let (name, media_type) = (name.to_owned(), String::new());
        writer
            .attach(&mcap::Attachment { log_time: 0, create_time: 0, name, media_type, data: data.into() })
            .unwrap();
    }
    writer.write_metadata(&header().metadata().unwrap()).unwrap();
    let metadata = BTreeMap::from([("kind".to_owned(), "timer".to_owned())]);
    let channel_id = writer.add_channel(0, "/input/timer", "", &metadata).unwrap();
    for sequence in [0, 1, 3] {
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &[]).unwrap();
    }
    writer.finish().unwrap();
    let bytes = writer.into_inner().into_inner();
    let (items, error, ending) = read_all(&bytes);
    assert_eq!((items.len(), ending), (2, None));
    assert!(matches!(error, Some(ReadError::Hole { expected: 2, found: 3 })), "{error:?}");
    // The repair keeps what comes before the hole.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, bytes).unwrap();
    assert_eq!(repair(&path, |_| ()).unwrap(), Repaired::Completed { messages: 2 });
    assert!(Info::read(&path, |_| ()).unwrap().complete);
}

#[test]
fn what_is_no_recording_is_refused_with_a_reason() {
    for (bytes, reason) in [
        (&b""[..], "it ends before"),
        (b"t,x,y,z\n1,2,3,4\n", "does not begin as an MCAP file"),
        (&mcap::MAGIC[..5], "it ends before"),
    ] {
        let error = reader(bytes).err().unwrap().to_string();
        assert!(error.contains(reason), "{error}");
    }
    let mut foreign = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    foreign.finish().unwrap();
    let error = reader(&foreign.into_inner().into_inner()).err().unwrap();
    assert!(matches!(error, ReadError::NotARecording(_)));
}

#[test]
fn a_full_disk_is_an_error_at_any_byte_and_leaves_a_prefix() {
    let items = items();
    let whole = record(&items, 6).len();
    for left in (0..whole - 1).step_by(7) {
        let disk = Full { left, ..Full::default() };
        let result = Writer::new(disk.clone(), header()).and_then(|mut writer| {
            for (index, item) in items.iter().enumerate() {
                write(&mut writer, item)?;
                if (index + 1) % 6 == 0 {
                    writer.flush()?;
                }
            }
            writer.declare("sensors", "{}");
            writer.finish("test over")
        });
        let taken = disk.taken.lock().unwrap().clone();
        match result {
            Err(WriteError::DiskFull) => {}
            Err(error) => panic!("{left} bytes left: {error}"),
            // Without the schema it is a little shorter.
            Ok(_) => assert!(whole - left < 500, "{left} of {whole} bytes were enough"),
        }
        if reader(&taken).is_ok() {
            let (back, error, _) = read_all(&taken);
            assert!(error.is_none() && back == items[..back.len()], "{left} bytes left: {error:?}");
        }
    }
}

#[test]
fn an_unknown_device_or_a_giant_is_an_error() {
    let mut writer = Writer::new(Vec::new(), header()).unwrap();
    let entry =
        |device, len| Entry { t: Timestamp::ZERO, input: Input::Bytes { device, bytes: vec![0; len] } };
    let error = writer.entry(&entry(2, 1)).unwrap_err();
    assert!(matches!(error, WriteError::UnknownDevice { device: 2, devices: 2 }));
    let error = writer.entry(&entry(0, MAX_RECORD_BYTES)).unwrap_err();
    assert!(error.to_string().contains("/input/flock/bytes"), "{error}");
    writer.entry(&entry(0, 1)).unwrap();
    let (items, error, _) = read_all(&writer.finish("x").unwrap());
    assert!(items.len() == 1 && error.is_none(), "refused entries leave no hole");
}

#[test]
fn a_record_that_claims_more_than_one_may_have_is_damage_and_what_is_before_it_is_read() {
    let items = items();
    let mut bytes = record(&items, 6);
    // Where the chunks begin.
    let (mut at, mut chunks) = (mcap::MAGIC.len(), Vec::new());
    while at + 9 < bytes.len() - mcap::MAGIC.len() {
        if bytes[at] == mcap::records::op::CHUNK {
            chunks.push(at);
        }
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    // A chunk is read bit by bit; any other record is read as a whole.
    let second = chunks[1];
    bytes[second] = mcap::records::op::METADATA;
    let mut claim = |length: usize| {
        bytes[second + 1..second + 9].copy_from_slice(&(length as u64).to_le_bytes());
        read_all(&bytes)
    };
    let (before, error, ending) = claim(MAX_RECORD_BYTES + 1);
    assert!((1..items.len()).contains(&before.len()), "{} of {}", before.len(), items.len());
    assert!(before == items[..before.len()]);
    assert!(matches!(error, Some(ReadError::Corrupt { .. })), "{error:?}");
    assert_eq!(ending, None);
    // One that may be so long has only been torn off.
    let (torn, error, ending) = claim(MAX_RECORD_BYTES);
    assert!(torn == before && error.is_none() && ending == Some(Ending::Torn), "{error:?}");
}

#[test]
fn a_repaired_file_is_the_prefix_and_complete() {
    let items = items();
    let bytes = record(&items, 6);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for cut in (bytes.len() / 3..bytes.len()).step_by(499) {
        let Ok(_) = reader(&bytes[..cut]) else { continue };
        let (prefix, ..) = read_all(&bytes[..cut]);
        std::fs::write(&path, &bytes[..cut]).unwrap();
        assert_eq!(repair(&path, |_| ()).unwrap(), Repaired::Completed { messages: prefix.len() as u64 });
        let repaired = std::fs::read(&path).unwrap();
        let (back, error, ending) = read_all(&repaired);
        assert!(error.is_none() && back == prefix && ending == Some(Ending::Complete), "cut at {cut}");
        assert_eq!(reader(&repaired).unwrap().header(), &header());
        let summary = mcap::Summary::read(&repaired).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count, prefix.len() as u64);
        assert_eq!(repair(&path, |_| ()).unwrap(), Repaired::WasComplete);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing half-written stays");
    }
}

#[test]
fn what_cannot_be_repaired_stays_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    std::fs::write(&path, b"something else").unwrap();
    assert!(repair(&path, |_| ()).is_err());
    assert_eq!(std::fs::read(&path).unwrap(), b"something else");
}

#[test]
fn info_counts_and_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let items: Vec<_> = items().into_iter().take(12).collect();
    let bytes = record(&items, 5);
    std::fs::write(&path, &bytes).unwrap();
    let info = Info::read(&path, |_| ()).unwrap();
    assert!(info.complete && info.mid_run && info.problem.is_none());
    assert_eq!(info.ended.as_deref(), Some("test over"));
    assert_eq!(
        (info.stage.as_str(), info.epoch_utc.as_str()),
        ("Test stage", "2023-11-14T22:13:20.123456789Z")
    );
    assert_eq!((info.topics["/input/timer"], info.topics["/posed/sensors"]), (1, 1));
    assert_eq!(info.topics.values().sum::<u64>(), 12);
    let bytes_in: Vec<_> = info.devices.iter().map(|device| (device.bytes_in, device.bytes_out)).collect();
    assert_eq!(bytes_in, [(78, 2), (78, 0)]);
    assert!((info.duration_s - 14e-9).abs() < 1e-15);
    std::fs::write(&path, &bytes[..bytes.len() - 1]).unwrap();
    let torn = Info::read(&path, |_| ()).unwrap();
    assert!(!torn.complete && torn.problem.unwrap().contains("--repair"));
    assert_eq!(torn.topics.values().sum::<u64>(), 12);
}

/// Says a message for every chunk, from what it has counted so far.
struct Machine {
    chunks: u64,
}

impl Replayable for Machine {
    fn push(&mut self, entry: &Entry, publish: &mut dyn FnMut(&str, Timestamp, &[u8])) {
        if let Input::Bytes { bytes, .. } = &entry.input {
            self.chunks += 1;
            let (seq, t_s) = (self.chunks, bytes.len() as u64 + self.chunks);
            let json = format!(r#"{{"type":"sensors","seq":{seq},"dropped":0,"t_s":{t_s}}}"#);
            publish("sensors", entry.t, json.as_bytes());
            publish("status", entry.t, format!("{:p}", bytes.as_ptr()).as_bytes());
        }
    }
}

/// A recording of a machine that had counted to ten, and would say `t_s` as `t_s + off` from entry 4 on.
fn machine_recording(off: u64) -> Vec<u8> {
    let mut writer = Writer::new(Vec::new(), header()).unwrap();
    let mut machine = Machine { chunks: 10 };
    for (index, item) in items().iter().filter(|item| matches!(item, Item::Entry(_))).enumerate() {
        let Item::Entry(entry) = item else { continue };
        writer.entry(entry).unwrap();
        if index == 4 {
            machine.chunks += off;
        }
        machine.push(entry, &mut |topic, t, json| writer.message(topic, t, json).unwrap());
    }
    writer.finish("x").unwrap()
}

#[test]
fn a_replay_that_says_the_same_is_verified_and_another_is_shown() {
    let verify = |bytes: &[u8], chunks| {
        super::verify(&mut reader(bytes).unwrap(), &mut Machine { chunks }, Comparison::default())
    };
    let bytes = machine_recording(0);
    let verdict = verify(&bytes, 10).unwrap();
    assert_eq!((verdict.messages, verdict.ending), (9, Some(Ending::Complete)));
    let error = verify(&bytes, 9).unwrap_err().to_string();
    assert_eq!(error, "the replay differs: message 1, topic sensors, t_s: expected 89, got 88");
    let error = verify(&machine_recording(3), 10).unwrap_err().to_string();
    assert!(error.contains("message 2"), "{error}");
    // A torn recording may lack the last messages, and only those.
    for cut in (bytes.len() / 2..bytes.len()).step_by(13) {
        verify(&bytes[..cut], 10).unwrap();
    }
}

#[test]
fn a_replay_with_more_or_fewer_messages_is_shown() {
    struct Mute;
    impl Replayable for Mute {
        fn push(&mut self, _: &Entry, _: &mut dyn FnMut(&str, Timestamp, &[u8])) {}
    }
    let verify = |bytes: &[u8], machine: &mut dyn FnMut() -> bool| {
        let mut reader = reader(bytes).unwrap();
        if machine() {
            super::verify(&mut reader, &mut Mute, Comparison::default())
        } else {
            super::verify(&mut reader, &mut Machine { chunks: 10 }, Comparison::default())
        }
    };
    let error = verify(&machine_recording(0), &mut || true).unwrap_err().to_string();
    assert!(error.contains("got no further message"), "{error}");
    // Of a recording that has none there is nothing to hold it against.
    let log_only = record_with(lean_header(), &[], 9);
    let error = super::verify(&mut reader(&log_only).unwrap(), &mut Mute, Comparison::default());
    assert!(matches!(error, Err(VerifyError::LogOnly)));
    let silent = record(&items().into_iter().filter(|i| matches!(i, Item::Entry(_))).collect::<Vec<_>>(), 9);
    let error = verify(&silent, &mut || false).unwrap_err().to_string();
    assert!(error.contains("expected no further message"), "{error}");
}

#[test]
fn entries_are_mapped_to_another_stage_by_name() {
    let swapped = r#"
name = "Other"
[[device]]
name = "new"
driver = "flock-of-birds"
port = "/dev/null"
[[device]]
name = "flock"
driver = "flock-of-birds"
port = "/dev/zero"
[[sensor]]
name = "right"
device = "flock"
address = 2
[[sensor]]
name = "another"
device = "new"
address = 1
"#;
    let mapping = Mapping::new(&header(), &Stage::parse(swapped).unwrap());
    assert_eq!(mapping.missing_devices, ["über/flock"]);
    let entries = items().into_iter().filter_map(|item| match item {
        Item::Entry(entry) => Some(entry),
        _ => None,
    });
    for entry in entries {
        let mapped = mapping.entry(entry.clone());
        match (&entry.input, mapped.as_ref().map(|entry| &entry.input)) {
            (Input::Bytes { device: 1, .. } | Input::Line { device: 1, .. }, mapped) => {
                assert!(mapped.is_none())
            }
            (Input::Bytes { .. }, Some(Input::Bytes { device, .. })) => assert_eq!(*device, 1),
            (Input::Line { .. }, Some(Input::Line { device, .. })) => assert_eq!(*device, 1),
            (Input::Truth(_), Some(Input::Truth(truth))) => assert_eq!(truth.sensors[0].sensor, 0),
            (input, mapped) => assert_eq!(Some(input), mapped),
        }
    }
    let same = Mapping::new(&header(), &Stage::parse(STAGE).unwrap());
    assert!(items().into_iter().all(|item| match item {
        Item::Entry(entry) => same.entry(entry.clone()) == Some(entry),
        _ => true,
    }));
}

#[test]
fn exported_poses_are_in_room_or_transmitter_axes() {
    let folder = tempfile::tempdir().unwrap();
    let (path, output) = (folder.path().join("a.mcap"), folder.path().join("a.csv"));
    let message = |nanos| {
        let json = sensors(nanos).into_bytes();
        Item::Message(Message { topic: "sensors".into(), t: Timestamp::from_nanos(nanos), json })
    };
    let swap = Item::Entry(Entry { t: Timestamp::ZERO, input: Input::Model(model(1.0)) });
    let mut front = header();
    front.models = posed_stage::LoadedModels::default();
    let mut writer = Writer::new(std::fs::File::create(&path).unwrap(), front).unwrap();
    for item in [message(0), swap, message(1_000_000_000)] {
        write(&mut writer, &item).unwrap();
    }
    writer.finish("x").unwrap();
    assert_eq!(export::csv(&path, &output, export::Frame::Room, |_| true).unwrap(), 4);
    let room = std::fs::read_to_string(&output).unwrap();
    let lines: Vec<_> = room.lines().collect();
    assert_eq!(lines[0], "t,sensor,x,y,z,qw,qx,qy,qz,state");
    assert_eq!(lines[1], "0,left,1.5,2.25,3.125,1,0,0,0,ok");
    assert_eq!(lines[4], "1,right,1,2,3,1,0,0,0,suspect");
    export::csv(&path, &output, export::Frame::Transmitter, |_| true).unwrap();
    let poses = crate::table::Poses::read(&output).unwrap();
    // Half a turn about x, at (1, 2, 3).
    assert_eq!(poses.rows[0].position_m, Some([0.5, -0.25, -0.125]));
    assert_eq!(poses.rows[0].orientation_wxyz.map(|q| q[1].abs()), Some(1.0));
    // After the swap: no rotation, at (1, 0.3, 0).
    assert_eq!(poses.rows[2].position_m, Some([0.5, 2.25 - (0.1 + 0.2), 3.125]));
    // Only what may be used as good.
    let usable = crate::table::Poses::read(&path).unwrap();
    assert_eq!((usable.rows.len(), usable.sensors.as_slice()), (2, &["left".to_owned()][..]));
    assert_eq!(export::jsonl(&path, &output, |_| true).unwrap(), 2);
    assert_eq!(
        std::fs::read_to_string(&output).unwrap(),
        format!("{}\n{}\n", sensors(0), sensors(1_000_000_000))
    );
}
