//! What a guided calibration makes of people who do something else than it asks for: the table of `docs/body.md`.
//!
//! Each person begins with what is wrong, and does everything right from the second round on, as people do once they have been warned.

use nalgebra::{UnitQuaternion, Vector3};
use posed_fusion::body::{
    Assignment, BodyFilter, BodyParams, BodySamples, BodySegment, CalibrationError, Guide, Recorded,
    SEGMENTS, SensorMount, Skeleton, Thoroughness, assign, calibrate,
};
use posed_fusion::faults::Cause;
use posed_simulator::body::{Activity, Build, Mistake, Script, SensorErrors, Wearer, WearerSpec};

use super::{HEIGHT_M, Sensors, emit, outcomes, recorded};

const RATE_HZ: f64 = 50.0;
const SEEDS: u64 = 6;
/// So long whoever was calibrated walks about, s.
const WALKS_S: f64 = 60.0;
/// Nobody goes on for longer, s.
const LONGEST_S: f64 = 240.0;
/// A mounting that is wrong by more is wrong: what people who stand as people do leave stays below, degrees.
const WRONG_DEG: f64 = 15.0;
/// A grip turns a strap by so much.
const GRIP_RAD: f64 = 0.6;

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Deceit {
    Nothing,
    Held(Mistake),
    /// The arms are raised when it begins.
    RaisedFirst,
    /// Sensors that are exchanged, pair by pair.
    Swapped(&'static [[BodySegment; 2]]),
    /// Somebody grips a limb after the first pose, and the sensor stays turned on it.
    Gripped(BodySegment),
    /// These send nothing for the first half minute.
    Off(&'static [BodySegment]),
    /// One that ends after twelve seconds, and comes back after thirty.
    Dies(BodySegment),
}

use BodySegment::{
    FootL, FootR, ForearmL, ForearmR, HandL, HandR, Head, ShankL, ShankR, ThighL, ThighR, UpperArmL,
    UpperArmR,
};

const ARMS: &[[BodySegment; 2]] = &[[UpperArmR, UpperArmL], [ForearmR, ForearmL], [HandR, HandL]];
const FOREARMS: &[[BodySegment; 2]] = &[[ForearmR, ForearmL]];
const LEGS: &[[BodySegment; 2]] = &[[ThighR, ThighL], [ShankR, ShankL], [FootR, FootL]];
const SHANKS: &[[BodySegment; 2]] = &[[ShankR, ShankL]];
const ARM: &[[BodySegment; 2]] = &[[UpperArmR, ForearmR]];
const LEG: &[[BodySegment; 2]] = &[[ThighR, ShankR]];
const HALF: &[BodySegment] = &[UpperArmL, ForearmL, HandL, ThighL, ShankL, FootL, Head];

const ROWS: [(&str, Deceit); 18] = [
    ("nothing is wrong", Deceit::Nothing),
    ("arms raised forward", Deceit::Held(Mistake::ArmsForward)),
    ("arms raised half way", Deceit::Held(Mistake::ArmsLow)),
    ("palms forward", Deceit::Held(Mistake::PalmsForward)),
    ("elbows bent in one pose", Deceit::Held(Mistake::BentElbows)),
    ("stoops in one pose", Deceit::Held(Mistake::Stoops)),
    ("turns round between the poses", Deceit::Held(Mistake::TurnsRound)),
    ("arms raised at the beginning", Deceit::RaisedFirst),
    ("arms swapped, right and left", Deceit::Swapped(ARMS)),
    ("forearms swapped", Deceit::Swapped(FOREARMS)),
    ("upper arm and forearm swapped", Deceit::Swapped(ARM)),
    ("legs swapped, right and left", Deceit::Swapped(LEGS)),
    ("shanks swapped", Deceit::Swapped(SHANKS)),
    ("thigh and shank swapped", Deceit::Swapped(LEG)),
    ("somebody's hands: forearm's strap turned", Deceit::Gripped(ForearmR)),
    ("somebody's hands: shank's strap turned", Deceit::Gripped(ShankR)),
    ("half of the sensors off", Deceit::Off(HALF)),
    ("one ends and comes back", Deceit::Dies(ForearmL)),
];

/// Every `how` with what a person does for it, and whether there is a field.
const HOWS: [(&str, Thoroughness, Activity, bool); 4] = [
    ("quick", Thoroughness::Quick, Activity::Poses, true),
    ("full", Thoroughness::Full, Activity::Bends, true),
    ("full, no field", Thoroughness::Full, Activity::Bends, false),
    ("every limb", Thoroughness::Assign, Activity::Movements, true),
];

/// How it ended.
#[derive(Clone, Debug, PartialEq)]
enum Ended {
    /// It was warned, there or in the end, of what is wrong; and if something was used, that was right.
    Noticed,
    /// Nothing was said, and what is used is right all the same.
    Right,
    /// Walking showed it, and what is used from then on is right.
    Healed,
    /// Walking showed that something does not fit, and what.
    Named,
    /// Nothing was said, and what is used is wrong by so much, degrees.
    Wrong(f64),
    /// It was warned, did another thing than it was asked for then, and in the end something wrong is used all the same, degrees: who is asked for the right knee, and goes
    /// on with the left one.
    StillWrong(f64),
}

fn run(deceit: Deceit, how: Thoroughness, activity: Activity, magnetometer: bool, seed: u64) -> Ended {
    let mistake = if let Deceit::Held(mistake) = deceit { Some(mistake) } else { None };
    let worn_by = |activity: Activity, mistake: Option<Mistake>| WearerSpec {
        script: Script { activity, calibration: false, facing: 0.6, mistake },
        build: Build::of_height(HEIGHT_M),
        errors: SensorErrors::calibrated(),
        magnetometer,
        disturbances: Vec::new(),
        rate_hz: RATE_HZ,
        clumsiness_rad: 0.03,
        seed,
    };
    let mut wearer = Wearer::new(worn_by(activity, mistake));
    if deceit == Deceit::RaisedFirst {
        // Seven seconds into the round the second pose is held.
        (0..(7.0 * RATE_HZ) as usize).for_each(|_| _ = wearer.step());
    }
    let mut guide =
        Guide::new(BodySegment::ALL.map(|segment| Sensors::Fifteen.has(segment)), magnetometer, how);
    let mut warned = false;
    let mut gripped = false;
    for step in 0..(LONGEST_S * RATE_HZ) as usize {
        let t_s = step as f64 / RATE_HZ;
        let (samples, _) = wearer.step();
        let mut samples = recorded(&samples, Sensors::Fifteen);
        for (segment, sample) in BodySegment::ALL.into_iter().zip(&mut samples) {
            let off = match deceit {
                Deceit::Off(segments) => segments.contains(&segment) && t_s < 30.0,
                Deceit::Dies(dying) => segment == dying && (12.0..30.0).contains(&t_s),
                _ => false,
            };
            *sample = sample.filter(|_| !off);
        }
        exchange(deceit, &mut samples);
        if let Deceit::Gripped(segment) = deceit {
            gripped |= guide.progress().0 >= 1;
            if let Some(sample) = samples[segment.index()].as_mut().filter(|_| gripped) {
                let q = grip();
                sample.gyro_rad_s = q * sample.gyro_rad_s;
                sample.accel_m_s2 = q * sample.accel_m_s2;
                sample.mag = sample.mag.map(|mag| q * mag);
            }
        }
        guide.push(t_s, &samples);
        warned |= guide.objection().0 > 0 || guide.silent().next().is_some();
        if guide.prompt().is_none() {
            break;
        }
    }
    if guide.prompt().is_some() {
        // Who is warned and never does it right; or who is not, and gives up.
        return if warned { Ended::Noticed } else { Ended::Wrong(f64::INFINITY) };
    }
    let Ok((mounts, places)) = solved(&guide, how) else { return Ended::Noticed };
    let grip_of = |segment: BodySegment| match deceit {
        Deceit::Gripped(turned) if turned == segment => grip(),
        _ => UnitQuaternion::identity(),
    };
    // By the segments, and from which the sensor that counts there is taken.
    let worst_deg = |mounts: &Mounts, places: &[BodySegment; SEGMENTS]| {
        BodySegment::ALL.into_iter().filter(|segment| Sensors::Fifteen.has(*segment)).fold(
            0.0,
            |worst: f64, segment| {
                let worn = place_of(deceit, places[segment.index()]);
                let Some(mount) = mounts[segment.index()].filter(|_| worn == segment) else { return 180.0 };
                let truth = wearer.mounting(segment.index()).0 * grip_of(segment).inverse();
                worst.max(mount.q_segment_sensor.angle_to(&truth).to_degrees())
            },
        )
    };
    let off_deg = worst_deg(&mounts, &places);
    if off_deg > WRONG_DEG {
        // Whoever was calibrated wrongly moves on.
        let mut walker = Wearer::new(worn_by(Activity::Strolling, None));
        let mut filter = BodyFilter::new(&Skeleton::from_height(HEIGHT_M), &mounts, &BodyParams::default());
        let mut named = false;
        for _ in 0..(WALKS_S * RATE_HZ) as usize {
            let mut samples = recorded(&walker.step().0, Sensors::Fifteen);
            exchange(deceit, &mut samples);
            let samples = places.map(|taken| samples[taken.index()]);
            let faults = filter.push(&samples, 1.0 / RATE_HZ).faults;
            named |= faults.iter().any(|fault| matches!(fault, Some(Cause::Misfit | Cause::Swapped)));
        }
        let by_sensor = filter.mounts();
        let sits: Mounts = filter.taken_from().map(|from| by_sensor[from]);
        let places = filter.taken_from().map(|from| places[from]);
        return match worst_deg(&sits, &places) {
            healed_deg if healed_deg < WRONG_DEG => Ended::Healed,
            _ if named => Ended::Named,
            _ if warned => Ended::StillWrong(off_deg),
            _ => Ended::Wrong(off_deg),
        };
    }
    if warned { Ended::Noticed } else { Ended::Right }
}

/// Sensors that are swapped send under one another's names.
fn exchange(deceit: Deceit, samples: &mut BodySamples) {
    if let Deceit::Swapped(pairs) = deceit {
        pairs.iter().for_each(|[one, other]| samples.swap(one.index(), other.index()));
    }
}

/// How a grip turns a sensor on its segment.
fn grip() -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(0.3, 0.9, 0.3) * GRIP_RAD)
}

