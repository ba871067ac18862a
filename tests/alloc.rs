//! By a counting allocator: no allocation per frame in the warmed pipeline, and flat memory over a simulated hour.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers of tests may panic and tell what they measured"
)]

use posed_drivers::Timestamp;
use posed_field::Prepared;
use posed_fusion::chain::calibrate;
use posed_motion::exercise::{Exercise, Options, Stream, teach};
use posed_motion::fault_map::Frames;
use posed_motion::fault_map::Training;
use posed_motion::fault_map::{FaultMap, Size};
use posed_pipeline::{Pipeline, raw_poses};
use posed_recording::{Header, Writer};
use posed_rig::counting::{Counting, allocations, live_bytes};
use posed_rig::{Rig, demo, demo_stage, field_map, leg, stage};
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::motion::{Curl, Motion};
use posed_simulator::scenario::{BodySpec, DeviceScenario, Scenario, SensorScenario};
use posed_stage::input::{Entry, Input, Model};
use posed_stage::layout::ChainLayout;
use posed_stage::output::{Outcome, OutcomeKind, Output};
use posed_stage::signals;
use posed_stage::{FieldWatch, Keyframes, RecordingContent, Stage};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_warm_pipeline_does_not_allocate() {
    let mut stage_file = stage(&[2, 1]);
    let named = |sensor: &str| sensor.to_owned();
    stage_file.field = Some(FieldWatch {
        reference_sensors: vec![named("s1-0")],
        rigid_pairs: vec![["s0-0", "s0-1"].map(named)],
        mains_hz: None,
    });
    stage_file.keyframes =
        Some(Keyframes { window_frames: 20, false_alarms_per_min: 60.0, ..Keyframes::default() });
    let flock =
        |name: &str, burst_ms| DeviceScenario { name: name.into(), burst_ms, ..DeviceScenario::default() };
    let scenario = Scenario { devices: vec![flock("d0", 16.0), flock("d1", 0.0)], ..Scenario::default() };
    let exercise = curl(&stage_file, &scenario);
    let mut rig = Rig::new(&stage_file, &curling(None, scenario.clone()));
    rig.push(Input::Model(Model::Exercise { exercise: Box::new(exercise) }));
    rig.push(Input::Model(Model::Faults { fault_map: Box::new(faults(&stage_file, &scenario)) }));
    rig.push(Input::Model(Model::Field { version: 1, map: Some(Prepared::new(field_map())) }));
    rig.run_until(12.0);

    let mut pipeline = Pipeline::new(&stage_file).unwrap();
    let warm = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 6.0);
    let (mut frames, mut exercise) = (0, 0);
    let mut feed = |pipeline: &mut Pipeline, log: &[Entry]| {
        for entry in log {
            pipeline.push(entry, &mut |output| match output {
                Output::Estimate(estimate) => {
                    frames += 1;
                    assert!(estimate.fault.is_some());
                }
                Output::Outcome(Outcome { what: OutcomeKind::Exercise(_), .. }) => exercise += 1,
                _ => {}
            });
        }
        exercise
    };
    let before_warm = feed(&mut pipeline, &rig.log[..warm]);
    let bytes = rig.log[warm..].iter().filter(|entry| matches!(entry.input, Input::Bytes { .. })).count();
    let before = allocations();
    let events = feed(&mut pipeline, &rig.log[warm..]) - before_warm;
    let taken = allocations() - before;
    assert!(frames > 500 && bytes > 500, "{frames} frames from {bytes} chunks");
    assert!(events > 3, "only {events} events of the exercise");
    assert_eq!(taken, 0, "in {frames} frames with {events} events");
}

#[test]
fn a_warm_pipeline_of_a_vrpn_server_does_not_allocate() {
    let stage_file = Stage::parse(
        "name = \"seen\"\n[[device]]\nname = \"cameras\"\ndriver = \"vrpn\"\nport = \"tcp://10.0.0.9:3883\"\n\
         trackers = [\"Head\"]\n[[sensor]]\nname = \"head\"\ndevice = \"cameras\"\naddress = 1\n",
    );
    let stage_file = stage_file.unwrap();
    let cameras = DeviceScenario { name: "cameras".into(), boot_ms: 0.0, ..DeviceScenario::default() };
    let mut rig = Rig::new(&stage_file, &Scenario { devices: vec![cameras], ..Scenario::default() });
    rig.run_until(6.0);
    let mut pipeline = Pipeline::new(&stage_file).unwrap();
    let warm = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 3.0);
    let mut good = 0;
    let mut feed = |pipeline: &mut Pipeline, log: &[Entry]| {
        for entry in log {
            pipeline.push(entry, &mut |output| {
                if let Output::Estimate(estimate) = output {
                    good += u32::from(estimate.sensors[0].usable_pose().is_some());
                }
            });
        }
        good
    };
    let before_warm = feed(&mut pipeline, &rig.log[..warm]);
    let before = allocations();
    let frames = feed(&mut pipeline, &rig.log[warm..]) - before_warm;
    let taken = allocations() - before;
    assert!(frames > 250, "{frames} good poses");
    assert_eq!(taken, 0, "in {frames} frames");
}

