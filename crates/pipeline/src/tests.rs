//! Input without sense, and stages without sense.

use posed_drivers::{LineEvent, Measurement, Timestamp};
use posed_stage::input::Model;
use posed_stage::output::{Outcome, OutcomeKind};

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
fn a_snapshot_that_was_damaged_is_refused() {
    let mut pipeline = Pipeline::new(&stage(STAGE)).unwrap();
    let opened = Input::Line { device: 0, event: LineEvent::Opened { modem_lines: false } };
    pipeline.push(&Entry { t: Timestamp::from_secs_f64(1.0), input: opened }, &mut |_| {});
    let snapshot = pipeline.snapshot();
    let restore = |bytes: &[u8]| Pipeline::restore(&stage(STAGE), pipeline.models(), bytes);
    assert!(restore(&snapshot).is_ok());
    for at in (0..snapshot.len()).step_by(7).chain(snapshot.len() - 8..snapshot.len()) {
        for value in [snapshot[at] ^ 1, snapshot[at] ^ 0x80, !snapshot[at]] {
            let mut damaged = snapshot.clone();
            damaged[at] = value;
            assert!(restore(&damaged).is_err(), "byte {at} as {value}");
        }
        assert!(restore(&snapshot[..at]).is_err(), "its first {at} bytes");
    }
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
fn losses_beyond_what_a_port_ever_brings_overflow_no_sum() {
    let configs =
        [include_str!("../../../config/many-devices.toml"), include_str!("../../../config/fastrak.toml")];
    for text in configs {
        let stage = stage(text);
        let mut pipeline = Pipeline::new(&stage).unwrap();
        let mut t = Timestamp::ZERO;
        for device in (0..).take(stage.devices.len()) {
            let line = |event| Input::Line { device, event };
            let dropped = || line(LineEvent::Dropped { bytes: u64::MAX });
            let bytes = || Input::Bytes { device, bytes: vec![0x80; 64] };
            let opened = line(LineEvent::Opened { modem_lines: false });
            for input in [opened, dropped(), bytes(), dropped(), Input::Timer, bytes(), dropped()] {
                t = t + std::time::Duration::from_secs(1);
                pipeline.push(&Entry { t, input }, &mut |_| {});
            }
        }
        assert_eq!(pipeline.status().entries_left_out, 0);
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
            after_loss: k % 7 == 0,
        };
        let sample = Sample {
            address: 1 + (k % 2) as u16,
            arrival,
            t_device: posed_drivers::DeviceTime::Cycle(k * k % 1000),
            measurement: Measurement::Pose {
                position_m: Some([value, 0.0, 0.3]),
                clipped: false,
                orientation_wxyz: Some([1.0, 0.0, value, 0.0]),
                button: None,
            },
        };
        pipeline.sample(0, &sample);
        pipeline.close_frames(&mut |output| {
            if let Output::Estimate(estimate) = output {
                good += estimate
                    .sensors
                    .iter()
                    .filter(|s| s.state == posed_stage::output::SensorState::Ok)
                    .count();
            }
        });
    }
    assert_eq!(good, 0);
}

fn model(file: &[u8]) -> segments::Model {
    segments::Model::from_bytes(file).unwrap()
}

/// A model of two joints with random weights, as a file.
fn random_model(joints: [&str; 2]) -> Vec<u8> {
    use posed_motion::segments::{Options, Sequence, Trainer};
    let mut sequence = Sequence { joints: 2, ..Sequence::default() };
    for frame in 0..90 {
        let t_s = f64::from(frame) / 30.0;
        sequence.t_s.push(t_s);
        sequence.positions_m.extend([Some([libm::sin(t_s), 0.5, 0.0]), Some([0.0, -0.5, libm::cos(t_s)])]);
        sequence.classes.push(Some(u16::from(frame > 45)));
    }
    let options = Options { filters: vec![8, 8], wait_s: 0.5, ..Options::default() };
    let labels = ["rest", "wave"].map(str::to_owned);
    let trainer = Trainer::new(options, joints.map(str::to_owned).to_vec(), &labels, vec![sequence]).unwrap();
    trainer.model(&labels, Vec::new()).to_bytes().unwrap()
}

