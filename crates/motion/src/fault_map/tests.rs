//! A figure of sixteen sensors with faults whose truth is known.

use super::memory::{Habit, Memory};
use super::rules::frame_label;
use super::*;
use posed_fusion::faults::{Cause, Mirror};

/// Offsets of the sensors from the figure's root, m: a standing person.
const FIGURE: [(&str, [f64; 3]); 8] = [
    ("pelvis", [0.0, 0.0, 0.0]),
    ("torso", [0.0, 0.0, 0.45]),
    ("head", [0.0, 0.0, 0.7]),
    ("upper_arm_r", [0.0, -0.3, 0.35]),
    ("upper_arm_l", [0.0, 0.3, 0.35]),
    ("thigh_r", [0.0, -0.1, -0.3]),
    ("thigh_l", [0.0, 0.1, -0.3]),
    ("shank_r", [0.0, -0.1, -0.7]),
];

/// A session: the figure walks about in front of the transmitter; faults by frame.
fn session(frames: usize, seed: u64, fault: impl Fn(usize, usize) -> Class) -> (Frames, Vec<Class>) {
    session_in(Mirror::Point, frames, seed, fault)
}

/// The same, in which inverted sensors are mirrored so.
fn session_in(
    mirror: Mirror,
    frames: usize,
    seed: u64,
    fault: impl Fn(usize, usize) -> Class,
) -> (Frames, Vec<Class>) {
    let mut state = seed;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 40) as f64 / (1u64 << 24) as f64 - 0.5
    };
    let mut result =
        Frames { sensors: FIGURE.iter().map(|(name, _)| (*name).to_owned()).collect(), ..Frames::default() };
    let mut classes = Vec::new();
    let phase = seed as f64;
    for k in 0..frames {
        let t = k as f64 / 60.0;
        result.t_s.push(t);
        let root = [1.5 + 0.3 * libm::sin(0.5 * t + phase), 0.4 * libm::sin(0.37 * t), 0.2];
        let mut row = Vec::new();
        for (sensor, (_, offset)) in FIGURE.iter().enumerate() {
            let class = fault(k, sensor);
            row.push(Label { class, cause: None });
            let swing = 0.03 * libm::sin(3.0 * t + sensor as f64);
            let mut p: [f64; 3] = std::array::from_fn(|c| root[c] + offset[c] + 1e-3 * random());
            p[0] += swing;
            match class {
                Class::Inverted => p = mirror.apply(p),
                Class::Anomalous => p = std::array::from_fn(|c| p[c] + 0.5 + 0.1 * random()),
                _ => {}
            }
            result.positions_m.extend(p);
        }
        classes.push(frame_label(&row).class);
    }
    (result, classes)
}

/// Like the paper's first file: inverted, anomalous, clean, anomalous.
fn like_f1(frames: usize) -> impl Fn(usize, usize) -> Class {
    move |k, sensor| match (1000 * k / frames, sensor) {
        (0..120, _) => Class::Inverted,
        (120..250, 3..6) => Class::Anomalous,
        (900.., 1..3) => Class::Anomalous,
        _ => Class::Clean,
    }
}

fn training() -> Training {
    Training { epochs: 15, ..Training::default() }
}

#[test]
fn a_whole_figure_that_flips_is_seen_although_its_distances_stay() {
    for mirror in [Mirror::Point, Mirror::Vertical] {
        let inverted = 200..400;
        let fault = |k, _| if inverted.contains(&k) { Class::Inverted } else { Class::Clean };
        let (frames, classes) = session_in(mirror, 600, 2, fault);
        let labels = Rules::learn(&frames).1;
        let by_rules: Vec<Class> = labels.frames.iter().map(|label| label.class).collect();
        assert_eq!(by_rules, classes, "{mirror:?}");
        let of_inverted = labels.sensors.chunks_exact(FIGURE.len()).skip(200).take(200).flatten();
        assert!(of_inverted.copied().all(|label| label == Label::inverted(mirror)));
    }
}

