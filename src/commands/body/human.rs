//! `posed body solve` of the human skeleton: calibrates, runs the live filter or the published one over the file, writes angles or an animation.

use posed_baselines::limbs::EulerBody;
use posed_fusion::ahrs::ImuSample;
use posed_fusion::body::assign;
use posed_fusion::body::{
    ANGLE_NAMES, BodyEstimate, BodyFilter, BodyParams, BodySamples, BodySegment, Heading, SEGMENTS,
    SensorMount, Skeleton, angles, completed, inner_angles, joints_between, of_joint,
};
use posed_fusion::body::{Block, BlockKind, Recorded, calibrate};
use posed_fusion::faults::Cause;
use posed_geometry::orientation_to_wxyz;
use posed_protocol::LearntEntry;
use posed_recording::animation::{self, Animation};
use posed_recording::table::{Imu, TableError, TableWriter};
use posed_stage::layout::{offset_on, skeleton_of};
use posed_stage::{Body, Mounting, Sensor, Stage};

use super::{Error, Limbs, Solve, epochs, one_each, places, print, print_json};

/// The answer.
#[derive(serde::Serialize)]
struct Summary {
    epochs: usize,
    sensors: Vec<SensorSummary>,
    warnings: Vec<String>,
    /// For how long the heading was held without a field at the end, s; 0 where a field was believed.
    heading_held_s: f64,
}

#[derive(serde::Serialize)]
struct SensorSummary {
    name: String,
    segment: &'static str,
    /// Sensor to segment.
    mount_quat_wxyz: [f64; 4],
    offset_m: [f64; 3],
    /// Root mean square disagreement of poses and movements, degrees; absent where the mounting was given.
    quality_deg: Option<f64>,
    /// What its movements have shown since; absent where the mounting was given, and for segments that are no limb's.
    learnt: Option<LearntSummary>,
    /// What was wrong with it, first of a kind with its time.
    faults: Vec<FaultSummary>,
}

#[derive(Clone, Copy, serde::Serialize)]
struct LearntSummary {
    /// How it sits at the end, sensor to segment.
    mount_quat_wxyz: [f64; 4],
    #[serde(flatten)]
    shown: LearntEntry,
}

#[derive(serde::Serialize)]
struct FaultSummary {
    fault: Cause,
    t: f64,
}

pub(super) fn solve(args: &Solve, stage: &Stage, body: &Body, imu: &Imu) -> Result<(), Error> {
    let skeleton = skeleton_of(body).ok_or_else(|| {
        Error::failed("the stage's [body] lacks `height_m`, which gives the segments' lengths")
    })?;
    let names = BodySegment::ALL.map(BodySegment::name);
    let mut places = places(stage, imu, &names);
    // A sensor on all of trunk and limbs, on head, hands and feet as well, or on everything.
    let whole = [SEGMENTS - BodySegment::LEAVES.len(), BodySegment::BEFORE_SHOULDERS, SEGMENTS]
        .contains(&imu.sensors.len());
    if args.assign && whole && places.iter().all(Option::is_none) {
        places = (0..imu.sensors.len()).map(Some).collect();
    }
    one_each(imu, &places, &names, false)?;
    if places.iter().all(Option::is_none) {
        return Err(Error::Failed(format!(
            "no sensor of the file sits on a segment (sensors: {}): name them like segments ({}), or give them \
             `segment` in the stage file",
            imu.sensors.join(", "),
            names.join(", ")
        )));
    }
    let blocks = blocks(body)?;
    let mut recording = recording(imu, &places)?;
    // Of each segment the file's sensor.
    let mut columns =
        BodySegment::ALL.map(|segment| places.iter().position(|place| *place == Some(segment.index())));
    if args.assign {
        if let Some(at) = places.iter().position(Option::is_none) {
            return Err(Error::Failed(format!(
                "--assign: give {} one of the segments that are worn, no matter which",
                imu.sensors[at]
            )));
        }
        let assignment = assign(&recording, &blocks).map_err(Error::failed)?;
        columns = assignment.place(&columns);
        recording = assignment.placed(&recording);
    }
    let name = |segment: BodySegment| Some(imu.sensors[columns[segment.index()]?].as_str());
    let sensors = BodySegment::ALL.map(|segment| {
        let name = name(segment)?;
        stage.sensors.iter().find(|sensor| sensor.name == name)
    });
    let present = columns.map(|at| at.is_some());
    let mut warnings = Vec::new();
    let (mounts, quality) = match body.mounting {
        Mounting::Given if !args.assign => (given(&sensors, &present, &skeleton)?, [None; SEGMENTS]),
        _ => {
            let offsets = BodySegment::ALL.map(|segment| offset_on(sensors[segment.index()]?, segment));
            let found = calibrate(&recording, &blocks, &skeleton, &offsets).map_err(Error::failed)?;
            warnings = found.warnings;
            (found.mounts, found.quality_deg)
        }
    };

    let mut filter = Filter::new(args.limbs, &skeleton, &mounts);
    if recording.iter().any(|(_, samples)| samples.iter().flatten().any(|sample| sample.mag.is_some())) {
        filter.await_field();
    }
    let nominal_s = match recording.as_slice() {
        [first, .., last] => (last.0 - first.0) / (recording.len() - 1) as f64,
        _ => 0.01,
    };
    let mut last_s = None;
    let mut estimates = Vec::with_capacity(recording.len());
    for (t_s, samples) in &recording {
        let dt_s = last_s.map_or(nominal_s, |last| t_s - last);
        last_s = Some(*t_s);
        estimates.push((*t_s, filter.push(samples, dt_s)));
    }
    write(args, &present, filter.skeleton().unwrap_or(&skeleton), &estimates)?;

    let learnt = filter.learnt();
    let summary = Summary {
        epochs: estimates.len(),
        sensors: BodySegment::ALL
            .into_iter()
            .filter_map(|segment| {
                let mount = mounts[segment.index()]?;
                Some(SensorSummary {
                    name: name(segment)?.to_owned(),
                    segment: segment.name(),
                    mount_quat_wxyz: orientation_to_wxyz(&mount.q_segment_sensor),
                    offset_m: mount.offset_m.into(),
                    quality_deg: quality[segment.index()],
                    learnt: learnt[segment.index()],
                    faults: faults(segment, &estimates),
                })
            })
            .collect(),
        warnings,
        heading_held_s: match estimates.last() {
            Some((_, BodyEstimate { heading: Heading::Held(seconds), .. })) => *seconds,
            _ => 0.0,
        },
    };
    notify(args, &summary)
}