/// A fault map of this stage's own movements.
fn faults(stage_file: &Stage, scenario: &Scenario) -> FaultMap {
    let mut rig = Rig::new(stage_file, &curling(None, scenario.clone()));
    rig.run_until(8.0);
    let sensors = stage_file.sensors.iter().map(|sensor| sensor.name.clone()).collect();
    let mut frames = Frames { sensors, ..Frames::default() };
    for estimate in rig.estimates().filter(|estimate| estimate.t_valid.as_secs_f64() > 4.0) {
        frames.t_s.push(estimate.t_valid.as_secs_f64());
        raw_poses(estimate, &[0, 1, 2], |pose| pose.append_to(&mut frames));
    }
    let training = Training { epochs: 4, ..Training::default() };
    FaultMap::train(&frames, Size { neurons: 11, side: 5 }, &training).expect("frames").0
}

/// The first sensor on a forearm that curls, so many times.
fn curling(repetitions: Option<u32>, scenario: Scenario) -> Scenario {
    let curl = Curl { start_s: 2.5, period_s: 1.4, pause_s: 0.2, repetitions, ..Curl::default() };
    let forearm = SensorScenario {
        name: "s0-0".into(),
        body: "arm".into(),
        segment: Some("forearm".into()),
        offset_m: [0.0, -0.18, 0.04],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    let arm = BodySpec { name: "arm".into(), motion: Motion::Curl(curl) };
    Scenario { bodies: vec![arm], sensors: vec![forearm], ..scenario }
}

/// That curl, taught from five repetitions.
fn curl(stage_file: &Stage, scenario: &Scenario) -> Exercise {
    let mut rig = Rig::new(stage_file, &curling(Some(5), scenario.clone()));
    rig.run_until(13.0);
    let (mut t_s, mut values, mut row) = (Vec::new(), Vec::new(), Vec::new());
    for estimate in rig.estimates() {
        t_s.push(estimate.t_valid.as_secs_f64());
        signals::write(estimate, &mut row);
        values.extend_from_slice(&row);
    }
    let columns = signals::columns(stage_file.sensors.iter().map(|sensor| sensor.name.as_str()));
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let channels = ["s0-0_x_m", "s0-0_z_m", "s0-0_up_x"].map(str::to_owned).to_vec();
    let options =
        Options { name: "curl".into(), repetitions: 5, channels: Some(channels), ..Options::default() };
    teach(&stream, &options).expect("repetitions that were made").exercise
}

/// Ten IMUs and two trackers on a person, as in the demo; and the figure from trackers alone.
#[test]
fn a_warm_body_does_not_allocate() {
    let (demo, scenario) = demo_stage();
    let mut trackers = demo.clone();
    trackers.sensors.retain(|sensor| sensor.device == "flock");
    trackers.devices.retain(|device| device.name == "flock");
    let mut alone = scenario.clone();
    alone.sensors.retain(|sensor| !sensor.name.starts_with("imu_"));
    alone.devices.retain(|device| device.name == "flock");
    for (stage_file, scenario) in [(demo, scenario), (trackers, alone)] {
        let mut rig = Rig::new(&stage_file, &scenario);
        rig.run_until(6.0);
        let mut pipeline = Pipeline::new(&stage_file).unwrap();
        let warm = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 4.0);
        let mut bodies = 0;
        let mut feed = |pipeline: &mut Pipeline, log: &[Entry]| {
            for entry in log {
                pipeline.push(entry, &mut |output| bodies += u64::from(matches!(output, Output::Body(_))));
            }
            bodies
        };
        let before_warm = feed(&mut pipeline, &rig.log[..warm]);
        let before = allocations();
        let bodies = feed(&mut pipeline, &rig.log[warm..]) - before_warm;
        let taken = allocations() - before;
        assert!(bodies > 150, "{bodies}");
        assert_eq!(taken, 0, "in {bodies} bodies");
    }
}

