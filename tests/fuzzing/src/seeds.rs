//! Seeds that are made rather than found: from virtual devices, from the tests' files, and by hand. A fuzzer begins at what is right.

use nalgebra::Vector3;
use posed_drivers::{LineEvent, Timestamp};
use posed_field::{FieldMap, Hull, Prepared};
use posed_fusion::chain::calibrate;
use posed_motion::exercise::{Exercise, Options, Stream, teach};
use posed_motion::fault_map::{FaultMap, Frames, Size, Training};
use posed_motion::segments;
use posed_motion::segments::SegmentationNetwork;
use posed_protocol::{Counters, Fields, Payload, Publisher, REQUEST_EXAMPLES};
use posed_recording::{Header, Snapshot, Writer};
use posed_rig::{demo, leg};
use posed_stage::input::{Entry, Input, Model, MountedSensor, Plan, Request};
use posed_stage::layout::ChainLayout;
use posed_stage::{RecordingContent, Stage};
use posed_timecode::{Counting, Frame, Reading, ltc, mtc};
use serde_json::json;

use crate::mesh;
use crate::stand::STANDS;
use crate::timecode::SAMPLE_RATE_HZ;

/// A corpus, the name of an input, and the input.
pub type Seed = (&'static str, String, Vec<u8>);

/// All of them.
pub fn all() -> Vec<Seed> {
    let mut seeds = Vec::new();
    let mut add =
        |target: &'static str, name: &str, data: Vec<u8>| seeds.push((target, name.to_owned(), data));
    for model in models() {
        let json = serde_json::to_value(&model).expect("plain data");
        let kind = json["kind"].as_str().expect("its kind").to_owned();
        add("model", &kind, json.to_string().into_bytes());
    }
    let inputs: Vec<Input> = models().into_iter().filter(is_small).map(Input::Model).collect();
    for (number, inputs) in inputs.chunks(3).enumerate() {
        add("model", &format!("packed-{number}"), rmp_serde::to_vec_named(inputs).expect("plain data"));
    }
    let wishes: Vec<_> = requests().iter().map(|request| json!(request)).collect();
    let exercise = json!(Model::Exercise { exercise: Box::new(wave()) });
    add("model", "requests", json!([&[exercise], &wishes[..]].concat()).to_string().into_bytes());
    add("segmentation_network", "demo", small_network());
    add("snapshot", "whole", vec![0]);
    for (number, edit) in edits().into_iter().enumerate() {
        add("snapshot", &format!("edit-{number}"), edit);
    }
    for content in [RecordingContent::Full, RecordingContent::Log] {
        let bare = plain(&recorded(content, false));
        add("recording", &format!("{content:?}-torn").to_lowercase(), bare[..bare.len() * 2 / 3].to_vec());
        add("recording", &format!("{content:?}").to_lowercase(), bare);
        add("recording", &format!("{content:?}-mid-run").to_lowercase(), plain(&recorded(content, true)));
    }
    for (number, text) in TABLES.iter().enumerate() {
        let kinds = if number == 0 { vec![0x80] } else { vec![0, 0x80] };
        for (way, flag) in kinds.into_iter().enumerate() {
            add("tables", &format!("{number}-{way}"), [&[number as u8 | flag], text.as_bytes()].concat());
        }
    }
    for (name, data) in mesh_messages() {
        add("mesh_message", &name, data);
    }
    for (number, text) in REQUEST_EXAMPLES.into_iter().chain([OF_A_HUB]).enumerate() {
        let value: serde_json::Value = serde_json::from_str(text).expect("JSON");
        add("client_message", &number.to_string(), text.as_bytes().to_vec());
        add("client_message", &format!("{number}-packed"), rmp_serde::to_vec(&value).expect("plain data"));
    }
    for (name, text) in STAGES {
        add("stage_file", name, text.as_bytes().to_vec());
    }
    for (name, data) in timecodes() {
        add("timecode", name, data);
    }
    seeds
}

fn is_small(model: &Model) -> bool {
    rmp_serde::to_vec_named(model).expect("plain data").len() < 2000
}

/// One of each kind, that the stages here take.
fn models() -> Vec<Model> {
    let unit = [1.0, 0.0, 0.0, 0.0];
    let intrinsics = json!({
        "unit": "1", "gyro_bias_rad_s": [0.01, 0.0, -0.01], "gyro_bias_sigma_rad_s": 1e-4,
        "accel_bias_m_s2": [0.1, 0.0, 0.0], "accel_scale": [1.0, 1.01, 0.99], "accel_residual_m_s2": 0.01,
        "directions": 12,
        "mag": {"offset": [0.1, 0.0, 0.0], "matrix": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            "norm": 1.0, "residual": 0.01},
    });
    let mut map = FieldMap::from_json(include_bytes!("../../../config/demo-field.json")).expect("the demo's");
    // Of a smaller room, which takes less time.
    let corners: Vec<_> = (0..8)
        .map(|k| {
            Vector3::new(0.4, 0.0, 0.0) + Vector3::from([0, 1, 2].map(|axis| f64::from(k >> axis & 1) * 0.1))
        })
        .collect();
    map.hull = Hull::new(corners.iter()).expect("points");
    let mounted = MountedSensor {
        sensor: "imu_torso".into(),
        segment: Some("torso".into()),
        mount_quat_wxyz: unit,
        offset_m: [0.1, 0.0, 0.0],
        sigma_deg: Some([2.0, 3.0, 2.0]),
    };
    let chain = leg::leg(1);
    let calibration = {
        let mut rig = chain;
        rig.run_until(20.0);
        let stage = Stage::parse(leg::STAGE).expect("a stage");
        let layout = ChainLayout::of(&stage, 0).expect("a chain");
        calibrate(&layout.segments, &leg::epochs(&rig)).expect("it walks")
    };
    vec![
        Model::Transmitter { position_m: [0.0, 0.0, 1.0], orientation_wxyz: [0.0, 1.0, 0.0, 0.0] },
        Model::TrackerNoise {
            device: "flock".into(),
            r0_m: 1.0,
            sigma_radial_m: 1e-3,
            sigma_rotation_rad: 1e-3,
        },
        Model::Field { version: 2, map: Some(Prepared::new(map)) },
        Model::Mounting { body: None, sensors: vec![mounted] },
        Model::Chain { body: None, calibration: Box::new(calibration) },
        Model::AttachedImu {
            sensor: "hand".into(),
            quat_wxyz: unit,
            offset_m: [0.01, 0.0, 0.0],
            clock_offset_s: 0.001,
        },
        Model::Imu {
            unit: "imu_torso".into(),
            intrinsics: serde_json::from_value(intrinsics).expect("a unit"),
        },
        Model::Exercise { exercise: Box::new(wave()) },
        Model::Faults { fault_map: Box::new(faults()) },
    ]
}

/// Taught from a wand that goes to and fro.
fn wave() -> Exercise {
    const RATE_HZ: f64 = 50.0;
    let columns = vec!["wand_x_m".to_owned()];
    let t_s: Vec<f64> = (0..500).map(|frame| f64::from(frame) / RATE_HZ).collect();
    let place = |t_s: f64| {
        let (phase, moves) = ((t_s - 1.0) / 1.6, (1.0..9.0).contains(&t_s));
        let share = (phase - phase.floor()) / 0.8;
        // A parabola there and back, with a tremble.
        let away = if moves && share < 1.0 { 4.0 * share * (1.0 - share) } else { 0.0 };
        0.5 + 0.3 * away + 1e-3 * ((t_s * 17.0) % 1.0)
    };
    let values: Vec<Option<f64>> = t_s.iter().map(|&t_s| Some(place(t_s))).collect();
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let options = Options {
        name: "wave".into(),
        repetitions: 5,
        channels: Some(columns.clone()),
        ..Options::default()
    };
    teach(&stream, &options).expect("five repetitions").exercise
}

/// A small one, of the demo's trackers.
fn faults() -> FaultMap {
    let (stage, mut rig) = demo();
    rig.run_until(8.0);
    let sensors = stage.magnetic_sensors().into_iter().map(str::to_owned).collect();
    let indices = stage.magnetic_indices();
    let mut frames = Frames { sensors, ..Frames::default() };
    for estimate in rig.estimates().filter(|estimate| estimate.t_valid.as_secs_f64() > 4.0) {
        frames.t_s.push(estimate.t_valid.as_secs_f64());
        posed_pipeline::raw_poses(estimate, &indices, |pose| pose.append_to(&mut frames));
    }
    let training = Training { epochs: 2, ..Training::default() };
    FaultMap::train(&frames, Size { neurons: 5, side: 3 }, &training).expect("frames").0
}

fn requests() -> Vec<Request> {
    vec![
        Request::ExerciseSelect {
            subject: "a".into(),
            exercises: vec!["wave".into()],
            plan: Plan { repetitions: Some(3), sets: Some(2), rest_s: 1.0 },
            sensors: [("wand".to_owned(), "forearm_r".to_owned())].into(),
            body: None,
        },
        Request::ExerciseReset { subject: "a".into() },
        Request::FieldStart {
            sensors: ["upper_arm_r", "forearm_r", "wand"].map(str::to_owned).to_vec(),
            spacing_m: 0.3,
        },
        Request::FieldFinish {},
    ]
}

/// The demo's, with fewer filters.
fn small_network() -> Vec<u8> {
    let bytes = include_bytes!("../../../config/demo-moves.safetensors");
    let mut model = segments::Model::from_bytes(bytes).expect("the demo's");
    model.card.shape.filters = vec![2, 2];
    let shape = model.card.shape.clone();
    let parameters = (0..shape.parameters()).map(|k| (k % 7) as f32 / 10.0 - 0.3).collect();
    model.network = SegmentationNetwork::new(shape, parameters).expect("as many");
    model.to_bytes().expect("small")
}

/// Of each kind one, at a few places.
fn edits() -> Vec<Vec<u8>> {
    let edit = |stage: u8, kind: u8, place: u32, what: f64| {
        let mut edit = vec![stage, kind];
        edit.extend(place.to_le_bytes());
        edit.extend(what.to_le_bytes());
        edit
    };
    vec![
        edit(0, 0, 1000, f64::NAN),
        edit(1, 0, 1001, f64::INFINITY),
        edit(2, 0, 502, 1e300),
        edit(0, 1, 2000, 0.5),
        edit(1, 2, 300, 0.5),
        edit(2, 3, 700, 0.0),
        edit(2, 4, 700, 0.0),
    ]
}

/// A recording of the single sensor, from its beginning or in the middle of a run.
fn recorded(content: RecordingContent, mid_run: bool) -> Vec<u8> {
    let stand = &STANDS[3];
    let text = crate::stand::SMALL;
    let publisher = Publisher::new(&stand.stage, Fields::all());
    let header = Header {
        content,
        begun: if mid_run { stand.now } else { Timestamp::ZERO },
        snapshot: mid_run.then(|| Snapshot {
            pipeline: stand.pipeline.snapshot(),
            publisher: rmp_serde::to_vec(&publisher.state()).expect("plain data"),
        }),
        ..Header::new(&stand.stage, text, 1_700_000_000_000_000_000)
    };
    let mut writer = Writer::new(Vec::new(), header).expect("memory");
    let mut publisher = publisher;
    let mut pipeline = if mid_run {
        stand.pipeline.clone()
    } else {
        posed_pipeline::Pipeline::new(&stand.stage).expect("a stage")
    };
    let line = |device| Input::Line { device, event: LineEvent::Opened { modem_lines: false } };
    let begins = [line(0), Input::Request(requests().remove(3)), Input::Model(models().remove(0))];
    let begins = begins.map(|input| Entry { t: stand.now, input });
    let log = if mid_run { &stand.next[..stand.next.len().min(20)] } else { &begins[..] };
    for entry in log {
        writer.entry(entry).expect("memory");
        pipeline.push(entry, &mut |output| {
            if let posed_stage::output::Output::Transmit { device, bytes } = &output {
                writer.transmitted(*device, entry.t, bytes).expect("memory");
            }
            if let (RecordingContent::Full, Some(payload)) = (content, Payload::of(&output)) {
                let (stamp, json) = publisher.publish(&payload);
                writer.message(stamp.topic.name(), stamp.t(), json).expect("memory");
            }
        });
    }
    writer.finish("enough").expect("memory")
}

/// The same records without compression and sums of their bytes, so that a change of a byte is a change of what it says.
fn plain(recording: &[u8]) -> Vec<u8> {
    use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader};
    let options = mcap::WriteOptions::new()
        .profile("posed")
        .compression(None)
        .calculate_chunk_crcs(false)
        .calculate_data_section_crc(false)
        .calculate_summary_section_crc(false)
        .calculate_attachment_crcs(false);
    let mut out = options.create(std::io::Cursor::new(Vec::new())).expect("memory");
    let mut reader = LinearReader::new();
    let mut rest = recording;
    while let Some(event) = reader.next_event() {
        match event.expect("whole") {
            LinearReadEvent::ReadRequest(wanted) => {
                let (now, later) = rest.split_at(wanted.min(rest.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            LinearReadEvent::Record { opcode, data } => {
                match mcap::parse_record(opcode, data).expect("whole") {
                    mcap::records::Record::DataEnd(_) => break,
                    record => copy(&mut out, record),
                }
            }
        }
    }
    out.finish().expect("memory");
    out.into_inner().into_inner()
}

fn copy(out: &mut mcap::Writer<std::io::Cursor<Vec<u8>>>, record: mcap::records::Record<'_>) {
    use mcap::records::Record;
    match record {
        Record::Schema { header, data } => {
            _ = out.add_schema_with_id(header.id, &header.name, &header.encoding, &data).expect("memory");
        }
        Record::Channel(channel) => {
            let mcap::records::Channel { id, schema_id, topic, message_encoding, metadata } = channel;
            out.add_channel_with_id(id, schema_id, &topic, &message_encoding, &metadata).expect("memory");
        }
        Record::Message { header, data } => out.write_to_known_channel(&header, &data).expect("memory"),
        Record::Attachment { header, data, .. } => out
            .attach(&mcap::Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name,
                media_type: header.media_type,
                data,
            })
            .expect("memory"),
        Record::Metadata(metadata) => out.write_metadata(&metadata).expect("memory"),
        _ => {}
    }
}

fn mesh_messages() -> Vec<(String, Vec<u8>)> {
    let stand = &STANDS[0];
    let mut messages = Vec::new();
    let mut counters = Counters::default();
    let mut pipeline = stand.pipeline.clone();
    let mut feed = Vec::new();
    let swap = Entry { t: stand.now, input: Input::Model(models().remove(0)) };
    for entry in std::iter::once(&swap).chain(&stand.next) {
        pipeline.push(entry, &mut |output| {
            if let (Some(payload), Some(item)) = (Payload::of(&output), mesh::item(&output)) {
                let stamp = counters.stamp(&payload);
                feed.push((payload.topic(), mesh::fed_bytes(stamp, &item)));
            }
        });
    }
    for (topic, bytes) in feed {
        let name = format!("fed-{}", topic.name());
        if messages.iter().all(|(known, _)| *known != name) {
            messages.push((name, [&[0], &bytes[..]].concat()));
        }
    }
    messages.extend(mesh::others(&STANDS[3], crate::stand::SMALL));
    messages
}

/// A third of a second around midnight as sound, two seconds as MIDI, and readings of both.
fn timecodes() -> [(&'static str, Vec<u8>); 3] {
    let counting = Counting { frames_per_s: 25, drop: false };
    let first = Frame::new(23, 59, 59, 21);
    let mut encoder = ltc::Encoder::new(SAMPLE_RATE_HZ, 25.0, counting, first);
    let sound = (0..3600).flat_map(|_| ((encoder.sample() * 20_000.0) as i16).to_le_bytes());
    let number = counting.number(first).expect("a frame");
    let quarters = |time: u32| mtc::quarter_frames(counting.frame(number + 2 * time), counting);
    let midi = (0..25).flat_map(quarters).flatten();
    let reading = |at: u32, position_s| Reading {
        frame: counting.frame(number + at),
        drop: false,
        frames_per_s: None,
        user_bits: 0,
        stream: 0,
        position_s,
        behind_s: 0.04,
        reversed: false,
    };
    let place = |at: u32| f64::from(at) * 0.04;
    let readings: Vec<_> = (0..40)
        .map(|at| (Timestamp::from_secs_f64(place(at)), reading(at, Some(place(at)).filter(|_| at < 20))))
        .collect();
    let readings = rmp_serde::to_vec(&readings).expect("plain data");
    let of = |choice: u8, bytes: Vec<u8>| [&[choice, 0], &bytes[..]].concat();
    [("sound", of(0, sound.collect())), ("midi", of(1, midi.collect())), ("readings", of(2, readings))]
}

/// By who reads them: see `tables`.
const TABLES: [&str; 8] = [
    "t,sensor,x,y,z,qw,qx,qy,qz\n0,a,1,2,3,1,0,0,0\n0,b,1,2,3,,,,\n0.01,a,1,2,3.1,1,0,0,0\n",
    "t,sensor,ax,ay,az,gx,gy,gz,mx,my,mz\n0,a,0,0,9.8,0,0,0.1,1,0,0\n0.01,a,0,0,9.8,,,,,,\n",
    "t,hip_x,hip_y,hip_z,label,transition\n0,1,2,3,walk,0\n0.02,,,,walk,1\n",
    "# a comment\n\"t\",\"a\",b\n0,1,\n0.02,2,1e-3\n",
    "frame,t,label,confidence\n0,0,walk,0.5\n1,0.02,,\n",
    "<?xml version=\"1.0\"?><ANNOTATION_DOCUMENT><TIME_ORDER><TIME_SLOT TIME_SLOT_ID=\"a\" TIME_VALUE=\"0\"/>\
     <TIME_SLOT TIME_SLOT_ID=\"b\" TIME_VALUE=\"900\"/></TIME_ORDER><TIER TIER_ID=\"segments\"><ANNOTATION>\
     <ALIGNABLE_ANNOTATION ANNOTATION_ID=\"1\" TIME_SLOT_REF1=\"a\" TIME_SLOT_REF2=\"b\"><ANNOTATION_VALUE>walk\
     </ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION></TIER></ANNOTATION_DOCUMENT>",
    "t,sensor,x,y,z,qw,qx,qy,qz\n10,l,1,2,3,1,0,0,0\n10,r,0,0,0,1,0,0,0\n10.5,l,1.5,2,3,0,0,0,1\n",
    "HIERARCHY\nROOT hip\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
     JOINT knee\n{\nOFFSET 0 -40 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 -40 0\n}\n}\n}\n\
     MOTION\nFrames: 2\nFrame Time: 0.01\n0 90 0 0 0 0 0 0 0\n0 91 0 5 0 0 0 10 0\n",
];

/// A subscription that only a hub takes.
const OF_A_HUB: &str = r#"{"type":"subscribe","id":1,"topics":["sensors"],"stages":["s"]}"#;

/// The stage files of the documents, and the demo's with its scenario.
const STAGES: [(&str, &str); 14] = [
    ("demo", include_str!("../../../config/demo.toml")),
    ("fastrak", include_str!("../../../config/fastrak.toml")),
    ("slimevr-receiver", include_str!("../../../config/slimevr-receiver.toml")),
    ("polhemus", include_str!("../../../config/polhemus.toml")),
    ("witmotion", include_str!("../../../config/witmotion.toml")),
    ("field-pole", include_str!("../../../config/field-pole.toml")),
    ("flock-group", include_str!("../../../config/flock-group.toml")),
    ("many-devices", include_str!("../../../config/many-devices.toml")),
    ("motionstar", include_str!("../../../config/motionstar.toml")),
    ("open-imu", include_str!("../../../config/open-imu.toml")),
    ("slimevr", include_str!("../../../config/slimevr.toml")),
    ("vrpn-anchor", include_str!("../../../config/vrpn-anchor.toml")),
    ("x-imu3-udp", include_str!("../../../config/x-imu3-udp.toml")),
    ("xbus-chain", include_str!("../../../config/xbus-chain.toml")),
];