/// The live filter, or the published limbs.
enum Filter {
    Joints(Box<BodyFilter>),
    Euler(Box<EulerBody>),
}

impl Filter {
    fn new(limbs: Limbs, skeleton: &Skeleton, mounts: &[Option<SensorMount>; SEGMENTS]) -> Self {
        let params = BodyParams::default();
        match limbs {
            Limbs::Joints => Self::Joints(Box::new(BodyFilter::new(skeleton, mounts, &params))),
            Limbs::Euler => Self::Euler(Box::new(EulerBody::new(skeleton, mounts, &params))),
        }
    }

    /// The sensors have magnetometers.
    fn await_field(&mut self) {
        if let Self::Joints(filter) = self {
            filter.await_field();
        }
    }

    /// Lengths as the movements have shown them; the published limbs learn none.
    fn skeleton(&self) -> Option<&Skeleton> {
        match self {
            Self::Joints(filter) => Some(filter.skeleton()),
            Self::Euler(_) => None,
        }
    }

    /// What the movements have shown by now.
    fn learnt(&self) -> [Option<LearntSummary>; SEGMENTS] {
        let Self::Joints(filter) = self else { return [None; SEGMENTS] };
        let (learnt, mounts) = (filter.learnt(), filter.mounts());
        std::array::from_fn(|index| {
            let (learnt, mount) = learnt[index].zip(mounts[index])?;
            let mount_quat_wxyz = orientation_to_wxyz(&mount.q_segment_sensor);
            Some(LearntSummary { mount_quat_wxyz, shown: learnt.into() })
        })
    }

    /// The published limbs say nothing of uncertainty, faults and heading.
    fn push(&mut self, samples: &BodySamples, dt_s: f64) -> BodyEstimate {
        match self {
            Self::Joints(filter) => filter.push(samples, dt_s).clone(),
            Self::Euler(body) => {
                let orientations = *body.push(samples, dt_s);
                BodyEstimate {
                    orientations,
                    posture: completed(&orientations),
                    angles_rad: angles(&orientations),
                    ..BodyEstimate::default()
                }
            }
        }
    }
}