#[test]
fn a_figure_inverted_in_the_vertical_axis_is_known_live_and_sensors_near_its_plane_go_with_it() {
    // Miller et al. 2006: all sensors, and one of them.
    let bad = |k: usize, sensor: usize| match (k, sensor) {
        (100..180, _) | (300..360, _) | (500..560, 7) => Class::Inverted,
        _ => Class::Clean,
    };
    let (frames, _) = session_in(Mirror::Vertical, 1200, 6, bad);
    let (fault_map, labels) = FaultMap::train(&frames, Size::default(), &training()).unwrap();
    let (other, truth) = session_in(Mirror::Vertical, 1200, 7, |k, sensor| bad((k + 200) % 700, sensor));
    let mut watch = fault_map.watch();
    let mut right = 0;
    for (k, class) in truth.iter().enumerate() {
        let judged = watch.push(&fault_map, other.frame(k));
        right += usize::from(judged.label.class == *class);
    }
    assert!(right >= 1188, "{right} of 1200");
    let at = |k: usize, sensor: usize| labels.sensors[k * FIGURE.len() + sensor];
    assert!((0..FIGURE.len()).all(|sensor| at(150, sensor) == Label::inverted(Mirror::Vertical)));
    // One sensor that comes out there has jumped: it may come back near the plane, where nobody sees it.
    assert_eq!((at(530, 7), at(530, 2)), (Label::anomalous(Cause::Jump), Label::CLEAN));
}

#[test]
fn a_recording_that_starts_inverted_is_identified_by_head_and_feet() {
    // Inverted for most of the time: only the names say which way is up.
    for mirror in [Mirror::Point, Mirror::Vertical] {
        let (frames, classes) =
            session_in(mirror, 600, 3, |k, _| if k < 450 { Class::Inverted } else { Class::Clean });
        let labels = Rules::learn(&frames).1;
        let agree =
            labels.frames.iter().zip(&classes).filter(|(label, class)| label.class == **class).count();
        assert!(agree >= 598, "{mirror:?}: {agree}");
    }
}

#[test]
fn a_stuck_sensor_and_a_missing_one_are_reported() {
    let (mut frames, _) = session(300, 4, |_, _| Class::Clean);
    let width = 3 * FIGURE.len();
    for k in 100..130 {
        let held: Vec<f64> = frames.positions_m[99 * width + 6..99 * width + 9].to_vec();
        frames.positions_m[k * width + 6..k * width + 9].copy_from_slice(&held);
        frames.positions_m[k * width + 15..k * width + 18].fill(f64::NAN);
    }
    let labels = Rules::learn(&frames).1;
    let at = |k: usize, sensor: usize| labels.sensors[k * FIGURE.len() + sensor];
    assert_eq!(at(110, 2), Label::anomalous(Cause::Stuck));
    assert_eq!(at(110, 5), Label::MISSING);
    assert_eq!(at(110, 0), Label::CLEAN);
    assert_eq!((at(200, 2).class, at(200, 5).class), (Class::Clean, Class::Clean));
}

/// A tracker that goes through a mirror and then beyond its reach, where its words stand still, may come back on either side.
#[test]
fn a_sensor_that_was_stuck_for_long_has_no_memory_of_its_side() {
    let habit = Habit { jump_m: 0.05, step_m: 0.02, home_m: [0.8, 0.1, 0.1] };
    for (stuck_frames, class) in [(10, Class::Inverted), (100, Class::Clean)] {
        let mut memory = Memory::default();
        let mut take = |p: [f64; 3]| memory.take(p, &habit, true).class;
        (0..50).for_each(|k| assert_eq!(take([0.8, 0.1 + 1e-3 * f64::from(k), 0.1]), Class::Clean));
        assert_eq!(take([-0.8, -0.15, -0.1]), Class::Inverted);
        (0..stuck_frames).for_each(|_| _ = take([-0.9, -0.15, -0.1]));
        assert_eq!(take([-0.9, -0.15, -0.1]), Class::Anomalous);
        assert_eq!(take(if class == Class::Clean { [0.8, 0.12, 0.1] } else { [-0.85, -0.15, -0.1] }), class);
    }
}

