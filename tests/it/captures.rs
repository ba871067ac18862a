//! Recordings of real people: a motion capture as a table, and ten IMUs worn at once.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use posed_fusion::ahrs::{Ahrs, ImuSample, Params};
use posed_recording::table::{SequenceOptions, Sequences, TableReader, Unit, Up};

use posed_rig::recording;

/// Frames of each label, as the authors of the labels count them.
const LABELLED: [(&str, &[(&str, usize)]); 3] = [
    (
        "13_29",
        &[
            ("ArmCircle", 708),
            ("JumpJack", 468),
            ("KneeRaise", 1104),
            ("Squat", 788),
            ("ToeTouchOneHand", 780),
            ("Twist", 744),
        ],
    ),
    ("13_30", &[("Jog", 533), ("JumpJack", 216), ("KneeRaise", 612), ("Squat", 516), ("Twist", 588)]),
    (
        "14_20",
        &[
            ("ArmCircle", 960),
            ("JumpJack", 432),
            ("KneeRaise", 840),
            ("ToeTouchTwoHands", 1068),
            ("Twist", 432),
            ("UpDown", 912),
        ],
    ),
];

#[test]
fn a_real_motion_capture_is_read_with_its_labels_upright_and_in_metres() {
    for (name, expected) in LABELLED {
        let options = SequenceOptions { rate_hz: Some(120.0), unit: Unit::Mm, up: Up::Y };
        let path = recording("cmu-labelled", &format!("{name}.csv.gz"));
        let sequences = Sequences::read(&path, &options).unwrap();
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for frame in &sequences.frames {
            *counts.entry(frame.label.as_deref().unwrap()).or_default() += 1;
        }
        assert_eq!(counts.into_iter().collect::<Vec<_>>(), expected, "{name}");
        let joint = |joint: &str| {
            let at = sequences.joints.iter().position(|name| name == joint).unwrap();
            let positions = sequences.positions_m.chunks_exact(sequences.joints.len());
            positions.map(|row| Vector3::from(row[at].unwrap())).collect::<Vec<_>>()
        };
        let [head, root, knee, ankle] = ["head", "root", "lfemur", "ltibia"].map(joint);
        let highest_m = head.iter().map(|p| p.z).fold(f64::MIN, f64::max);
        assert!((1.4..2.4).contains(&highest_m), "{name}: the head is at most at {highest_m} m");
        // Upright but for the toe touches.
        let upright = head.iter().zip(&root).filter(|(head, root)| head.z > root.z + 0.3).count();
        assert!(upright * 10 > head.len() * 7, "{name}: {upright} of {} frames", head.len());
        // The shank is as long in every frame, but for what millimetres round off.
        let shank_m: Vec<f64> = knee.iter().zip(&ankle).map(|(knee, ankle)| (knee - ankle).norm()).collect();
        let (least, most) = (
            shank_m.iter().copied().fold(f64::MAX, f64::min),
            shank_m.iter().copied().fold(f64::MIN, f64::max),
        );
        println!("{name}: head to {highest_m:.3} m, upright {upright}, shank {least:.4} to {most:.4} m");
        assert!(most - least < 4e-3 && (0.3..0.5).contains(&least), "{name}: {least} to {most} m");
    }
}

/// There is no truth; but a person who walks about is not accelerated on average, so what the sensors feel, turned upright, is gravity.
#[test]
fn ten_body_sensors_are_levelled_while_they_move() {
    let segments = ["hip", "upper_back"].into_iter().map(str::to_owned);
    let limbs = ["upper_arm", "forearm", "upper_leg", "lower_leg"];
    let limbs = limbs.into_iter().flat_map(|limb| ["left", "right"].map(|side| format!("{limb}_{side}")));
    let mut levelled = 0;
    for sensor in segments.chain(limbs) {
        let mut table = TableReader::open(&recording("fullbody-imu", "fullbody.csv.gz")).unwrap();
        let names = ["ax", "ay", "az", "gx", "gy", "gz"].map(|name| format!("{sensor}_{name}"));
        let columns = table.require(names.each_ref().map(String::as_str)).unwrap();
        let mut ahrs = Ahrs::new(Params::default());
        let (mut felt, mut felt_in_sensor, mut count) = (Vector3::zeros(), Vector3::zeros(), 0_u32);
        let mut turned_rad = 0.0;
        for row in 0.. {
            if !table.next_row().unwrap() {
                break;
            }
            let v = columns.map(|column| table.required_number(column).unwrap());
            let accel_m_s2 = Vector3::new(v[0], v[1], v[2]);
            let gyro_rad_s = Vector3::new(v[3], v[4], v[5]);
            let up = ahrs.push(&ImuSample { gyro_rad_s, accel_m_s2, mag: None }, 0.01);
            if row >= 500 {
                felt += up * accel_m_s2;
                felt_in_sensor += accel_m_s2;
                turned_rad += gyro_rad_s.norm() * 0.01;
                count += 1;
            }
        }
        let (mean, plain) = (felt / f64::from(count), felt_in_sensor.norm() / f64::from(count));
        let tilted = mean.xy().norm();
        println!(
            "{sensor}: {:.3} m/s^2 up, {tilted:.3} across, {plain:.3} unturned; {turned_rad:.1} rad",
            mean.z
        );
        assert_eq!(count, 1500, "{sensor}");
        // Uncalibrated, some say 3 % too much; at most 0.08 across was seen.
        assert!((mean.z - 9.81).abs() < 0.35 && tilted < 0.15, "{sensor}: {mean}");
        levelled += 1;
    }
    assert_eq!(levelled, 10);
}
