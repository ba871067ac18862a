//! Flips, repetitions and outliers against a known prediction.

use nalgebra::Matrix3;

use super::*;
use posed_geometry::so3;

const NOISE: TrackerNoise = TrackerNoise { r0_m: 1.0, sigma_radial_m: 1e-4, sigma_rotation_rad: 1e-3 };

fn expected(position_m: Vector3<f64>) -> Prediction {
    Prediction {
        position_m,
        orientation: so3::exp(&Vector3::new(0.3, -0.2, 1.0)),
        position_m2: Matrix3::identity() * 1e-6,
        rotation_rad2: Matrix3::identity() * 1e-5,
        position_noise_scale: 1.0,
        rotation_noise_scale: 1.0,
        position_doubt_m2: 0.0,
        reach_m: 0.02,
        reach_rad: 0.08,
    }
}

fn measured(prediction: &Prediction) -> MeasuredPose {
    MeasuredPose { position_m: Some(prediction.position_m), orientation: Some(prediction.orientation) }
}

#[test]
fn what_was_expected_is_clean_and_a_quaternions_sign_is_no_fault() {
    let prediction = expected(Vector3::new(0.4, 0.1, -0.2));
    let mut pose = measured(&prediction);
    let mut detector = Detector::default();
    assert_eq!(detector.check(&pose, Some(&prediction), &NOISE, false, None).label, Label::CLEAN);
    let negative = -prediction.orientation.into_inner();
    pose.orientation = Some(UnitQuaternion::new_unchecked(negative));
    assert_eq!(detector.check(&pose, Some(&prediction), &NOISE, false, None).label, Label::CLEAN);
}

#[test]
fn mirrored_positions_are_mirrored_back_each_by_its_own_prediction() {
    // The whole figure flips: mutual distances stay, so each sensor must be judged by where it was.
    for position_m in [[0.4, 0.1, -0.2], [0.5, -0.3, 0.3], [0.6, 0.2, 0.1]] {
        let prediction = expected(Vector3::from(position_m));
        for mirror in [Mirror::Point, Mirror::Vertical] {
            let mut detector = Detector::default();
            let pose = measured(&prediction).mirrored(mirror);
            let checked = detector.check(&pose, Some(&prediction), &NOISE, false, None);
            assert_eq!((checked.label, checked.pose), (Label::inverted(mirror), measured(&prediction)));
            // Without a prediction it is still there.
            let moved = MeasuredPose { position_m: pose.position_m.map(|p| p * 1.01), ..pose };
            let checked = detector.check(&moved, None, &NOISE, false, None);
            assert_eq!((checked.label, checked.pose), (Label::inverted(mirror), moved.mirrored(mirror)));
        }
    }
}

#[test]
fn what_is_far_from_its_prediction_is_offered_to_the_track_on_the_nearer_side() {
    // A mirrored sensor that was away for 0.4 s, and has moved 0.2 m aside.
    let prediction = expected(Vector3::new(0.6, 0.1, 0.2));
    let position_m = Vector3::new(0.55, 0.1, 0.0);
    let pose = MeasuredPose { position_m: Some(position_m), ..measured(&prediction) };
    for mirrored in [pose.mirrored(Mirror::Point), pose] {
        let checked = Detector::default().check(&mirrored, Some(&prediction), &NOISE, false, None);
        assert_eq!((checked.label, checked.pose), (Label::anomalous(Cause::Gate), pose));
    }
}

#[test]
fn what_was_predicted_a_little_wrongly_beside_the_plane_of_symmetry_is_not_mirrored() {
    // 7 mm from where it is expected, and 5.5 mm from there once it is mirrored.
    let prediction = expected(Vector3::new(0.4, 0.1, -0.003));
    let at = |z_m: f64| MeasuredPose {
        position_m: Some(Vector3::new(0.4, 0.104, z_m)),
        orientation: Some(prediction.orientation),
    };
    let check = |pose| Detector::default().check(&pose, Some(&prediction), &NOISE, false, None);
    assert_eq!(prediction.gate(&at(0.003).mirrored(Mirror::Vertical), &NOISE), Gate::Inside);
    assert_eq!(check(at(0.003)).label, Label::anomalous(Cause::Gate));
    // What jumps is.
    let prediction = expected(Vector3::new(0.4, 0.1, -0.01));
    let jumped = measured(&prediction).mirrored(Mirror::Vertical);
    assert_eq!(
        Detector::default().check(&jumped, Some(&prediction), &NOISE, false, None).label,
        Label::inverted(Mirror::Vertical)
    );
}

