//! Learning, labelling and the model's file on a made-up motion.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::sequence::near_borders;
use super::*;

const RATE_HZ: f64 = 30.0;

/// A figure of five joints that waves one arm, the other, or squats, 3 s each, walking and turning all the while.
fn sequence(seed: u64, segments: usize) -> (Sequence, Vec<String>, Vec<String>) {
    let joints = ["hip", "head", "hand_l", "hand_r", "foot"].map(str::to_owned).to_vec();
    let labels = ["squat", "wave left", "wave right"].map(str::to_owned).to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut sequence = Sequence { joints: 5, ..Sequence::default() };
    let mut class = 0_u16;
    let (speed, yaw, phase) =
        (rng.random_range(0.1..0.3), rng.random_range(0.0..6.0), rng.random_range(0.0..6.0));
    for frame in 0..segments * 90 {
        if frame % 90 == 0 {
            class = (class + rng.random_range(1..3)) % 3;
        }
        let t_s = frame as f64 / RATE_HZ;
        let swing = libm::sin(6.0 * t_s + phase);
        let lift = |wanted: u16| if class == wanted { 0.4 + 0.2 * swing } else { 0.0 };
        let down = if class == 0 { 0.2 + 0.2 * swing } else { 0.0 };
        let body = [
            [0.0, 0.0, 0.9 - down],
            [0.05, 0.0, 1.7 - down],
            [0.1, 0.5, 0.9 - down + lift(1)],
            [0.1, -0.5, 0.9 - down + lift(2)],
            [0.0, 0.0, 0.0],
        ];
        let angle: f64 = yaw + 0.2 * t_s;
        for [x, y, z] in body {
            let (sin, cos) = libm::sincos(angle);
            let mut noise = || rng.random_range(-0.01..0.01);
            sequence.positions_m.push(Some([
                x * cos - y * sin + speed * t_s + noise(),
                x * sin + y * cos + noise(),
                z + noise(),
            ]));
        }
        sequence.t_s.push(t_s);
        sequence.classes.push(Some(class));
    }
    (sequence, joints, labels)
}

fn options() -> Options {
    Options {
        epochs: 8,
        rate_hz: Some(15.0),
        crop_s: Some(6.0),
        batch: 4,
        filters: vec![16, 16, 24],
        learning_rate: 5e-3,
        // A crop without the hand that waves cannot be named, and there are five joints in all.
        augmentation: Augmentation { drop_joint: 0.02, ..Augmentation::default() },
        ..Options::default()
    }
}

fn trained(options: Options) -> (Model, Vec<Epoch>) {
    let (first, joints, labels) = sequence(1, 12);
    let second = sequence(2, 12).0;
    let mut trainer = Trainer::new(options, joints, &labels, vec![first, second]).unwrap();
    let mut epochs = Vec::new();
    while !trainer.is_done() {
        epochs.push(trainer.epoch());
    }
    (trainer.model(&labels, vec![("made up".to_owned(), 1)]), epochs)
}

#[test]
fn it_learns_and_survives_its_file_and_a_missing_joint() {
    let (model, epochs) = trained(options());
    assert!(epochs[7].loss < 0.5 * epochs[0].loss, "{epochs:?}");
    let model = Model::from_bytes(&model.to_bytes().unwrap()).unwrap();
    let (mut new, ..) = sequence(3, 10);
    let accuracy = |sequence: &Sequence| {
        let named = label(&model, sequence);
        let right = named.iter().zip(&sequence.classes).filter(|((class, _), truth)| Some(*class) == **truth);
        right.count() as f64 / sequence.frames() as f64
    };
    let whole = accuracy(&new);
    // Half of the borders' two frames at half the rate, and some.
    assert!(whole > 0.9, "{whole}");
    // Elsewhere, turned, and without a foot: what it sees is the same.
    for (index, position) in new.positions_m.iter_mut().enumerate() {
        *position = position.filter(|_| index % 5 != 4).map(|[x, y, z]| [5.0 - y, 7.0 + x, z]);
    }
    assert!(accuracy(&new) > whole - 0.1, "{}", accuracy(&new));
}

#[test]
fn an_image_of_more_rows_is_folded_into_the_first_layer() {
    let features = Features { rows: Some(24), ..Features::default() };
    let (model, _) = trained(Options { epochs: 1, features, ..options() });
    let folded = Model::from_bytes(&model.to_bytes().unwrap()).unwrap();
    assert_eq!((model.network.shape().inputs, folded.network.shape().inputs), (72, 15));
    assert_eq!(Model::from_bytes(&folded.to_bytes().unwrap()).unwrap(), folded);
    let (mut sequence, ..) = sequence(4, 4);
    sequence.positions_m.iter_mut().step_by(7).for_each(|position| *position = None);
    for (image, joints) in label(&model, &sequence).iter().zip(label(&folded, &sequence)) {
        assert!(image.0 == joints.0 && (image.1 - joints.1).abs() < 1e-4, "{image:?} {joints:?}");
    }
}

