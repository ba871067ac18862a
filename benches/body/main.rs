//! How well a simulated body is solved, and what it costs: the tables of `docs/body.md`. `cargo bench --bench body`, with a case or an activity for its rows

mod compass;
mod deceit;
mod few;
mod learnt;
mod people;
mod shoulders;
mod travel;
mod walks;

use nalgebra::{UnitQuaternion, Vector3};
use posed_baselines::limbs::EulerBody;
use posed_fusion::ahrs::ImuSample;
use posed_fusion::body::{
    ANGLE_NAMES, BodyFilter, BodyParams, BodySamples, BodySegment, SEGMENTS, SensorMount, Skeleton, angles,
};
use posed_fusion::body::{Block, BlockKind, Recorded, calibrate};
use posed_geometry::so3;
use posed_simulator::body::{
    Activity, Build, Disturbance, Placement, Sample, Script, SensorErrors, Wearer, WearerSpec,
};

const HEIGHT_M: f64 = 1.8;
const RATE_HZ: f64 = 100.0;
const HEALTHY: [Activity; 4] = [Activity::Walking, Activity::Reaching, Activity::Curls, Activity::Squats];
const TRUNKS: [BodySegment; 2] = [BodySegment::Torso, BodySegment::Pelvis];
/// What the filters are given before the figures begin, s.
const SETTLE_S: f64 = 10.0;

/// How the sensors' mounting is known.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mounting {
    Perfect,
    /// Wrong by so many degrees in a random direction.
    Wrong(f64),
    /// By all that the guide asks for, by its two poses alone, or by what follows them and is no pose.
    Calibrated,
    Posed,
    Walked,
}

/// Who wears how many.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sensors {
    /// Trunk and limbs.
    Ten,
    /// Head, hands and feet, too.
    Fifteen,
    /// And the shoulders.
    Seventeen,
}

impl Sensors {
    fn has(self, segment: BodySegment) -> bool {
        match self {
            Self::Ten => !BodySegment::LEAVES.contains(&segment),
            Self::Fifteen => !BodySegment::SHOULDERS.contains(&segment),
            Self::Seventeen => true,
        }
    }
}

#[derive(Clone)]
struct Case {
    activity: Activity,
    errors: SensorErrors,
    mounting: Mounting,
    magnetometer: bool,
    disturbances: Vec<Disturbance>,
    clumsiness_rad: f64,
    activity_s: f64,
    seed: u64,
    /// By the published filter of limbs.
    euler: bool,
    /// Which segments wear sensors.
    sensors: Sensors,
    /// Whether collar bones and shoulder blades move.
    girdle: bool,
    /// How much longer thighs and upper arms are than the proportions say.
    longer: f64,
    /// And shanks.
    longer_shanks: f64,
}

impl Case {
    fn new(activity: Activity, mounting: Mounting) -> Self {
        Self {
            activity,
            errors: SensorErrors::calibrated(),
            mounting,
            magnetometer: true,
            disturbances: Vec::new(),
            clumsiness_rad: 0.0,
            activity_s: 60.0,
            seed: 1,
            euler: false,
            sensors: Sensors::Ten,
            girdle: false,
            longer: 1.0,
            longer_shanks: 1.0,
        }
    }
}

/// Root mean square errors, degrees.
#[derive(Clone, Copy, Debug, Default)]
struct Figures {
    elbow: f64,
    pronation: f64,
    knee: f64,
    shoulder: f64,
    hip: f64,
    /// Head against the torso, hands against the forearms, feet against the shanks, the whole rotation.
    ends: [f64; 3],
    /// Of the torso, and of the worst segment's heading.
    torso: f64,
    heading: f64,
    /// The segment whose heading is worst on average.
    worst: &'static str,
    /// Normalised squared error per axis of every segment, mean: of trunks in the room, of limbs against their trunk.
    nees: [f64; SEGMENTS],
}

struct Run {
    recording: Vec<Recorded>,
    truth: Vec<[UnitQuaternion<f64>; SEGMENTS]>,
    /// Origins of all segments, m.
    origins_m: Vec<[Vector3<f64>; SEGMENTS]>,
    wearer: Wearer,
    script: Script,
    build: Build,
    blocks: Vec<Block>,
}