fn notify(args: &Solve, summary: &Summary) -> Result<(), Error> {
    if args.json {
        return print_json(summary);
    }
    let mut text = format!("{} epochs\n", summary.epochs);
    for sensor in &summary.sensors {
        if args.assign {
            text += &format!("{} sits on {}\n", sensor.name, sensor.segment);
        }
        if let Some(quality) = sensor.quality_deg {
            text += &format!("{}: mounting good to {quality:.1} degrees\n", sensor.segment);
        }
        if let Some(LearntSummary { shown, .. }) = &sensor.learnt {
            let LearntEntry { mounting_sigma_deg, turned_deg, length_m, length_sigma_m } = shown;
            text += &format!(
                "{}: by its movements it sits {turned_deg:.1} degrees otherwise, known to {mounting_sigma_deg:.1}\n",
                sensor.segment
            );
            if let (Some(length_m), Some(sigma_m)) = (length_m, length_sigma_m) {
                text += &format!(
                    "{}: {length_m:.3} m long by its movements, known to {sigma_m:.3}\n",
                    sensor.segment
                );
            }
        }
        for fault in &sensor.faults {
            text += &format!("{}: {:?} at {:.2} s\n", sensor.segment, fault.fault, fault.t);
        }
    }
    for warning in &summary.warnings {
        text += &format!("{warning}\n");
    }
    if summary.heading_held_s > 0.0 {
        text += &format!(
            "the heading was held by the gyros for the last {:.0} s: no field was believed\n",
            summary.heading_held_s
        );
    }
    print(&text)
}

/// Samples by segment. A body of which not every sensor has a magnetometer is solved without.
fn recording(imu: &Imu, places: &[Option<usize>]) -> Result<Vec<Recorded>, Error> {
    let epochs = epochs(imu, places, SEGMENTS);
    let mut magnetic = [false; SEGMENTS];
    for (_, samples) in &epochs {
        for (has, sample) in magnetic.iter_mut().zip(samples) {
            *has |= sample.is_some_and(|sample| sample.mag.is_some());
        }
    }
    let all = places.iter().flatten().all(|place| magnetic[*place]);
    let mut recording: Vec<Recorded> = Vec::with_capacity(epochs.len());
    for (t_s, samples) in epochs {
        let at = |index: usize| samples[index].map(|s| ImuSample { mag: s.mag.filter(|_| all), ..s });
        recording.push((t_s, std::array::from_fn(at)));
    }
    if recording.is_empty() {
        return Err(Error::failed("the file has no complete sample of a sensor on the body"));
    }
    Ok(recording)
}

fn blocks(body: &Body) -> Result<Vec<Block>, Error> {
    body.calibration
        .iter()
        .map(|block| {
            let kind = BlockKind::named(&block.kind)
                .ok_or_else(|| Error::Failed(format!("`{}` is no pose or movement", block.kind)))?;
            Ok(Block { kind, start_s: block.start_s, end_s: block.end_s })
        })
        .collect()
}

/// The stage file's own mountings.
fn given(
    sensors: &[Option<&Sensor>; SEGMENTS],
    present: &[bool; SEGMENTS],
    skeleton: &Skeleton,
) -> Result<[Option<SensorMount>; SEGMENTS], Error> {
    let mut mounts = [None; SEGMENTS];
    for segment in BodySegment::ALL.into_iter().filter(|segment| present[segment.index()]) {
        let sensor = sensors[segment.index()];
        let given = sensor.and_then(|sensor| posed_pipeline::sensor_mount(sensor, segment, skeleton));
        mounts[segment.index()] = Some(given.ok_or_else(|| {
            Error::Failed(format!(
                "the sensor on `{}` has no `mount_quat_wxyz` in the stage file: give one, or set mounting = \"calibrate\"",
                segment.name()
            ))
        })?);
    }
    Ok(mounts)
}

fn faults(segment: BodySegment, estimates: &[(f64, BodyEstimate)]) -> Vec<FaultSummary> {
    let mut found: Vec<FaultSummary> = Vec::new();
    for (t, estimate) in estimates {
        if let Some(fault) = estimate.faults[segment.index()]
            && found.iter().all(|known| known.fault != fault)
        {
            found.push(FaultSummary { fault, t: *t });
        }
    }
    found
}

fn write(
    args: &Solve,
    present: &[bool; SEGMENTS],
    skeleton: &Skeleton,
    estimates: &[(f64, BodyEstimate)],
) -> Result<(), Error> {
    match animation::Format::of(&args.output) {
        None => table(args, present, estimates).map_err(Error::failed),
        Some(format) => {
            let mut animation = Animation::new(*skeleton);
            for (t_s, estimate) in estimates {
                animation.push(*t_s, estimate.posture, estimate.pelvis_m(skeleton));
            }
            animation.write(&args.output, format).map_err(Error::failed)
        }
    }
}