#[test]
fn training_depends_on_the_seed_alone_and_goes_on_where_it_stopped() {
    let options = Options { epochs: 3, ..options() };
    let (model, epochs) = trained(options.clone());
    let (first, joints, labels) = sequence(1, 12);
    let sequences = || vec![first.clone(), sequence(2, 12).0];
    let mut trainer = Trainer::new(options.clone(), joints.clone(), &labels, sequences()).unwrap();
    trainer.epoch();
    let aside = trainer.checkpoint();
    let mut resumed = Trainer::new(options.clone(), joints.clone(), &labels, sequences()).unwrap();
    resumed.resume(&aside).unwrap();
    assert_eq!(resumed.epoch(), epochs[1]);
    assert_eq!(resumed.epoch(), epochs[2]);
    assert_eq!(resumed.model(&labels, vec![("made up".to_owned(), 1)]), model);
    let mut other = Trainer::new(Options { seed: 9, ..options }, joints, &labels, sequences()).unwrap();
    assert!(other.resume(&aside).unwrap_err().contains("other options"));
    assert!(other.resume(b"x").is_err());
}

/// Frame by frame at another rate, with a gap and a missing joint, the labels of the parts are those of the parts.
#[test]
fn a_gap_ends_a_stream_and_nothing_is_said_twice() {
    let (model, _) = trained(Options { epochs: 1, ..options() });
    let (sequence, ..) = sequence(4, 4);
    let mut labeller = Labeller::new(&model);
    let mut ticks: [Vec<Tick>; 2] = [Vec::new(), Vec::new()];
    for frame in (0..sequence.frames()).filter(|frame| !(100..140).contains(frame)) {
        labeller.push(&model, sequence.t_s[frame], sequence.positions(frame), &mut |tick| {
            ticks[usize::from(tick.provisional)].push(tick);
        });
    }
    labeller.finish(&model, &mut |tick| ticks[usize::from(tick.provisional)].push(tick));
    for ticks in &ticks {
        assert!(ticks.windows(2).all(|pair| pair[0].t_s < pair[1].t_s));
        assert!(ticks.iter().all(|tick| tick.t_s < 99.5 / RATE_HZ || tick.t_s > 139.5 / RATE_HZ));
    }
    assert_eq!(ticks[0].len(), ticks[1].len());
    // 3.3 s and 7.3 s at 15 Hz.
    assert!((158..=162).contains(&ticks[0].len()), "{}", ticks[0].len());
}

#[test]
fn scores_that_no_number_holds_say_nothing_of_any_class() {
    let (mut model, _) = trained(Options { epochs: 1, ..options() });
    let shape = model.network.shape().clone();
    model.network = SegmentationNetwork::new(shape.clone(), vec![3e38; shape.parameters()]).unwrap();
    let model = Model::from_bytes(&model.to_bytes().unwrap()).unwrap();
    let (sequence, ..) = sequence(4, 2);
    let found = label(&model, &sequence);
    let least = 1.0 / model.card.labels.len() as f64;
    assert!(found.iter().all(|(_, confidence)| (confidence - least).abs() < 1e-6), "{:?}", &found[..3]);
}

#[test]
fn a_restored_labeller_goes_on_as_if_nothing_had_happened() {
    let (model, _) = trained(Options { epochs: 1, ..options() });
    let (sequence, ..) = sequence(5, 3);
    let (mut whole, mut parts) = (Vec::new(), Vec::new());
    let mut labeller = Labeller::new(&model);
    let mut other = Labeller::new(&model);
    for (frame, t_s) in sequence.t_s.iter().enumerate() {
        labeller.push(&model, *t_s, sequence.positions(frame), &mut |tick| whole.push(tick));
        other.push(&model, *t_s, sequence.positions(frame), &mut |tick| parts.push(tick));
        if frame == 130 {
            let bytes = posed_state::snapshot(&other);
            other = Labeller::new(&model);
            posed_state::restore(&mut other, &bytes).unwrap();
        }
    }
    assert_eq!(whole, parts);
}

