//! Recorded people in a suit without a compass: the table *Recorded people* of `docs/body.md`.
//!
//! `cargo bench --bench body people`, with part of a name for those people alone, `minutes=10` for longer runs, `skin=0.5` for sensors that play on the skin (mm per m/s², and 2 rad
//! per m), `strap=2` for straps that wander (degrees), and `write=FOLDER` for the samples and the truth as CSV.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use posed_baselines::limbs::EulerBody;
use posed_fusion::body::{
    BodyFilter, BodyParams, BodySamples, BodySegment, Guide, SEGMENTS, SensorMount, Skeleton, Thoroughness,
    calibrate, joint_angles,
};
use posed_geometry::{GRAVITY_M_S2, so3};
use posed_simulator::body::take::{Recording, Take};
use posed_simulator::body::{Activity, Build, Script, SensorErrors, Wearer, WearerSpec};

use super::{HEIGHT_M, RATE_HZ, Sensors, emit, oriented, recorded};

/// How far from straight people stand, rad.
const CLUMSY_RAD: f64 = 0.03;
/// Where they look at first, rad.
const FACING_RAD: f64 = 0.6;
/// A calibration that takes longer has failed, s.
const LONGEST_S: f64 = 240.0;
/// After the calibration somebody stands for so long, s.
const PAUSE_S: f64 = 1.0;
/// What counts begins so long after the movement, s.
const SETTLE_S: f64 = 10.0;
/// A way goes straight on for so long: shorter, and what a step shakes counts as way.
const WAY_EPOCHS: usize = 50;
/// Somebody runs who goes faster than a Froude number of 0.5, at which people go over from walking to running; the speed of that over the root of g and the leg's length.
const RUNS: f64 = 0.707;
/// Somebody walks who goes faster, m/s: slower, the hips sway.
const WALKS_M_S: f64 = 0.3;
/// A way of that gait that is shorter says nothing, m.
const SHORT_M: f64 = 2.0;
/// A contact that counts lasts for so many epochs.
const STOOD_EPOCHS: usize = 10;
/// So many styles of walking people, those of whom there is most.
const STYLES: usize = 10;

const LEGS: [[BodySegment; 2]; 2] =
    [[BodySegment::ThighR, BodySegment::ShankR], [BodySegment::ThighL, BodySegment::ShankL]];
const ARMS: [[BodySegment; 2]; 2] =
    [[BodySegment::UpperArmR, BodySegment::ForearmR], [BodySegment::UpperArmL, BodySegment::ForearmL]];
const FEET: [BodySegment; 2] = [BodySegment::FootR, BodySegment::FootL];

/// What one person's run shows. Angles in degrees, root mean square over time.
#[derive(Clone, Copy, Debug, Default)]
struct Figures {
    /// Hips about each of three axes, and knees; shoulders about each of three axes, elbows in flexion and pronation.
    legs: f64,
    arms: f64,
    /// Knees in flexion; elbows in flexion, and in pronation.
    hinges: [f64; 3],
    /// Of the paper's limbs, on the same samples: legs, arms, headings.
    euler: [f64; 3],
    /// Between segments that hang on one another.
    headings: f64,
    /// Of the pelvis at the end, and the most it was wrong by in sigmas that were stated.
    heading: f64,
    heading_sigmas: f64,
    way_m: f64,
    /// %, mm, %.
    way: f64,
    /// The same within clips, walking and running, signed; `None` where it was too short.
    gaits: [Option<f64>; 2],
    slide: f64,
    /// How far heel and ball move in truth meanwhile, mm.
    true_slide: f64,
    contacts: f64,
    thigh: f64,
    upper_arm: f64,
    /// For how long a sensor was named that does not fit, s: all of them do.
    named_s: f64,
}

/// Sums of squared errors of a body's angles.
#[derive(Clone, Copy, Debug, Default)]
struct Angles {
    legs: f64,
    arms: f64,
    headings: f64,
    /// Knees in flexion; elbows in flexion, and in pronation.
    hinges: [f64; 3],
    count: f64,
}