fn record(case: &Case) -> Run {
    let script = Script { activity: case.activity, calibration: true, facing: 0.6, mistake: None };
    let mut build = Build { girdle: case.girdle, ..Build::of_height(HEIGHT_M) };
    build.thigh_m *= case.longer;
    build.upper_arm_m *= case.longer;
    build.shank_m *= case.longer_shanks;
    let spec = WearerSpec {
        script: script.clone(),
        build,
        errors: case.errors,
        magnetometer: case.magnetometer,
        disturbances: case.disturbances.clone(),
        rate_hz: RATE_HZ,
        clumsiness_rad: case.clumsiness_rad,
        seed: case.seed,
    };
    let mut wearer = Wearer::new(spec);
    let (mut recording, mut truth, mut origins_m) = (Vec::new(), Vec::new(), Vec::new());
    let frames = ((script.activity_s() + case.activity_s) * RATE_HZ) as usize;
    for _ in 0..frames {
        let (samples, at) = wearer.step();
        recording.push((at.t_s, recorded(&samples, case.sensors)));
        // Without magnetometers the body's own facing is the room's x.
        let rotation_rad = if case.magnetometer { 0.0 } else { -script.facing };
        let room = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rotation_rad);
        origins_m.push(at.body.map(|placement| room * placement.origin_m));
        truth.push(oriented(&at.body, room));
    }
    let blocks = script
        .blocks()
        .into_iter()
        .filter_map(|b| Some(Block { kind: BlockKind::named(b.kind)?, start_s: b.start_s, end_s: b.end_s }))
        .collect();
    Run { recording, truth, origins_m, wearer, script, build, blocks }
}

/// What the filters are given of a frame.
fn recorded(samples: &[Sample; SEGMENTS], worn: Sensors) -> BodySamples {
    BodySegment::ALL.map(|segment| {
        let sample = samples[segment.index()];
        worn.has(segment).then_some(ImuSample {
            gyro_rad_s: sample.gyro_rad_s,
            accel_m_s2: sample.accel_m_s2,
            mag: sample.mag_ut,
        })
    })
}

/// True orientations, segment to room, with the room turned by `room`.
fn oriented(body: &[Placement; SEGMENTS], room: UnitQuaternion<f64>) -> [UnitQuaternion<f64>; SEGMENTS] {
    body.map(|placement| room * placement.orientation())
}

fn mounts(case: &Case, run: &Run, skeleton: &Skeleton) -> Result<[Option<SensorMount>; SEGMENTS], String> {
    if case.mounting == Mounting::Walked {
        let walk = Block { kind: BlockKind::Walk, start_s: run.script.activity_s(), end_s: f64::INFINITY };
        let begin = run.recording.partition_point(|(t_s, _)| *t_s < walk.start_s);
        return calibrate(&run.recording[begin..], &[walk], skeleton, &[None; SEGMENTS])
            .map(|found| found.mounts)
            .map_err(|error| error.to_string());
    }
    if matches!(case.mounting, Mounting::Calibrated | Mounting::Posed) {
        let pose = |kind| matches!(kind, BlockKind::NPose | BlockKind::TPose);
        let asked = |block: &&Block| case.mounting == Mounting::Calibrated || pose(block.kind);
        let blocks: Vec<Block> = run.blocks.iter().filter(asked).copied().collect();
        let found =
            calibrate(&run.recording, &blocks, skeleton, &[None; SEGMENTS]).map_err(|e| e.to_string())?;
        return Ok(found.mounts);
    }
    Ok(BodySegment::ALL.map(|segment| {
        if !case.sensors.has(segment) {
            return None;
        }
        let (mount, offset_m) = run.wearer.mounting(segment.index());
        let wrong = match case.mounting {
            Mounting::Wrong(degrees) => {
                let k = (segment.index() as f64 + 1.0) * (case.seed as f64 + 0.3);
                let axis =
                    Vector3::new(libm::sin(1.7 * k), libm::cos(2.9 * k), libm::sin(4.1 * k)).normalize();
                so3::exp(&(axis * degrees.to_radians()))
            }
            _ => UnitQuaternion::identity(),
        };
        Some(SensorMount::exact(wrong * mount, offset_m))
    }))
}

/// The live filter of a body, or the published one.
enum Solver {
    Live(Box<BodyFilter>),
    Euler(Box<EulerBody>),
}