/// The table of angles: segments that a sensor shows, or that lie between two of these and are inferred, the joints beside them, and where the feet have
/// brought the hips if that is ever known.
fn table(
    args: &Solve,
    present: &[bool; SEGMENTS],
    estimates: &[(f64, BodyEstimate)],
) -> Result<(), TableError> {
    // The published limbs say nothing of uncertainty, and infer nothing.
    let is_judged = args.limbs == Limbs::Joints;
    let between = joints_between(present);
    let joints = BodySegment::ALL.into_iter().filter_map(|segment| {
        let worn = present[segment.index()] && present[segment.parent()?.index()];
        (worn || (is_judged && between[segment.index()])).then_some(segment)
    });
    let joints: Vec<BodySegment> = joints.collect();
    let beside = |of: BodySegment| joints.iter().any(|joint| *joint == of || joint.parent() == Some(of));
    let segments: Vec<BodySegment> =
        BodySegment::ALL.into_iter().filter(|s| present[s.index()] || beside(*s)).collect();
    let angles: Vec<usize> = joints.iter().flat_map(|segment| of_joint(*segment)).collect();
    let mut columns = vec!["t".to_owned()];
    for segment in &segments {
        columns.extend(["qw", "qx", "qy", "qz"].map(|part| format!("{}_{part}", segment.name())));
        columns.extend((!present[segment.index()]).then(|| format!("{}_inferred_sigma_deg", segment.name())));
    }
    for angle in &angles {
        let name = ANGLE_NAMES[*angle];
        columns.push(format!("{name}_deg"));
        columns.extend(is_judged.then(|| format!("{name}_sigma_deg")));
    }
    let inner = |posture| inner_angles(posture, present).filter(|_| args.whole);
    let upright = BodyEstimate::default().posture;
    columns.extend(inner(&upright).map(|(joint, angle, _)| format!("{joint}_{angle}_deg")));
    columns.extend(is_judged.then(|| "heading_sigma_deg".to_owned()));
    let soles = [("r", BodySegment::FootR), ("l", BodySegment::FootL)]
        .map(|(side, foot)| (side, present[foot.index()]));
    let travels = estimates.iter().any(|(_, estimate)| estimate.travel.is_some());
    if travels {
        columns.extend(["x", "y", "z"].map(|axis| format!("pelvis_{axis}_m")));
        columns.push("position_sigma_m".to_owned());
        columns.extend(["r", "l"].map(|side| format!("foot_{side}_contact")));
        for (side, _) in soles.iter().filter(|(_, worn)| *worn) {
            columns.extend(["heel", "toe"].map(|end| format!("{end}_{side}_contact")));
        }
    }
    let mut table = TableWriter::create(&args.output, &columns)?;
    for (t_s, estimate) in estimates {
        table.number(*t_s)?;
        let is_known = estimate.orientations.iter().any(Option::is_some);
        for index in segments.iter().map(|segment| segment.index()) {
            if present[index] {
                table.vector(estimate.orientations[index].as_ref().map(orientation_to_wxyz))?;
            } else {
                table.vector(is_known.then(|| orientation_to_wxyz(&estimate.posture[index])))?;
                table.vector(is_known.then(|| [estimate.sigma_rad[index].to_degrees()]))?;
            }
        }
        for angle in &angles {
            let value = estimate.angles_rad[*angle];
            table.vector(value.map(|angle| [angle.to_degrees()]))?;
            if is_judged {
                table.vector(value.map(|_| [estimate.spread.sigma_rad[*angle].to_degrees()]))?;
            }
        }
        for (_, _, angle) in inner(&estimate.posture) {
            table.vector(angle.filter(|_| is_known).map(|angle| [angle.to_degrees()]))?;
        }
        if is_judged {
            let is_known = estimate.heading != Heading::Unknown;
            table.vector(is_known.then_some([estimate.heading_sigma_rad.to_degrees()]))?;
        }
        if travels {
            table.vector(estimate.travel.map(|travel| <[f64; 3]>::from(travel.pelvis_m)))?;
            table.vector(estimate.travel.map(|travel| [travel.sigma_m]))?;
            let contacts = estimate.travel.and_then(|travel| travel.contacts);
            table.vector(contacts.map(|contacts| contacts.map(|contact| contact.foot)))?;
            for (side, _) in soles.iter().enumerate().filter(|(_, (_, worn))| *worn) {
                table.vector(contacts.and_then(|contacts| contacts[side].sole))?;
            }
        }
        table.end_row()?;
    }
    table.finish()
}