#[test]
fn damaged_models_are_refused() {
    let (model, _) = trained(Options { epochs: 1, ..options() });
    let bytes = model.to_bytes().unwrap();
    assert!(Model::from_bytes(&bytes[..bytes.len() - 1]).is_err());
    assert!(Model::from_bytes(b"{}").is_err());
    let mut broken = model.clone();
    broken.card.decision.minimum_s.pop();
    assert!(Model::from_bytes(&broken.to_bytes().unwrap()).is_err());
    let mut broken = model.clone();
    broken.network.parameters[0] = f32::NAN;
    let error = Model::from_bytes(&broken.to_bytes().unwrap()).unwrap_err();
    assert!(error.to_string().contains("finite"), "{error}");
    // Sizes that no memory holds, each number within its range.
    let shapes: [fn(&mut Card); 4] = [
        |card| card.shape.filters = vec![8192; 8],
        |card| {
            card.preparation.rate_hz = 1000.0;
            card.decision.minimum_s.fill(600.0);
        },
        |card| {
            card.preparation.rate_hz = 1000.0;
            (card.decision.wait_s, card.decision.minimum_s[0]) = (600.0, 10.0);
        },
        |card| (card.shape.width, card.shape.filters) = (9, vec![64; 8]),
    ];
    for enlarge in shapes {
        let mut broken = model.clone();
        enlarge(&mut broken.card);
        let error = Model::from_bytes(&broken.to_bytes().unwrap()).unwrap_err().to_string();
        assert!(error.contains("less memory"), "{error}");
    }
    let mut broken = model;
    broken.card.version = 99;
    assert!(Model::from_bytes(&broken.to_bytes().unwrap()).unwrap_err().to_string().contains("version 99"));
}

#[test]
fn borders_are_as_wide_as_requested() {
    let classes: Vec<Option<u16>> = (0..100).map(|frame| Some(u16::from(frame >= 50))).collect();
    for width in [0, 1, 11, 21, 31] {
        let near = near_borders(&classes, width);
        assert_eq!(near.iter().filter(|near| **near).count(), width);
        assert!(width == 0 || near[49], "{width}");
    }
}

#[test]
fn label_noise_changes_the_share_that_it_says() {
    let mut classes = vec![Some(0_u16); 20_000];
    let spoiling = Spoiling { label_noise: 0.5, ..Spoiling::default() };
    spoiling.apply(&mut classes, 10, &mut ChaCha8Rng::seed_from_u64(1));
    let changed = classes.iter().filter(|class| **class != Some(0)).count() as f64 / 20_000.0;
    // A tenth of the random labels is right by chance.
    assert!((changed - 0.45).abs() < 0.015, "{changed}");
}

/// What the network sees does not depend on where somebody stands and faces, and gives no information about a missing joint.
#[test]
fn features_are_the_body_s_own() {
    let (sequence, joints, _) = sequence(6, 2);
    let learn = |features| {
        Preparation::learn(joints.clone(), RATE_HZ, features, std::iter::once(&sequence.positions_m[..]))
    };
    let preparation = learn(Features::BODY);
    assert_eq!(preparation.pairs, [[2, 3]]);
    assert_eq!(preparation.inputs(), 5 * 9 + 6);
    assert_eq!(learn(Features { velocities: false, ..Features::BODY }).inputs(), 5 * 6 + 3);
    let (mut memory, mut moved_memory) = (Memory::default(), Memory::default());
    for frame in 0..60 {
        let positions = sequence.positions(frame);
        let moved: Vec<Position> =
            positions.iter().map(|p| p.map(|[x, y, z]| [3.0 - y, x - 8.0, z + 1.0])).collect();
        let features = preparation.push(positions, &mut memory);
        let others = preparation.push(&moved, &mut moved_memory);
        for (a, b) in features.iter().zip(others) {
            assert!((a - b).abs() < 1e-3, "{frame}: {a} {b}");
        }
    }
    let features = preparation.push(&[None; 5], &mut memory);
    // The mean speeds stay as they were.
    assert!(features[..15].iter().all(|value| *value == 0.0), "{features:?}");
    // The paper's image: every coordinate of every joint from 0 to 1.
    let image = learn(Features::default());
    let (mut memory, mut span) = (Memory::default(), vec![(1.0_f32, 0.0_f32); image.inputs()]);
    for frame in 0..sequence.frames() {
        for ((low, high), value) in span.iter_mut().zip(image.push(sequence.positions(frame), &mut memory)) {
            (*low, *high) = (low.min(*value), high.max(*value));
        }
    }
    assert!(span.iter().all(|(low, high)| low.abs() < 1e-5 && (high - 1.0).abs() < 1e-5), "{span:?}");
    // Resized.
    let image = learn(Features { rows: Some(16), ..Features::default() });
    assert_eq!(image.inputs(), 16 * 3);
    let mut memory = Memory::default();
    for frame in 0..180 {
        let features = image.push(sequence.positions(frame), &mut memory);
        assert!(features.iter().all(|value| (-1e-5..=1.00001).contains(value)));
    }
}