/// A chain of hinges, once its axes are known.
#[test]
fn a_warm_chain_does_not_allocate() {
    let mut rig = leg::leg(1);
    rig.run_until(33.0);
    let stage_file = Stage::parse(leg::STAGE).unwrap();
    let layout = ChainLayout::of(&stage_file, 0).unwrap();
    let calibration = Box::new(calibrate(&layout.segments, &leg::epochs(&rig)).unwrap());
    let mut pipeline = Pipeline::new(&stage_file).unwrap();
    let [swapped, warm] = [20.0, 26.0].map(|s| rig.log.partition_point(|entry| entry.t.as_secs_f64() < s));
    let mut bodies = 0;
    let mut feed = |pipeline: &mut Pipeline, log: &[Entry]| {
        for entry in log {
            pipeline.push(entry, &mut |output| bodies += u64::from(matches!(output, Output::Body(_))));
        }
        bodies
    };
    feed(&mut pipeline, &rig.log[..swapped]);
    let model = Input::Model(Model::Chain { body: None, calibration });
    feed(&mut pipeline, &[Entry { t: rig.log[swapped].t, input: model }]);
    let before_warm = feed(&mut pipeline, &rig.log[swapped..warm]);
    let before = allocations();
    let bodies = feed(&mut pipeline, &rig.log[warm..]) - before_warm;
    let taken = allocations() - before;
    assert!(bodies > 500, "{bodies}");
    assert_eq!(taken, 0, "in {bodies} bodies");
}

/// Devices that the stage of all kinds does not have: a Liberty, a WitMotion sensor, boards, phones, and trackers through a receiver.
const MORE_DEVICES: &str = r#"
[[device]]
name = "liberty"
driver = "polhemus"
port = "/dev/ttyUSB2"
baud = 921600

[[device]]
name = "wit"
driver = "witmotion"
port = "/dev/ttyUSB3"

[[device]]
name = "boards"
driver = "open-imu"
port = "udp://0.0.0.0:9301"
devices = ["board"]

[[device]]
name = "lines"
driver = "open-imu"
port = "udp://0.0.0.0:9302"
devices = ["line"]

[[device]]
name = "phones"
driver = "open-imu"
port = "websocket"
devices = ["phone"]

[[device]]
name = "receiver"
driver = "slimevr"
port = "/dev/hidraw0"

[[sensor]]
name = "station"
device = "liberty"
address = 1

[[sensor]]
name = "wit"
device = "wit"
address = 0

[[sensor]]
name = "board"
device = "boards"
address = 1

[[sensor]]
name = "line"
device = "lines"
address = 1

[[sensor]]
name = "phone"
device = "phones"
address = 1

[[sensor]]
name = "by-radio"
device = "receiver"
address = 1
"#;

/// Timers apart: the server of the SlimeVR trackers speaks to each of them twice a second.
#[test]
fn a_warm_pipeline_of_many_devices_does_not_allocate_for_what_it_reads() {
    let text = format!("{}{MORE_DEVICES}", include_str!("../config/many-devices.toml"));
    let stage_file = Stage::parse(&text).unwrap();
    let mut rig = Rig::new(&stage_file, &Scenario::default());
    rig.run_until(10.0);
    let mut pipeline = Pipeline::new(&stage_file).unwrap();
    let (mut frames, mut chunks, mut taken) = (0, 0, 0);
    for entry in &rig.log {
        let warm = entry.t.as_secs_f64() > 6.0 && matches!(entry.input, Input::Bytes { .. });
        let before = allocations();
        pipeline.push(entry, &mut |output| frames += u64::from(matches!(output, Output::Estimate(_))));
        if warm {
            chunks += 1;
            taken += allocations() - before;
        }
    }
    assert!(frames > 300 && chunks > 1000, "{frames} frames, {chunks} chunks");
    assert_eq!(taken, 0, "in {chunks} chunks");
}

/// Length of a run in simulated seconds: as given, or `POSED_SOAK_S` (3600 is the hour of the criteria).
fn soak_s(otherwise: f64) -> f64 {
    std::env::var("POSED_SOAK_S").ok().and_then(|text| text.parse().ok()).unwrap_or(otherwise)
}

/// Runs so long; the memory that is held and the state must not grow from the second minute on. How many frames there were.
fn stays_flat(mut rig: Rig, end_s: f64) -> usize {
    let mut frames = 0;
    // Whole minutes, so that every sample of memory is taken at the same place between two faults.
    let mut live = Vec::with_capacity(1000);
    let mut state = Vec::with_capacity(1000);
    let mut until_s = 0.0;
    while until_s < end_s {
        until_s += 10.0;
        rig.run_until(until_s);
        frames += rig.estimates().count();
        rig.forget();
        if until_s % 60.0 == 50.0 {
            // The pipeline, and the virtual devices beside it.
            live.push(live_bytes());
            state.push(rig.pipeline.snapshot().len());
        }
    }
    println!("{end_s} s: {frames} frames; {live:?} bytes in memory, {state:?} bytes of state");
    // By then the clock's window is full.
    let (least, most) = (live[1..].iter().min().unwrap(), live[1..].iter().max().unwrap());
    assert!(most - least < 16_384, "{live:?}");
    let (least, most) = (state[1..].iter().min().unwrap(), state[1..].iter().max().unwrap());
    assert!(most - least < 16_384, "{state:?}");
    frames
}