#[test]
fn a_network_of_other_sensors_is_refused() {
    let mut pipeline = Pipeline::new(&stage(STAGE)).unwrap();
    for bytes in [b"no model".to_vec(), random_model(["nobody", "no_one"])] {
        let input = Input::SegmentationNetwork(bytes);
        pipeline.push(&Entry { t: Timestamp::ZERO, input }, &mut |output| panic!("{output:?}"));
    }
    assert_eq!(pipeline.status().models_refused, 2);
    assert!(pipeline.naming.is_empty());
}

/// Joints that are not there yet, and a body that from one frame to the next stands elsewhere, for trackers show its place now, are no
/// movement.
#[test]
fn where_a_body_is_put_is_no_movement() {
    use posed_fusion::body::{ANGLES, AngleSpread, BodySegment, Heading, SEGMENTS, Skeleton, upright};
    use posed_stage::output::{Body, PositionSource, SegmentEstimate};
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/demo-moves.safetensors");
    let mut naming =
        naming::Naming::new(model(&std::fs::read(path).unwrap()), [].into_iter(), Some(0), &BodySegment::ALL)
            .unwrap();
    let skeleton = Skeleton::from_height(1.75);
    let standing = [upright(); SEGMENTS];
    let mut labels = Vec::new();
    for frame in 0..600_u32 {
        let t_s = f64::from(frame) / 100.0;
        let mut pelvis_m = skeleton.standing_m(&standing);
        let position_source = if frame < 160 { PositionSource::Origin } else { PositionSource::Trackers };
        if position_source == PositionSource::Trackers {
            pelvis_m += nalgebra::Vector3::new(2.0, 1.0, 0.0);
        }
        let segment = |origin_m: &nalgebra::Vector3<f64>| SegmentEstimate {
            position_m: (frame >= 40).then_some((*origin_m).into()),
            ..SegmentEstimate::default()
        };
        let body = Body {
            index: 0,
            t_valid: Timestamp::from_secs_f64(t_s),
            heading: Heading::Field,
            heading_sigma_rad: Some(0.02),
            position_source,
            position_sigma_m: Some(0.02),
            contacts: None,
            segments: skeleton.origins_m(&standing, pelvis_m).iter().map(segment).collect(),
            angles_rad: [None; ANGLES],
            spread: AngleSpread::default(),
        };
        let estimate = Estimate { t_valid: body.t_valid, ..Estimate::default() };
        naming.push(&estimate, Some(&body), &mut |output| {
            if let Output::Outcome(Outcome { t_valid, what: OutcomeKind::MotionSegment(segment), .. }) =
                output
            {
                labels.push((t_valid.as_secs_f64(), segment.label.clone()));
            }
        });
    }
    assert!(!labels.is_empty() && labels.iter().all(|(_, label)| label == "standing"), "{labels:?}");
    assert!(labels.iter().all(|(t_s, _)| *t_s >= 0.4 - 1e-9), "{labels:?}");
}