#[test]
fn labels_agree_with_the_truth_and_overlaps_stay_at_par() {
    let (frames, classes) = session(407, 5, like_f1(407));
    let (fault_map, labels) = FaultMap::train(&frames, Size::default(), &training()).unwrap();
    let agree = labels.frames.iter().zip(&classes).filter(|(label, class)| label.class == **class).count();
    assert!(agree as f64 >= 0.95 * 407.0, "{agree} of 407");
    let report = separation(&fault_map, &frames, &classes);
    assert!(report.overlaps <= report.changeovers + 1, "{report:?}");
    assert!(report.purity > 0.98, "{report:?}");
}

#[test]
fn another_session_is_labelled_without_training() {
    let (frames, _) = session(1200, 6, like_f1(1200));
    let (fault_map, _) = FaultMap::train(&frames, Size::default(), &training()).unwrap();
    let (other, truth) = session(1200, 7, |k, sensor| match (k, sensor) {
        (300..400, _) => Class::Inverted,
        (600..700, 3..6) => Class::Anomalous,
        _ => Class::Clean,
    });
    let mut watch = fault_map.watch();
    let mut counts = [[0usize; 4]; 4];
    let mut map_alone = [[0usize; 4]; 4];
    for (k, class) in truth.iter().enumerate() {
        let judged = watch.push(&fault_map, other.frame(k));
        counts[*class as usize][judged.label.class as usize] += 1;
        map_alone[*class as usize][judged.by_map as usize] += 1;
    }
    println!("{counts:?} {map_alone:?}");
    let share = |class: Class| {
        counts[class as usize][class as usize] as f64 / counts[class as usize].iter().sum::<usize>() as f64
    };
    assert!(
        share(Class::Inverted) >= 0.98 && share(Class::Anomalous) >= 0.95 && share(Class::Clean) >= 0.99,
        "{counts:?}"
    );
}

#[test]
fn a_fault_map_survives_its_file_and_refuses_other_sensors() {
    let (frames, _) = session(100, 8, |_, _| Class::Clean);
    let size = Size { neurons: 11, side: 5 };
    let (fault_map, _) = FaultMap::train(&frames, size, &training()).unwrap();
    let text = serde_json::to_string(&fault_map).unwrap();
    assert_eq!(serde_json::from_str::<FaultMap>(&text).unwrap(), fault_map);
    for (from, to) in
        [("posed faults 4", "posed faults 9"), ("\"pelvis\",", ""), ("\"layer1\"", "\"layer9\"")]
    {
        assert!(serde_json::from_str::<FaultMap>(&text.replace(from, to)).is_err(), "{from}");
    }
    let mut other = frames.clone();
    other.sensors[0] = "tail".to_owned();
    assert!(matches!(fault_map.adapt(&other), Err(FaultMapError::Sensors { .. })));
    assert!(FaultMap::train(&Frames::default(), size, &training()).is_err());
}

#[test]
fn a_watch_that_was_stored_and_restored_goes_on_as_if_nothing_had_been() {
    let (frames, _) = session(300, 9, like_f1(300));
    let (fault_map, _) = FaultMap::train(&frames, Size { neurons: 21, side: 7 }, &training()).unwrap();
    let (mut straight, mut broken) = (fault_map.watch(), fault_map.watch());
    for k in 0..frames.len() {
        if k % 50 == 0 {
            let bytes = posed_state::snapshot(&broken);
            broken = fault_map.watch();
            posed_state::restore(&mut broken, &bytes).unwrap();
        }
        assert_eq!(straight.push(&fault_map, frames.frame(k)), broken.push(&fault_map, frames.frame(k)));
    }
}