impl Angles {
    fn add(
        &mut self,
        found: &[Option<UnitQuaternion<f64>>; SEGMENTS],
        truth: &[UnitQuaternion<f64>; SEGMENTS],
    ) {
        let q = |segment: BodySegment| found[segment.index()].unwrap_or_default();
        let relative_rad = |above: BodySegment, own: BodySegment| {
            let expected = truth[above.index()].inverse() * truth[own.index()];
            so3::log(&(expected.inverse() * (q(above).inverse() * q(own)))).norm_squared()
        };
        let angle_rad = |above: BodySegment, own: BodySegment, which: usize| {
            let found = joint_angles(own, &(q(above).inverse() * q(own)))[which];
            let expected = joint_angles(own, &(truth[above.index()].inverse() * truth[own.index()]))[which];
            so3::log(&so3::exp(&(Vector3::z() * (found - expected)))).z.powi(2)
        };
        for [upper, lower] in LEGS {
            let knee_rad = angle_rad(upper, lower, 0);
            self.hinges[0] += knee_rad / 2.0;
            self.legs += (relative_rad(BodySegment::Pelvis, upper) + knee_rad) / 8.0;
        }
        for [upper, lower] in ARMS {
            let elbow_rad = [0, 1].map(|which| angle_rad(upper, lower, which));
            self.hinges[1] += elbow_rad[0] / 2.0;
            self.hinges[2] += elbow_rad[1] / 2.0;
            self.arms += (relative_rad(BodySegment::Torso, upper) + elbow_rad[0] + elbow_rad[1]) / 10.0;
        }
        let heading_rad = |segment: BodySegment| so3::log(&(q(segment) * truth[segment.index()].inverse())).z;
        let pairs = BodySegment::ALL.into_iter().filter(|segment| found[segment.index()].is_some());
        let (mut sum, mut count) = (0.0, 0.0);
        for (own, above) in pairs.filter_map(|own| own.parent().map(|above| (own, above))) {
            let off = heading_rad(own) - heading_rad(above);
            sum += so3::log(&so3::exp(&(Vector3::z() * off))).z.powi(2);
            count += 1.0;
        }
        self.headings += sum / count;
        self.count += 1.0;
    }

    fn rms_deg(&self) -> [f64; 6] {
        let [knee, elbow, pronation] = self.hinges;
        [self.legs, self.arms, self.headings, knee, elbow, pronation]
            .map(|sum| (sum / self.count).sqrt().to_degrees())
    }
}

/// A heel or a ball: where it began to stand, in truth and by the estimate.
#[derive(Clone, Debug, Default)]
struct Sole {
    began_m: Option<[Vector3<f64>; 2]>,
    /// In the estimate beside the truth, and in truth, m.
    slid_m: [f64; 2],
    stood: usize,
}

impl Sole {
    /// Takes the next place; how far a contact slid that is over.
    fn push(&mut self, stands: bool, truth_m: Vector3<f64>, found_m: Vector3<f64>) -> Option<[f64; 2]> {
        if stands {
            let [true_m, began_m] = *self.began_m.get_or_insert([truth_m, found_m]);
            let moved_m = truth_m - true_m;
            let [slid_m, true_m] = self.slid_m;
            self.slid_m = [slid_m.max((found_m - began_m - moved_m).norm()), true_m.max(moved_m.norm())];
            self.stood += 1;
            return None;
        }
        let Self { began_m, slid_m, stood } = std::mem::take(self);
        (began_m.is_some() && stood >= STOOD_EPOCHS).then_some(slid_m)
    }
}

/// Somebody in a suit: calibrated by what the guide asks for, with only the height known.
struct Suit {
    wearer: Wearer,
    calibration: Vec<(f64, BodySamples)>,
    truth: Vec<[UnitQuaternion<f64>; SEGMENTS]>,
    mounts: [Option<SensorMount>; SEGMENTS],
}

/// The room by the body's own facing: without magnetometers nothing else is known.
fn room() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -FACING_RAD)
}