impl Solver {
    fn new(case: &Case, skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS]) -> Self {
        let params = BodyParams::default();
        if case.euler {
            Self::Euler(Box::new(EulerBody::new(skeleton, mounts, &params)))
        } else {
            Self::Live(Box::new(BodyFilter::new(skeleton, mounts, &params)))
        }
    }

    /// Orientations, and how uncertain they are where the filter says so.
    fn push(&mut self, samples: &BodySamples) -> ([Option<UnitQuaternion<f64>>; SEGMENTS], [f64; SEGMENTS]) {
        match self {
            Self::Live(filter) => {
                let estimate = filter.push(samples, 1.0 / RATE_HZ);
                (estimate.orientations, estimate.sigma_rad)
            }
            Self::Euler(body) => (*body.push(samples, 1.0 / RATE_HZ), [f64::NAN; SEGMENTS]),
        }
    }
}

fn solve(case: &Case) -> Result<Figures, String> {
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let run = record(case);
    let mounts = mounts(case, &run, &skeleton)?;
    let mut filter = Solver::new(case, &skeleton, &mounts);
    let mut sums = [0.0; 10];
    let mut headings = [0.0; SEGMENTS];
    let mut nees = [0.0; SEGMENTS];
    let mut count = 0.0;
    let index = |name: &str| ANGLE_NAMES.iter().position(|n| *n == name).expect("a name");
    let begin_s = run.script.activity_s() + SETTLE_S;
    for ((t_s, samples), truth) in run.recording.iter().zip(&run.truth) {
        let (orientations, sigma_rad) = filter.push(samples);
        if *t_s < begin_s {
            continue;
        }
        let (found, expected) = (angles(&orientations), angles(&truth.map(Some)));
        let off = |name: &str| {
            let k = index(name);
            let d = found[k].unwrap_or(f64::NAN) - expected[k].unwrap_or(f64::NAN);
            so3::log(&so3::exp(&(Vector3::z() * d))).z.to_degrees()
        };
        let rotation = |segment: BodySegment| {
            let k = segment.index();
            let Some(parent) = segment.parent() else { return f64::NAN };
            let p = parent.index();
            let (Some(own), Some(above)) = (orientations[k], orientations[p]) else {
                return f64::NAN;
            };
            (above.inverse() * own).angle_to(&(truth[p].inverse() * truth[k])).to_degrees()
        };
        for segment in BodySegment::ALL {
            let mut trunk = segment;
            while let Some(parent) = trunk.parent().filter(|_| !TRUNKS.contains(&trunk)) {
                trunk = parent;
            }
            let (k, t) = (segment.index(), trunk.index());
            let (Some(own), Some(above)) = (orientations[k], orientations[t]) else {
                continue;
            };
            let off = if k == t {
                own.angle_to(&truth[k])
            } else {
                (above.inverse() * own).angle_to(&(truth[t].inverse() * truth[k]))
            };
            nees[k] += off * off / (3.0 * sigma_rad[k].powi(2));
        }
        let torso = orientations[0].map_or(f64::NAN, |q| q.angle_to(&truth[0]).to_degrees());
        let heading_of = |s: &BodySegment| {
            let off = orientations[s.index()]? * truth[s.index()].inverse();
            Some(so3::log(&off).z.abs().to_degrees())
        };
        for (sum, segment) in headings.iter_mut().zip(&BodySegment::ALL) {
            *sum += heading_of(segment).map_or(0.0, |off_deg| off_deg.powi(2));
        }
        let heading = BodySegment::ALL.iter().filter_map(heading_of).fold(0.0, f64::max);
        let pair = |r: f64, l: f64| 0.5 * (r * r + l * l);
        sums[0] += pair(off("elbow_r_flexion"), off("elbow_l_flexion"));
        sums[1] += pair(off("elbow_r_pronation"), off("elbow_l_pronation"));
        sums[2] += pair(off("knee_r_flexion"), off("knee_l_flexion"));
        sums[3] += pair(rotation(BodySegment::UpperArmR), rotation(BodySegment::UpperArmL));
        sums[4] += pair(rotation(BodySegment::ThighR), rotation(BodySegment::ThighL));
        sums[5] += torso * torso;
        sums[6] += heading * heading;
        sums[7] += rotation(BodySegment::Head).powi(2);
        sums[8] += pair(rotation(BodySegment::HandR), rotation(BodySegment::HandL));
        sums[9] += pair(rotation(BodySegment::FootR), rotation(BodySegment::FootL));
        count += 1.0;
    }
    let [elbow, pronation, knee, shoulder, hip, torso, heading, ends @ ..] =
        sums.map(|sum| (sum / count).sqrt());
    let worst =
        BodySegment::ALL.into_iter().max_by(|a, b| headings[a.index()].total_cmp(&headings[b.index()]));
    let worst = worst.map_or("", BodySegment::name);
    Ok(Figures {
        elbow,
        pronation,
        knee,
        shoulder,
        hip,
        ends,
        torso,
        heading,
        worst,
        nees: nees.map(|sum| sum / count),
    })
}

