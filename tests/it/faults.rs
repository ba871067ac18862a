//! Faulty frames of a simulated figure: trained on one session, tested on another person's.

use posed_fusion::faults::{Class, Label};
use posed_motion::fault_map::Frames;
use posed_motion::fault_map::Training;
use posed_motion::fault_map::frame_label;
use posed_motion::fault_map::{FaultMap, Size};
use posed_simulator::figure::{Fault, Figure, Poses, SENSORS, Truth, inject};

const RATE_HZ: f64 = 60.0;

fn class(truth: Truth) -> Class {
    match truth {
        Truth::Clean => Class::Clean,
        Truth::Inverted | Truth::InvertedVertically => Class::Inverted,
        Truth::Stuck | Truth::Jump | Truth::Disturbed | Truth::Drifted => Class::Anomalous,
    }
}

fn session(seed: u64, height_m: f64, frames: usize, share: f64) -> (Frames, Vec<Class>) {
    let mut poses = Figure { seed, height_m, rate_hz: RATE_HZ, frames }.poses();
    let truth = inject(&mut poses, SENSORS.len(), RATE_HZ, seed, share, &Fault::ALL);
    let Poses { positions_m, orientations_wxyz } = poses;
    let frame = |row: &[Truth]| {
        let labels: Vec<_> = row.iter().map(|truth| Label { class: class(*truth), cause: None }).collect();
        frame_label(&labels).class
    };
    let classes = truth.chunks_exact(SENSORS.len()).map(frame).collect();
    let t_s = (0..frames).map(|k| k as f64 / RATE_HZ).collect();
    (Frames { sensors: SENSORS.map(str::to_owned).into(), t_s, positions_m, orientations_wxyz }, classes)
}

#[test]
fn a_network_of_one_person_finds_the_bad_frames_of_another() {
    let (frames, classes) = session(1, 1.78, 7200, 0.5);
    let size = Size { neurons: 41, side: 11 };
    let (fault_map, labels) = FaultMap::train(&frames, size, &Training::default()).unwrap();
    let agree = labels.frames.iter().zip(&classes).filter(|(label, class)| label.class == **class).count();
    println!("automatic labels agree in {agree} of {}", classes.len());
    assert!(agree * 100 >= 95 * classes.len());

    let mut counts = [[0usize; 4]; 4];
    for (seed, height_m) in [(101, 1.68), (102, 1.88)] {
        let (frames, classes) = session(seed, height_m, 3000, 0.4);
        let mut watch = fault_map.watch();
        for (k, class) in classes.iter().enumerate() {
            counts[*class as usize][watch.push(&fault_map, frames.frame(k)).label.class as usize] += 1;
        }
    }
    println!("{counts:?}");
    let share = |class: Class| {
        let row = &counts[class as usize];
        row[class as usize] as f64 / row.iter().sum::<usize>() as f64
    };
    assert!(share(Class::Inverted) >= 0.98 && share(Class::Anomalous) >= 0.93, "{counts:?}");
    assert!(share(Class::Clean) >= 0.97, "{counts:?}");
}