/// A recording as the recorder writes it, flushed twice a second; the writer keeps an index of its chunks until the end.
#[test]
fn a_recording_takes_little_memory_for_its_index() {
    let header = Header { content: RecordingContent::Log, ..Header::new(&demo_stage().0, "", 0) };
    let mut writer = Writer::new(std::io::sink(), header).unwrap();
    let mut live = Vec::new();
    let halves = (2.0 * soak_s(3600.0)) as i64;
    for half in 0..halves {
        for n in 0..10 {
            let t = Timestamp::from_nanos(half * 500_000_000 + n * 50_000_000);
            let bytes = (0..200).map(|k| (k * half + n) as u8).collect();
            writer.entry(&Entry { t, input: Input::Bytes { device: (n % 2) as u16, bytes } }).unwrap();
            writer.entry(&Entry { t, input: Input::Timer }).unwrap();
        }
        writer.flush().unwrap();
        if half % 720 == 719 {
            live.push(live_bytes());
        }
    }
    let per_hour = (live[live.len() - 1] - live[0]) as f64 / (live.len() - 1) as f64 * 10.0;
    println!("{:.0} kB an hour: {live:?}", per_hour / 1e3);
    assert!(per_hour < 2.5e6, "{per_hour} bytes an hour");
}

/// The stage of `posed demo`: body, key poses, segments, the field's map.
#[test]
fn memory_of_the_demo_stays_flat() {
    let (_, mut rig) = demo();
    rig.push(Input::SegmentationNetwork(include_bytes!("../config/demo-moves.safetensors").to_vec()));
    rig.push(Input::Model(Model::Field { version: 1, map: Some(Prepared::new(field_map())) }));
    let end_s = soak_s(180.0);
    let frames = stays_flat(rig, end_s);
    assert!(frames as f64 > 90.0 * end_s, "{frames} frames");
}

#[test]
fn memory_stays_flat_however_long_it_runs() {
    let end_s = soak_s(600.0);
    let bytes = Bytes { count: end_s as u32, start_s: 5.0, end_s };
    let mut faults = vec![
        Fault::LostBytes(bytes),
        Fault::InsertedBytes(bytes),
        Fault::Bit7Flips(bytes),
        Fault::DataBitFlips(bytes),
    ];
    for minute in 1..(end_s / 60.0) as u32 {
        let at_s = f64::from(minute) * 60.0;
        faults.push(match minute % 4 {
            0 => Fault::Unplug { at_s, duration_s: Some(2.0), power: false },
            1 => Fault::BirdDies { address: 2, at_s, duration_s: Some(3.0) },
            2 => Fault::Stall { at_s, duration_s: 2.0 },
            _ => Fault::OutOfRange { address: 1, at_s, duration_s: 3.0 },
        });
    }
    let flock = DeviceScenario { name: "d0".into(), rate_hz: 100.0, faults, ..DeviceScenario::default() };
    let stage_file = stage(&[2]);
    let rig = Rig::new(&stage_file, &Scenario { devices: vec![flock], ..Scenario::default() });
    let frames = stays_flat(rig, end_s);
    assert!(frames as f64 > 90.0 * end_s, "{frames} frames");
}

/// The network of segments on a stream: features, one column per layer, minimum durations.
#[test]
fn a_warm_labeller_does_not_allocate() {
    use posed_motion::segments::{Labeller, Options, Sequence, Trainer};
    let mut sequence = Sequence { joints: 3, ..Sequence::default() };
    for frame in 0..1200_u32 {
        let t_s = f64::from(frame) / 60.0;
        sequence.t_s.push(t_s);
        for joint in [0.0, 1.0, 2.0] {
            sequence.positions_m.push(Some([libm::sin(t_s + joint), joint, libm::cos(2.0 * t_s) * joint]));
        }
        sequence.classes.push(Some((frame / 300 % 2) as u16));
    }
    let joints = ["hand_l", "hand_r", "head"].map(str::to_owned).to_vec();
    let labels = ["a", "b"].map(str::to_owned);
    let options = Options { filters: vec![8, 8, 16], ..Options::default() };
    let trainer = Trainer::new(options, joints, &labels, vec![sequence.clone()]).unwrap();
    // Random weights flicker: every path of the decoder is walked.
    let model = trainer.model(&labels, Vec::new());
    let mut labeller = Labeller::new(&model);
    let mut ticks = 0;
    let mut before = 0;
    for (frame, t_s) in sequence.t_s.iter().enumerate() {
        if frame == 600 {
            before = allocations();
        }
        labeller.push(&model, *t_s, sequence.positions(frame), &mut |_| ticks += 1);
    }
    assert!(ticks > 500, "{ticks}");
    assert_eq!(allocations() - before, 0);
}