fn main() {
    let only = std::env::args().nth(1).filter(|word| !word.starts_with('-'));
    let row = |name: &str, case: &Case| {
        let asked = format!("{name} {:?}", case.activity);
        if only.as_ref().is_some_and(|only| !asked.contains(only.as_str())) {
            return;
        }
        match solve(case) {
            Ok(f) => emit(&format!(
                "| {name} | {:?} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} ({}) |",
                case.activity, f.elbow, f.pronation, f.knee, f.shoulder, f.hip, f.torso, f.heading, f.worst
            )),
            Err(error) => emit(&format!("| {name} | {:?} | {error} |", case.activity)),
        }
    };
    emit("| case | activity | elbow | pronation | knee | shoulder | hip | torso | worst heading |");
    emit("|---|---|---|---|---|---|---|---|---|");
    for activity in HEALTHY.into_iter().chain([Activity::Rehabilitation]) {
        row("perfect mounting", &Case::new(activity, Mounting::Perfect));
        row("perfect, Euler", &Case { euler: true, ..Case::new(activity, Mounting::Perfect) });
        row("no errors", &Case { errors: SensorErrors::NONE, ..Case::new(activity, Mounting::Perfect) });
        row("3 degrees wrong", &Case::new(activity, Mounting::Wrong(3.0)));
        row("calibrated", &Case::new(activity, Mounting::Calibrated));
        row("calibrated, Euler", &Case { euler: true, ..Case::new(activity, Mounting::Calibrated) });
        let clumsy = Case { clumsiness_rad: 0.03, ..Case::new(activity, Mounting::Calibrated) };
        row("calibrated, clumsy", &clumsy);
        row(
            "no field, calibrated",
            &Case { magnetometer: false, ..Case::new(activity, Mounting::Calibrated) },
        );
        let shelf = Case { errors: SensorErrors::uncalibrated(), ..Case::new(activity, Mounting::Perfect) };
        row("uncalibrated units", &shelf);
        let skin = SensorErrors { skin_m: 5e-4, skin_rad_m: 2.0, ..SensorErrors::calibrated() };
        row("skin", &Case { errors: skin, ..Case::new(activity, Mounting::Calibrated) });
        let mut far = Case::new(activity, Mounting::Perfect);
        let calibration = Script { activity, calibration: true, facing: 0.0, mistake: None };
        let start_s = calibration.activity_s() + 15.0;
        let disturbed = |azimuth_rad: f64, norm, dip_rad: f64| {
            vec![Disturbance { start_s, end_s: start_s + 30.0, azimuth_rad, norm, dip_rad }]
        };
        far.disturbances = disturbed(45_f64.to_radians(), 0.86, -16_f64.to_radians());
        row("disturbed 30 s", &far);
        far.disturbances = disturbed(45_f64.to_radians(), 1.0, 0.0);
        row("pure rotation", &far);
    }
    if only.as_ref().is_none_or(|only| "ends".contains(only.as_str())) {
        ends();
    }
    if only.as_ref().is_none_or(|only| "shoulders".contains(only.as_str())) {
        shoulders::table();
    }
    if only.as_ref().is_some_and(|only| "nees".contains(only.as_str())) {
        consistency();
    }
    if only.as_ref().is_none_or(|only| "travel".contains(only.as_str())) {
        travel::table();
    }
    if only.as_ref().is_none_or(|only| "compass".contains(only.as_str())) {
        compass::table(std::env::args().nth(2).as_deref());
    }
    if only.as_ref().is_none_or(|only| "deceit".contains(only.as_str())) {
        deceit::table();
    }
    if only.as_ref().is_none_or(|only| "learnt".contains(only.as_str())) {
        learnt::learnt();
    }
    if only.as_ref().is_none_or(|only| "people".contains(only.as_str())) {
        people::table();
    }
    if only.as_ref().is_none_or(|only| "walks".contains(only.as_str())) {
        walks::table();
    }
    if only.as_ref().is_none_or(|only| "slips".contains(only.as_str())) {
        learnt::slips();
    }
    if only.as_ref().is_none_or(|only| "few".contains(only.as_str())) {
        few::few();
    }
    if only.as_ref().is_none_or(|only| "speed".contains(only.as_str())) {
        speed();
    }
}