type Mounts = [Option<SensorMount>; SEGMENTS];

/// The mountings, and for each segment the one that its sensor was taken for.
fn solved(guide: &Guide, how: Thoroughness) -> Result<(Mounts, [BodySegment; SEGMENTS]), CalibrationError> {
    let (recording, blocks) = guide.recorded();
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let mut places = BodySegment::ALL;
    let placed: Vec<Recorded>;
    let recording = if how == Thoroughness::Assign {
        let assignment: Assignment = assign(recording, blocks).map_err(|_| CalibrationError::Empty)?;
        places =
            assignment.place(&BodySegment::ALL.map(Some)).map(|place| place.unwrap_or(BodySegment::Torso));
        placed = assignment.placed(recording);
        &placed
    } else {
        recording
    };
    let found = calibrate(recording, blocks, &skeleton, &[None; SEGMENTS])?;
    if !found.warnings.is_empty() {
        return Err(CalibrationError::Empty);
    }
    Ok((found.mounts, places))
}

/// The segment that the sensor which was taken to sit on `taken` really sits on.
fn place_of(deceit: Deceit, taken: BodySegment) -> BodySegment {
    let Deceit::Swapped(pairs) = deceit else { return taken };
    let swapped = pairs.iter().find_map(|[one, other]| match taken {
        _ if taken == *one => Some(*other),
        _ if taken == *other => Some(*one),
        _ => None,
    });
    swapped.unwrap_or(taken)
}