/// Every segment that is provisional is confirmed or withdrawn once, confirmed ones rise, and none comes later than
/// is stated; a restored pipeline goes on with the same events.
#[test]
fn segments_are_announced_and_decided() {
    use posed_stage::output::{MotionSegment, PoseEstimate, SegmentEvent, SensorState};
    let mut naming =
        naming::Naming::new(model(&random_model(["a", "b"])), ["a", "b"].map(Some).into_iter(), None, &[])
            .unwrap();
    let mut estimate = Estimate { sensors: vec![SensorEstimate::default(); 2], ..Estimate::default() };
    let mut events: Vec<(f64, f64, MotionSegment)> = Vec::new();
    for frame in 0..1500_u32 {
        let t_s = f64::from(frame) / 60.0;
        estimate.t_valid = Timestamp::from_secs_f64(t_s);
        let wild = if frame / 200 % 2 == 0 { 0.2 } else { 3.0 };
        for (index, sensor) in estimate.sensors.iter_mut().enumerate() {
            let side = index as f64 - 0.5;
            let position_m =
                Some([libm::sin(wild * 9.0 * t_s) * wild, side, libm::cos(7.0 * t_s) * wild * side]);
            *sensor = SensorEstimate {
                state: SensorState::Ok,
                pose: Some(PoseEstimate {
                    position_m,
                    orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
                    velocity_m_s: None,
                    angular_velocity_rad_s: [0.0; 3],
                    covariance: [0.0; 21],
                    sigma_m: None,
                }),
                ..SensorEstimate::default()
            };
        }
        naming.push(&estimate, None, &mut |output| {
            if let Output::Outcome(Outcome { t_valid, what: OutcomeKind::MotionSegment(segment), .. }) =
                output
            {
                events.push((t_s, t_valid.as_secs_f64(), segment.clone()));
            }
        });
        if frame == 700 {
            let bytes = posed_state::snapshot(&naming);
            naming = naming::Naming::new(
                model(&random_model(["a", "b"])),
                ["a", "b"].map(Some).into_iter(),
                None,
                &[],
            )
            .unwrap();
            posed_state::restore(&mut naming, &bytes).unwrap();
        }
    }
    let of = |event: SegmentEvent| events.iter().filter(move |(.., segment)| segment.event == event);
    assert!(
        of(SegmentEvent::Provisional).count() > 0 && of(SegmentEvent::Confirmed).count() > 0,
        "{events:?}"
    );
    let mut last = f64::NEG_INFINITY;
    for (said_s, start_s, segment) in of(SegmentEvent::Confirmed) {
        assert!(*start_s > last && said_s - start_s <= segment.delay_s + 1.0 / 24.0 + 1e-6, "{events:?}");
        last = *start_s;
    }
    for (.., segment) in of(SegmentEvent::Provisional) {
        let ends = events.iter().filter(|(.., other)| {
            other.segment == segment.segment && other.event != SegmentEvent::Provisional
        });
        assert!(ends.count() <= 1, "{segment:?}: {events:?}");
    }
    // A model that takes its place leaves nothing open, and goes on counting.
    let mut next =
        naming::Naming::new(model(&random_model(["a", "b"])), ["a", "b"].map(Some).into_iter(), None, &[])
            .unwrap();
    next.follow(&mut naming, estimate.t_valid, &mut |output| {
        if let Output::Outcome(Outcome { what: OutcomeKind::MotionSegment(segment), .. }) = output {
            assert_eq!(segment.event, SegmentEvent::Withdrawn);
            events.push((0.0, 0.0, segment.clone()));
        }
    });
    let numbers = |wanted: fn(SegmentEvent) -> bool| {
        let of = events.iter().filter(move |(.., segment)| wanted(segment.event));
        of.map(|(.., segment)| segment.segment).collect::<std::collections::BTreeSet<_>>()
    };
    let begun = numbers(|event| event == SegmentEvent::Provisional);
    assert!(begun.is_subset(&numbers(|event| event != SegmentEvent::Provisional)), "{events:?}");
    let mut first = None;
    for frame in 0..200_u32 {
        estimate.t_valid = Timestamp::from_secs_f64(30.0 + f64::from(frame) / 60.0);
        next.push(&estimate, None, &mut |output| {
            if let Output::Outcome(Outcome { what: OutcomeKind::MotionSegment(segment), .. }) = output {
                first.get_or_insert(segment.segment);
            }
        });
    }
    assert!(first > begun.last().copied(), "{first:?} after {begun:?}");
}
