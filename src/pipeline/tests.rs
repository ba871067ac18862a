//! Input without sense, and stages without sense.

use posed_drivers::{LineEvent, Measurement, Timestamp};

use super::*;

const STAGE: &str = r#"
name = "test"
[[device]]
name = "d"
driver = "flock-of-birds"
port = "none"
[[sensor]]
name = "a"
device = "d"
address = 1
[[sensor]]
name = "b"
device = "d"
address = 2
"#;

fn stage(text: &str) -> Stage {
    toml::from_str(text).unwrap()
}

#[test]
fn a_stage_that_contradicts_itself_is_refused_with_a_sentence() {
    let cases = [
        (STAGE.replace("device = \"d\"", "device = \"e\""), "sensor \"a\" belongs to device \"e\""),
        (STAGE.replace("address = 2", "address = 1"), "device \"d\""),
        (format!("frame_rate_hz = 0.0\n{STAGE}"), "frame_rate_hz: expected"),
        (format!("frame_wait_ms = -1.0\n{STAGE}"), "frame_wait_ms: expected"),
        (STAGE.replace("port", "baud = 0\nport"), "baud: expected"),
    ];
    for (text, expected) in cases {
        let error = Pipeline::new(&stage(&text)).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_stage_without_devices_is_a_pipeline_without_outputs() {
    let mut pipeline = Pipeline::new(&stage("name = \"empty\"")).unwrap();
    pipeline.push(&Entry { t: Timestamp::ZERO, input: Input::Timer }, &mut |output| panic!("{output:?}"));
    assert_eq!(pipeline.poll_timeout(), None);
}

#[test]
fn models_without_sense_are_counted_and_not_used() {
    let mut pipeline = Pipeline::new(&stage(STAGE)).unwrap();
    let noise = |device: &str, r0_m| Model::TrackerNoise {
        device: device.into(),
        r0_m,
        sigma_radial_m: 1e-4,
        sigma_rotation_rad: 1e-3,
    };
    let models = [
        Model::Transmitter { position_m: [f64::NAN, 0.0, 0.0], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] },
        Model::Transmitter { position_m: [0.0; 3], orientation_wxyz: [0.0; 4] },
        noise("nobody", 1.0),
        noise("d", 0.0),
    ];
    for model in models {
        let input = Input::Model(model);
        pipeline.push(&Entry { t: Timestamp::ZERO, input }, &mut |output| panic!("{output:?}"));
    }
    assert_eq!(pipeline.status().models_refused, 4);
    let mut swapped = 0;
    let input = Input::Model(noise("d", 1.0));
    pipeline.push(&Entry { t: Timestamp::ZERO, input }, &mut |_| swapped += 1);
    assert_eq!(swapped, 1);
}

#[test]
fn entries_without_sense_do_no_harm() {
    let mut random = 1_u64;
    let mut next = |bound: u64| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) % bound
    };
    for rate in ["", "frame_rate_hz = 30.0\n"] {
        let mut pipeline = Pipeline::new(&stage(&format!("{rate}{STAGE}"))).unwrap();
        let mut t = 0_i64;
        let mut last = None;
        for _ in 0..20_000 {
            t += next(20_000_000) as i64 - 2_000_000;
            // One device more than there is.
            let device = next(8).min(1) as DeviceIndex ^ 1;
            let input = match next(20) {
                0 => Input::Line { device, event: LineEvent::Opened { modem_lines: next(2) == 0 } },
                1 if next(50) == 0 => {
                    Input::Line { device, event: LineEvent::Closed { reason: "gone".into() } }
                }
                2 => Input::Line { device, event: LineEvent::Dropped { bytes: next(100) } },
                3..8 => Input::Timer,
                _ => Input::Bytes { device, bytes: (0..next(40)).map(|_| next(256) as u8).collect() },
            };
            pipeline.push(&Entry { t: Timestamp::from_nanos(t), input }, &mut |output| {
                if let Output::Estimate(estimate) = output {
                    assert!(last.is_none_or(|last| last < estimate.t_valid));
                    last = Some(estimate.t_valid);
                }
            });
        }
    }
}

#[test]
fn samples_without_sense_are_never_good() {
    let mut pipeline = Pipeline::new(&stage(STAGE)).unwrap();
    let mut good = 0;
    for k in 0..500_u64 {
        let now = Timestamp::from_nanos(k as i64 * 10_000_000);
        pipeline.now = now;
        let value = [f64::NAN, f64::INFINITY, 1e300][k as usize % 3];
        let arrival = posed_drivers::Arrival {
            t_read: now,
            t_previous_read: Some(now),
            bytes_after: u32::MAX,
            cycle_bytes_before: (k % 7) as u32 * 1_000_000,
            split: k % 5 == 0,
        };
        let sample = Sample {
            address: 1 + (k % 2) as u16,
            arrival,
            t_device: posed_drivers::DeviceTime::Cycle(k * k % 1000),
            measurement: Measurement::Pose {
                position_m: Some([value, 0.0, 0.3]),
                orientation_wxyz: Some([1.0, 0.0, value, 0.0]),
                button: None,
            },
        };
        pipeline.sample(0, &sample);
        pipeline.close_frames(&mut |output| {
            if let Output::Estimate(estimate) = output {
                good += estimate.sensors.iter().filter(|s| s.state == crate::output::SensorState::Ok).count();
            }
        });
    }
    assert_eq!(good, 0);
}