fn calibrated(build: Build, errors: SensorErrors, seed: u64) -> Result<Suit, String> {
    let script = Script { activity: Activity::Bends, calibration: false, facing: FACING_RAD, mistake: None };
    let mut wearer = Wearer::new(WearerSpec {
        script,
        build,
        errors,
        magnetometer: false,
        disturbances: Vec::new(),
        rate_hz: RATE_HZ,
        clumsiness_rad: CLUMSY_RAD,
        seed,
    });
    let mut guide =
        Guide::new(BodySegment::ALL.map(|segment| Sensors::Fifteen.has(segment)), false, Thoroughness::Full);
    let (mut calibration, mut truth) = (Vec::new(), Vec::new());
    let mut pause = 0.0;
    while pause < PAUSE_S {
        let (samples, at) = wearer.step();
        let samples = recorded(&samples, Sensors::Fifteen);
        guide.push(at.t_s, &samples);
        calibration.push((at.t_s, samples));
        truth.push(oriented(&at.body, room()));
        if guide.prompt().is_none() {
            pause += 1.0 / RATE_HZ;
        }
        if at.t_s > LONGEST_S {
            return Err(format!("the guide still asks: {}", guide.prompt().unwrap_or_default()));
        }
    }
    let (recording, blocks) = guide.recorded();
    let found = calibrate(recording, blocks, &Skeleton::from_height(HEIGHT_M), &[None; SEGMENTS])
        .map_err(|error| error.to_string())?;
    Ok(Suit { wearer, calibration, truth, mounts: found.mounts })
}