#[test]
fn with_nothing_to_judge_by_the_side_nearer_to_where_it_was_counts() {
    let prediction = expected(Vector3::new(0.4, 0.1, -0.2));
    let pose = measured(&prediction);
    let moved =
        |pose: &MeasuredPose, by: f64| MeasuredPose { position_m: pose.position_m.map(|p| p * by), ..*pose };
    let mirrored = pose.mirrored(Mirror::Point);
    for (first, then) in [(pose, mirrored), (mirrored, pose), (pose, pose), (mirrored, mirrored)] {
        let mut detector = Detector::default();
        let checked = detector.check(&first, Some(&prediction), &NOISE, false, None);
        assert_eq!(checked.pose, pose);
        // It was turned over, or set right, while nobody looked.
        let checked = detector.check(&moved(&then, 1.05), None, &NOISE, false, None);
        assert_eq!(checked.pose, moved(&pose, 1.05));
        assert_eq!(checked.label == Label::INVERTED, then == mirrored);
    }
}

#[test]
fn a_prediction_that_holds_both_sides_leaves_it_to_where_the_sensor_was() {
    let narrow = expected(Vector3::new(0.4, 0.1, -0.2));
    let pose = measured(&narrow);
    // Half a second ahead, a line goes through the transmitter.
    for ahead in [1.0, 0.1, -1.0] {
        let position_m = narrow.position_m * ahead;
        let wide = Prediction { position_m2: Matrix3::identity(), reach_m: 5.0, position_m, ..narrow };
        let mut detector = Detector::default();
        detector.check(&pose, Some(&narrow), &NOISE, false, None);
        let mut check = |pose: &MeasuredPose| detector.check(pose, Some(&wide), &NOISE, false, None);
        let checked = check(&pose.mirrored(Mirror::Point));
        assert_eq!((checked.label, checked.pose), (Label::INVERTED, pose));
        assert_eq!(check(&pose).label, Label::CLEAN);
    }
}

#[test]
fn what_repeats_itself_from_the_first_record_on_begins_no_track_until_it_is_known_to_rest() {
    let pose = measured(&expected(Vector3::new(0.4, 0.1, -0.2)));
    let mut detector = Detector::default();
    let taken: Vec<bool> =
        (0..50).map(|_| detector.check(&pose, None, &NOISE, false, None).withheld).collect();
    assert_eq!(taken, [&[false][..], &[true; 44], &[false; 5]].concat());
}

#[test]
fn what_was_seen_to_move_and_repeats_itself_after_a_break_begins_no_track_before_it_changes() {
    let mut detector = Detector::default();
    for k in 0..100 {
        let expected = expected(Vector3::new(0.4 + 0.002 * f64::from(k), 0.1, -0.2));
        assert!(!detector.check(&measured(&expected), Some(&expected), &NOISE, false, None).withheld);
    }
    let mut seen = |x_m| {
        let pose = measured(&expected(Vector3::new(x_m, 0.1, -0.2)));
        detector.check(&pose, None, &NOISE, false, None).withheld
    };
    // The first of them may be new; the words of a device that stands still say nothing for as long as one looks.
    assert!(!seen(0.7));
    assert!((0..1000).all(|_| seen(0.7)));
    assert!(!seen(0.7001));
}

#[test]
fn a_mirrored_position_with_another_orientation_is_an_outlier() {
    let prediction = expected(Vector3::new(0.4, 0.1, -0.2));
    let turned = prediction.orientation * so3::exp(&Vector3::new(0.0, 0.5, 0.0));
    let pose = MeasuredPose { position_m: Some(-prediction.position_m), orientation: Some(turned) };
    let checked = Detector::default().check(&pose, Some(&prediction), &NOISE, false, None);
    assert_eq!(checked, Checked::anomalous(pose, Cause::Gate, false));
}

