//! Which way a body is found to face that is calibrated by a walk alone: the table *Nothing but a walk* of `docs/body.md`. `cargo bench --bench body walks`

use std::sync::Arc;

use nalgebra::Vector3;
use posed_fusion::body::{
    Block, BlockKind, BodyFilter, BodyParams, BodySegment, Recorded, SEGMENTS, SensorMount, Skeleton,
    calibrate,
};
use posed_geometry::so3;
use posed_simulator::body::take::Take;
use posed_simulator::body::{Activity, Build, Script, SensorErrors, Wearer, WearerSpec};

use super::{HEIGHT_M, RATE_HZ, Sensors, emit, outcomes, people, recorded};

const PEOPLE: u64 = 6;
/// How long each walks, s.
const WALKS_S: f64 = 20.0;
/// And how long whoever is taken to face the other way goes on, ahead, s.
const AFTER_S: f64 = 60.0;
/// A body that is turned less about the vertical faces as it does, degrees.
const RIGHT_DEG: f64 = 30.0;

/// What becomes of one walk: the body faces as it does, by so many degrees; the walk was refused; a minute ahead showed that it had been taken for backwards; or
/// it goes on backwards.
enum Walk {
    Right(f64),
    Refused,
    Healed,
    Wrong,
}

fn wearer(activity: Activity, build: Build, seed: u64) -> Wearer {
    Wearer::new(WearerSpec {
        script: Script { activity, calibration: false, facing: 0.6, mistake: None },
        build,
        errors: SensorErrors::calibrated(),
        magnetometer: true,
        disturbances: Vec::new(),
        rate_hz: RATE_HZ,
        clumsiness_rad: 0.03,
        seed,
    })
}

/// How far the body is turned about the vertical, degrees.
fn turned_deg(mounts: &[Option<SensorMount>; SEGMENTS], wearer: &Wearer) -> f64 {
    let pelvis = BodySegment::Pelvis.index();
    let Some(mount) = mounts[pelvis] else { return f64::NAN };
    let off = mount.q_segment_sensor * wearer.mounting(pelvis).0.inverse();
    so3::log(&off).dot(&Vector3::y()).to_degrees().abs()
}

/// The walk of that person, and what a calibration makes of it; `then` is where a minute of it after goes.
fn walk(wearer: &mut Wearer, then: Option<Arc<Take>>) -> Walk {
    let step = |wearer: &mut Wearer| {
        let (samples, at) = wearer.step();
        (at.t_s, recorded(&samples, Sensors::Ten))
    };
    let recording: Vec<Recorded> = (0..(WALKS_S * RATE_HZ) as usize).map(|_| step(wearer)).collect();
    let block = Block { kind: BlockKind::Walk, start_s: f64::NEG_INFINITY, end_s: f64::INFINITY };
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let Ok(found) = calibrate(&recording, &[block], &skeleton, &[None; SEGMENTS]) else {
        return Walk::Refused;
    };
    let off_deg = turned_deg(&found.mounts, wearer);
    if off_deg < RIGHT_DEG {
        return Walk::Right(off_deg);
    }
    if let Some(then) = then {
        wearer.follow(then);
    }
    let mut filter = BodyFilter::new(&skeleton, &found.mounts, &BodyParams::default());
    for _ in 0..(AFTER_S * RATE_HZ) as usize {
        filter.push(&step(wearer).1, 1.0 / RATE_HZ);
    }
    if turned_deg(&filter.mounts(), wearer) < RIGHT_DEG { Walk::Healed } else { Walk::Wrong }
}

fn emit_row(name: &str, walks: &[Walk]) {
    let count = |of: fn(&Walk) -> bool| walks.iter().filter(|walk| of(walk)).count();
    let words = [
        (count(|walk| matches!(walk, Walk::Right(_))), "right"),
        (count(|walk| matches!(walk, Walk::Refused)), "refused"),
        (count(|walk| matches!(walk, Walk::Healed)), "healed"),
        (count(|walk| matches!(walk, Walk::Wrong)), "wrong"),
    ];
    let right_deg =
        walks.iter().filter_map(|walk| if let Walk::Right(deg) = walk { Some(*deg) } else { None });
    emit(&format!("| {name} | {} |", outcomes(&words, right_deg.reduce(f64::max))));
}

/// `cargo bench --bench body walks`
pub(super) fn table() {
    emit("\n| who walks | the body faces |\n|---|---|");
    for activity in [Activity::Walking, Activity::Strolling, Activity::Lap, Activity::Climbing] {
        let walks: Vec<Walk> = (1..=PEOPLE)
            .map(|seed| walk(&mut wearer(activity, Build::of_height(HEIGHT_M), seed), None))
            .collect();
        emit_row(&format!("{activity:?}"), &walks);
    }
    let walking = people::who(&["walk"]);
    for actions in
        [["walk"].as_slice(), &["walk", "walk-left", "walk-right"], &["run", "dash"], &["walk-back"]]
    {
        let mut walks = Vec::new();
        for (seed, (name, take)) in people::who(actions).into_iter().enumerate() {
            let Ok(take) = take else { continue };
            let then =
                walking.iter().find(|(walks, _)| *walks == name).and_then(|(_, take)| take.clone().ok());
            let mut wearer = wearer(Activity::Bends, take.build(), seed as u64 + 1);
            wearer.follow(take);
            walks.push(walk(&mut wearer, then));
        }
        emit_row(&actions.join(", "), &walks);
    }
}