fn solve(
    take: &Arc<Take>,
    errors: SensorErrors,
    seed: u64,
    minutes: f64,
    mut table: Option<&mut Table>,
) -> Result<Figures, String> {
    let build = take.build();
    let mut suit = calibrated(build, errors, seed)?;
    let skeleton = Skeleton::from_height(HEIGHT_M);
    let mut filter = BodyFilter::new(&skeleton, &suit.mounts, &BodyParams::default());
    let mut euler = EulerBody::new(&skeleton, &suit.mounts, &BodyParams::default());
    for ((_, samples), truth) in suit.calibration.iter().zip(&suit.truth) {
        filter.push(samples, 1.0 / RATE_HZ);
        euler.push(samples, 1.0 / RATE_HZ);
        if let Some(table) = &mut table {
            table.row(samples, truth);
        }
    }
    suit.wearer.follow(Arc::clone(take));
    let begin_s = suit.calibration.len() as f64 / RATE_HZ;
    let (mut angles, mut euler_angles) = (Angles::default(), Angles::default());
    let mut figures = Figures::default();
    let mut soles: [[Sole; 2]; 2] = Default::default();
    let mut slides_m: Vec<[f64; 2]> = Vec::new();
    let mut ways_m = [0.0; 2];
    let mut gaits_m = [[0.0; 2]; 2];
    let mut last: Option<(Option<usize>, [Vector3<f64>; 2])> = None;
    let runs_m_s = RUNS * (GRAVITY_M_S2 * (build.thigh_m + build.shank_m)).sqrt();
    for epoch in 0..(minutes * 60.0 * RATE_HZ) as usize {
        let (samples, at) = suit.wearer.step();
        let samples = recorded(&samples, Sensors::Fifteen);
        let truth = oriented(&at.body, room());
        if let Some(table) = &mut table {
            table.row(&samples, &truth);
        }
        filter.push(&samples, 1.0 / RATE_HZ);
        let (estimate, skeleton) = (filter.estimate(), filter.skeleton());
        let by_euler = euler.push(&samples, 1.0 / RATE_HZ);
        if (epoch as f64) < SETTLE_S * RATE_HZ {
            continue;
        }
        angles.add(&estimate.orientations, &truth);
        euler_angles.add(by_euler, &truth);
        let pelvis = BodySegment::Pelvis.index();
        let off = estimate.orientations[pelvis].unwrap_or_default() * truth[pelvis].inverse();
        let heading_rad = so3::log(&off).z.abs();
        figures.heading = heading_rad.to_degrees();
        figures.named_s += f64::from(u8::from(estimate.faults.iter().any(Option::is_some))) / RATE_HZ;
        figures.heading_sigmas = figures.heading_sigmas.max(heading_rad / estimate.heading_sigma_rad);
        let hips_m = [room() * at.body[pelvis].origin_m, estimate.pelvis_m(skeleton)];
        let t_s = at.t_s - begin_s;
        let clip = take.clip(t_s);
        if epoch % WAY_EPOCHS == 0
            && let Some((last_clip, last_m)) = last.replace((clip, hips_m))
        {
            let went_m = [0, 1].map(|k| (hips_m[k] - last_m[k]).xy().norm());
            let speed_m_s = went_m[0] * RATE_HZ / WAY_EPOCHS as f64;
            let gait = (clip.is_some() && clip == last_clip && speed_m_s > WALKS_M_S)
                .then(|| &mut gaits_m[usize::from(speed_m_s > runs_m_s)]);
            for ways_m in [Some(&mut ways_m), gait].into_iter().flatten() {
                ways_m.iter_mut().zip(went_m).for_each(|(way_m, went_m)| *way_m += went_m);
            }
        }
        let posture = estimate.posture;
        let ankles_m = skeleton.ankles_m(&posture, hips_m[1]);
        let stands = take.standing(t_s);
        for (side, points) in build.soles_m(&at.body).into_iter().enumerate() {
            let foot = FEET[side].index();
            for ((sole, point_m), stands) in soles[side].iter_mut().zip(points).zip(stands[side]) {
                let own_m = at.body[foot].axes.transpose() * (point_m - at.body[foot].origin_m);
                let found_m = ankles_m[side] + posture[foot] * own_m;
                slides_m.extend(sole.push(stands, room() * point_m, found_m));
            }
        }
    }
    let [legs, arms, headings, hinges @ ..] = angles.rms_deg();
    (figures.legs, figures.arms, figures.headings, figures.hinges) = (legs, arms, headings, hinges);
    let [legs, arms, headings, ..] = euler_angles.rms_deg();
    figures.euler = [legs, arms, headings];
    figures.way_m = ways_m[0];
    figures.way = 100.0 * (ways_m[1] / ways_m[0] - 1.0).abs();
    figures.contacts = slides_m.len() as f64;
    figures.gaits =
        gaits_m.map(|[true_m, found_m]| (true_m > SHORT_M).then(|| 100.0 * (found_m / true_m - 1.0)));
    [figures.slide, figures.true_slide] = [0, 1].map(|which| {
        1e3 * slides_m.iter().map(|slid_m| slid_m[which]).sum::<f64>() / figures.contacts.max(1.0)
    });
    let learnt = filter.learnt();
    let length = |pair: [BodySegment; 2], usual_m: f64, true_m: f64| {
        let off = |segment: BodySegment| {
            let length_m = learnt[segment.index()].and_then(|learnt| learnt.length_m);
            100.0 * (length_m.map_or(usual_m, |[length_m, _]| length_m) / true_m - 1.0).abs()
        };
        0.5 * (off(pair[0]) + off(pair[1]))
    };
    figures.thigh = length([LEGS[0][0], LEGS[1][0]], skeleton.thigh_m, build.thigh_m);
    figures.upper_arm = length([ARMS[0][0], ARMS[1][0]], skeleton.upper_arm_m, build.upper_arm_m);
    Ok(figures)
}