#[test]
fn a_sensor_that_was_moving_is_suspect_at_the_first_repetition_and_stuck_at_the_fifth() {
    let mut detector = Detector::default();
    let frozen = measured(&expected(Vector3::new(0.4, 0.1, -0.2)));
    let labels: Vec<_> = (0..7)
        .map(|k| {
            let prediction = expected(Vector3::new(0.4 + 0.005 * f64::from(k), 0.1, -0.2));
            let checked = detector.check(&frozen, Some(&prediction), &NOISE, false, None);
            assert_eq!(checked.withheld, k > 0);
            checked.label
        })
        .collect();
    let [suspect, stuck] = [Cause::Gate, Cause::Stuck].map(Label::anomalous);
    assert_eq!(labels, [Label::CLEAN, suspect, suspect, suspect, stuck, stuck, stuck]);
}

#[test]
fn a_sensor_at_rest_may_repeat_itself_until_others_move_unless_it_is_used_to() {
    let prediction = expected(Vector3::new(0.4, 0.1, -0.2));
    let pose = measured(&prediction);
    let mut detector = Detector::default();
    for _ in 0..20 {
        assert_eq!(detector.check(&pose, Some(&prediction), &NOISE, false, None).label, Label::CLEAN);
    }
    assert_eq!(
        detector.check(&pose, Some(&prediction), &NOISE, true, None).label,
        Label::anomalous(Cause::Stuck)
    );

    let mut habitual = Detector::default();
    for _ in 0..200 {
        habitual.check(&pose, Some(&prediction), &NOISE, false, None);
    }
    assert_eq!(habitual.check(&pose, Some(&prediction), &NOISE, true, None).label, Label::CLEAN);
}

#[test]
fn a_gate_that_is_wide_for_want_of_knowledge_does_not_vouch_for_a_jump() {
    let mut prediction = expected(Vector3::new(0.4, 0.1, -0.2));
    prediction.position_m2 = Matrix3::identity() * 1e-2;
    let mut pose = measured(&prediction);
    pose.position_m = Some(prediction.position_m + Vector3::new(0.0286, 0.0, 0.0));
    assert_eq!(prediction.gate(&pose, &NOISE), Gate::Loose);
    pose.position_m = Some(Vector3::repeat(f64::NAN));
    assert_eq!(prediction.gate(&pose, &NOISE), Gate::Outside);
}

#[test]
fn the_map_alone_says_in_which_mirror_a_sensor_is() {
    let prediction = expected(Vector3::new(0.4, 0.1, -0.2));
    for mirror in [Mirror::Point, Mirror::Vertical] {
        let pose = measured(&prediction).mirrored(mirror);
        let by_map = Some(Label::inverted(mirror));
        let checked = Detector::default().check(&pose, None, &NOISE, false, by_map);
        let expected = (Label::inverted(mirror), measured(&prediction), Some(Repair::Mirrored));
        assert_eq!((checked.label, checked.pose, checked.repair), expected);
        // Where something is tracked, which mirror it is shows by itself.
        let other = Some(Label::inverted(Mirror::Point));
        let checked = Detector::default().check(&pose, Some(&prediction), &NOISE, false, other);
        assert_eq!((checked.label, checked.pose, checked.repair), expected);
    }
}

#[test]
fn what_else_knows_the_place_counts_before_the_map() {
    let prediction = expected(Vector3::new(0.4, 0.1, -0.2));
    let mut records = 0.0;
    // No two records are the same.
    let mut pose = || {
        records += 1e-6;
        let position_m = Some(prediction.position_m + Vector3::new(records, 0.0, 0.0));
        MeasuredPose { position_m, ..measured(&prediction) }
    };
    let by_map = Some(Label::INVERTED);
    let mut detector = Detector::default();
    detector.check(&pose().mirrored(Mirror::Point), Some(&prediction), &NOISE, false, None);
    detector.known_at(prediction.position_m + Vector3::new(0.05, 0.0, 0.05));
    assert_eq!(detector.check(&pose(), None, &NOISE, false, by_map).label, Label::CLEAN);
    for _ in 0..2 * CONVINCED_RECORDS {
        assert_eq!(detector.check(&pose(), Some(&prediction), &NOISE, true, by_map).label, Label::CLEAN);
    }
    // What is known halfway between both sides says nothing, and the next track is another one.
    for known_m in [Some(Vector3::new(0.01, 0.0, 0.0)), None] {
        known_m.into_iter().for_each(|known_m| detector.known_at(known_m));
        detector.check(&pose(), None, &NOISE, false, by_map);
        let check = |_| detector.check(&pose(), Some(&prediction), &NOISE, true, by_map).label;
        assert_eq!((0..CONVINCED_RECORDS).map(check).last(), Some(Label::INVERTED));
    }
}