/// Head, hands and feet that wear sensors, too. `cargo bench --bench body ends`
fn ends() {
    emit("\n| case | activity | neck | wrist | ankle | elbow | knee | worst heading |");
    emit("|---|---|---|---|---|---|---|---|");
    let skin = SensorErrors { skin_m: 5e-4, skin_rad_m: 2.0, ..SensorErrors::calibrated() };
    for activity in [Activity::Walking, Activity::Strolling, Activity::Reaching, Activity::Squats] {
        let cases = [
            ("perfect mounting", Case::new(activity, Mounting::Perfect)),
            ("calibrated", Case::new(activity, Mounting::Calibrated)),
            (
                "calibrated, clumsy",
                Case { clumsiness_rad: 0.03, ..Case::new(activity, Mounting::Calibrated) },
            ),
            ("skin", Case { errors: skin, ..Case::new(activity, Mounting::Calibrated) }),
            ("no field", Case { magnetometer: false, ..Case::new(activity, Mounting::Perfect) }),
        ];
        for (name, case) in cases {
            let Ok(f) = solve(&Case { sensors: Sensors::Fifteen, ..case }) else { continue };
            let [neck, wrist, ankle] = f.ends;
            emit(&format!(
                "| {name} | {activity:?} | {neck:.2} | {wrist:.2} | {ankle:.2} | {:.2} | {:.2} | {:.2} ({}) |",
                f.elbow, f.knee, f.heading, f.worst
            ));
        }
    }
}

/// Whether the expected errors are those that are made: ten people, mean over what healthy people do. `cargo bench --bench body nees`
fn consistency() {
    const PEOPLE: u64 = 10;
    emit("\n| segment | normalised squared error per axis |");
    emit("|---|---|");
    let mut sums = [0.0; SEGMENTS];
    for activity in HEALTHY {
        for seed in 1..=PEOPLE {
            let Ok(figures) = solve(&Case { seed, ..Case::new(activity, Mounting::Perfect) }) else { return };
            for (sum, nees) in sums.iter_mut().zip(&figures.nees) {
                *sum += nees / (PEOPLE * HEALTHY.len() as u64) as f64;
            }
        }
    }
    for (segment, sum) in BodySegment::ALL.iter().zip(&sums) {
        emit(&format!("| {} | {sum:.2} |", segment.name()));
    }
}

/// What one epoch of ten IMUs costs the processor, of fifteen and of seventeen.
fn speed() {
    for mounting in [Mounting::Perfect, Mounting::Calibrated] {
        for (count, sensors) in [(10, Sensors::Ten), (15, Sensors::Fifteen), (17, Sensors::Seventeen)] {
            epoch(count, &Case { activity_s: 30.0, sensors, ..Case::new(Activity::Walking, mounting) });
        }
    }
}

fn epoch(count: usize, case: &Case) {
    let run = record(case);
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let Ok(mounts) = mounts(case, &run, &skeleton) else { return };
    let mut best_us = f64::INFINITY;
    for _ in 0..5 {
        let mut filter = BodyFilter::new(&skeleton, &mounts, &BodyParams::default());
        let begun = busy_ns();
        for (_, samples) in &run.recording {
            std::hint::black_box(filter.push(samples, 1.0 / RATE_HZ));
        }
        best_us = best_us.min((busy_ns() - begun) as f64 * 1e-3 / run.recording.len() as f64);
    }
    let bodies = 1e6 / (RATE_HZ * best_us);
    emit(&format!(
        "\nAn epoch of {count} IMUs ({:?} mounting) takes {best_us:.1} us of processor time: one core holds {bodies:.0} bodies at 100 Hz.",
        case.mounting
    ));
}

/// Time that the kernel gave this thread, ns: what others do on the machine does not count.
fn busy_ns() -> u64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|word| word.parse().ok()).unwrap_or(0)
}

/// What became of several people, in words: how many of each kind, and of those that ended badly the worst, degrees.
fn outcomes(counts: &[(usize, &str)], worst_deg: Option<f64>) -> String {
    let words = counts.iter().filter(|(count, _)| *count > 0);
    let words: Vec<String> = words.map(|(count, word)| format!("{count} {word}")).collect();
    let worst = worst_deg.map_or_else(String::new, |worst_deg| format!(" ({worst_deg:.0})"));
    format!("{}{worst}", words.join(", "))
}

/// The table goes to stdout.
#[expect(clippy::print_stdout, reason = "a bench prints its table")]
fn emit(line: &str) {
    println!("{line}");
}