/// `cargo bench --bench body people`
pub(super) fn table() {
    let words: Vec<String> = std::env::args().skip(2).collect();
    let option = |key: &str| words.iter().find_map(|word| word.strip_prefix(key).map(str::to_owned));
    let number = |key: &str| option(key).and_then(|number| number.parse::<f64>().ok());
    let minutes = number("minutes=").unwrap_or(2.0);
    let skin_m = 1e-3 * number("skin=").unwrap_or_default();
    let strap_rad = number("strap=").unwrap_or_default().to_radians();
    let errors = SensorErrors { skin_m, skin_rad_m: 2.0, strap_rad, ..SensorErrors::calibrated() };
    let folder = option("write=").map(PathBuf::from);
    let only = words.iter().find(|word| !word.contains('=') && !word.starts_with('-'));
    let people = people();
    if people.is_empty() {
        emit(
            "\nRecorded people are left out: their licences keep them out of the repository, and they are not beside it (`../shared/data`, or where SHARED_DATA says).",
        );
        return;
    }
    emit(&format!(
        "\n| recorded people, {minutes} minutes each | legs | arms | knee, elbow, pronation | headings between segments | heading at the end | most, sigmas | way, m | its error, % | walking, running, within clips, % | slide, mm | in truth | contacts | thigh, % | upper arm, % | named in vain, s | Euler limbs: legs | arms | headings |"
    ));
    emit("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut all: Vec<Figures> = Vec::new();
    for (seed, (name, take)) in people.iter().enumerate() {
        if only.is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let take = match take {
            Ok(take) => take,
            Err(error) => {
                emit(&format!("| {name} | {error} |"));
                continue;
            }
        };
        let mut table = folder.as_ref().map(|_| Table::new(&take.build()));
        match solve(take, errors, seed as u64 + 1, minutes, table.as_mut()) {
            Ok(figures) => {
                emit(&row(name, &[figures]));
                all.push(figures);
            }
            Err(error) => emit(&format!("| {name} | {error} |")),
        }
        if let (Some(folder), Some(table)) = (&folder, &table)
            && let Err(error) = std::fs::write(folder.join(format!("{name}.csv")), &table.text)
        {
            emit(&format!("{}: {error}", folder.display()));
        }
    }
    if all.len() > 1 {
        emit(&row("median", &all));
    }
}

/// Medians of the figures.
fn row(name: &str, all: &[Figures]) -> String {
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
    };
    let median = |of: &dyn Fn(&Figures) -> f64| middle(all.iter().map(of).collect());
    // Of several: how far it is off, either way.
    let gaits = [0, 1].map(|gait| {
        let values: Vec<f64> = all.iter().filter_map(|figures| figures.gaits[gait]).collect();
        match values[..] {
            [] => "-".to_owned(),
            [one] if all.len() == 1 => format!("{one:+.1}"),
            _ => format!("{:.1}", middle(values.iter().map(|value| value.abs()).collect())),
        }
    });
    format!(
        "| {name} | {:.2} | {:.2} | {:.1}, {:.1}, {:.1} | {:.2} | {:.1} | {:.1} | {:.0} | {:.1} | {}, {} | {:.0} | {:.1} | {:.0} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |",
        median(&|f| f.legs),
        median(&|f| f.arms),
        median(&|f| f.hinges[0]),
        median(&|f| f.hinges[1]),
        median(&|f| f.hinges[2]),
        median(&|f| f.headings),
        median(&|f| f.heading),
        median(&|f| f.heading_sigmas),
        median(&|f| f.way_m),
        median(&|f| f.way),
        gaits[0],
        gaits[1],
        median(&|f| f.slide),
        median(&|f| f.true_slide),
        median(&|f| f.contacts),
        median(&|f| f.thigh),
        median(&|f| f.upper_arm),
        median(&|f| f.named_s),
        median(&|f| f.euler[0]),
        median(&|f| f.euler[1]),
        median(&|f| f.euler[2]),
    )
}

pub(super) type Named = (String, Result<Arc<Take>, String>);

/// Who was recorded: four captures of CMU, and ten styles of Bandai Namco's people, each of all that was recorded of it.
fn people() -> Vec<Named> {
    let data = data();
    let mut people = Vec::new();
    for name in ["13_29", "13_30", "14_20", "86_01"] {
        let path = data.join(format!("cmu-labelled/{name}.csv.gz"));
        if path.exists() {
            let recording = Recording::read(&path, Some(120.0)).map_err(|error| error.to_string());
            people.push((name.to_owned(), recording.and_then(|recording| take(vec![recording]))));
        }
    }
    let mut styles: Vec<(String, String)> =
        styles(&data.join("bandai-motions"), |_| true).into_iter().collect();
    styles.sort_by_key(|(name, rows)| (usize::MAX - rows.len(), name.clone()));
    people.extend(styles.into_iter().take(STYLES).map(|(name, rows)| styled(name, &rows)));
    people
}