/// `cargo bench --bench body deceit`
pub(super) fn table() {
    emit("| what is wrong | quick | full | full, no field | every limb |");
    emit("|---|---|---|---|---|");
    for (name, deceit) in ROWS {
        let cells = HOWS.map(|(_, how, activity, magnetometer)| {
            let ended: Vec<Ended> =
                (0..SEEDS).map(|seed| run(deceit, how, activity, magnetometer, 40 + seed)).collect();
            let count = |of: fn(&Ended) -> bool| ended.iter().filter(|ended| of(ended)).count();
            let noticed = count(|ended| *ended == Ended::Noticed);
            let right = count(|ended| *ended == Ended::Right);
            let worst_deg = ended.iter().fold(0.0, |worst: f64, ended| match ended {
                Ended::Wrong(deg) | Ended::StillWrong(deg) => worst.max(*deg),
                _ => worst,
            });
            let warned = count(|ended| matches!(ended, Ended::StillWrong(_)));
            let healed = count(|ended| *ended == Ended::Healed);
            let named = count(|ended| *ended == Ended::Named);
            let wrong = SEEDS as usize - noticed - right - healed - named - warned;
            let counts = [
                (noticed, "noticed"),
                (right, "right"),
                (healed, "healed"),
                (named, "named"),
                (warned, "warned, used"),
                (wrong, "wrong"),
            ];
            outcomes(&counts, (wrong + warned > 0).then_some(worst_deg))
        });
        emit(&format!("| {name} | {} |", cells.join(" | ")));
    }
}