/// Everybody of Bandai Namco's people who was recorded in these actions, by style.
pub(super) fn who(actions: &[&str]) -> Vec<Named> {
    let styles = styles(&data().join("bandai-motions"), |action| actions.contains(&action));
    styles.into_iter().map(|(name, rows)| styled(name, &rows)).collect()
}

fn styled(name: String, rows: &str) -> Named {
    let recording = Recording::of_table(Path::new(&name), rows.as_bytes(), Some(30.0));
    let recording = recording.map_err(|error| error.to_string());
    let take = recording.and_then(|recording| take(vec![recording]));
    (name, take)
}

fn take(recordings: Vec<Recording>) -> Result<Arc<Take>, String> {
    Take::new(recordings, HEIGHT_M).map(Arc::new).map_err(|error| error.to_string())
}

/// Where the recordings are that are not in the repository.
fn data() -> PathBuf {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    std::env::var_os("SHARED_DATA").map_or(beside, PathBuf::from)
}

/// Tables of some actions by style: clips are called action_style_number.
fn styles(folder: &Path, is_asked: impl Fn(&str) -> bool) -> BTreeMap<String, String> {
    let mut styles: BTreeMap<String, String> = BTreeMap::new();
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths.iter().filter(|path| path.extension().is_some_and(|extension| extension == "gz")) {
        let Ok(file) = std::fs::File::open(path) else { continue };
        let mut text = String::new();
        if flate2::read::MultiGzDecoder::new(file).read_to_string(&mut text).is_err() {
            continue;
        }
        let Some((header, rows)) = text.split_once('\n') else { continue };
        for row in rows.lines() {
            let mut clip = row.split(',').next().unwrap_or_default().split('_');
            let (action, style) = (clip.next().unwrap_or_default(), clip.next().unwrap_or_default());
            if !is_asked(action) {
                continue;
            }
            let table = styles.entry(style.to_owned()).or_insert_with(|| format!("{header}\n"));
            table.push_str(row);
            table.push('\n');
        }
    }
    styles
}

/// Samples and truth of a run as CSV, for other programs: `benches/peers/body/functional_axes.py`.
struct Table {
    text: String,
    epoch: usize,
}

impl Table {
    fn new(build: &Build) -> Self {
        let mut text = format!("# thigh_m = {}, upper_arm_m = {}\nt_s", build.thigh_m, build.upper_arm_m);
        for name in BodySegment::ALL.into_iter().filter(|s| Sensors::Fifteen.has(*s)).map(BodySegment::name) {
            for column in ["gx", "gy", "gz", "ax", "ay", "az", "qw", "qx", "qy", "qz"] {
                _ = write!(text, ",{name}_{column}");
            }
        }
        text.push('\n');
        Self { text, epoch: 0 }
    }

    /// Gyro, rad/s, and accelerometer, m/s², sensor axes; true orientation, segment to room.
    fn row(&mut self, samples: &BodySamples, truth: &[UnitQuaternion<f64>; SEGMENTS]) {
        _ = write!(self.text, "{:.3}", self.epoch as f64 / RATE_HZ);
        for (sample, q) in samples.iter().zip(truth) {
            let Some(sample) = sample else { continue };
            for value in sample.gyro_rad_s.iter().chain(sample.accel_m_s2.iter()) {
                _ = write!(self.text, ",{value:.5}");
            }
            _ = write!(self.text, ",{:.6},{:.6},{:.6},{:.6}", q.w, q.i, q.j, q.k);
        }
        self.text.push('\n');
        self.epoch += 1;
    }
}
