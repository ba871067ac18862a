//! What a session's first posture tells of a body in the pole's place: where joints lie from their sensors, and how far they can turn
//! (Piperakis et al., about 2005, section 2: initial posture and limits of joints as knowledge of the domain).
//!
//! What comes in: a session, and when in it the person stood in an N-pose. What goes out: priors in [`Limbs`]. What it never does: take the place
//! of the readings; a way is known to some centimetres by it.

use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};
use posed_field::{JointRange, Limbs, PoleRun, Way};
use posed_fusion::body::{BodySegment, Skeleton};
use posed_geometry::so3;

/// How well a way is known from the posture and the proportions, per axis, m: sensors sit anywhere on a segment.
const WAY_SIGMA_M: f64 = 0.05;
/// Frames that a posture needs.
const LEAST_FRAMES: usize = 10;
/// What a limit is widened by, degrees: nobody stands straight, and metal turns sensors.
const MARGIN_DEG: f64 = 20.0;

/// A sensor and what it is known by.
pub(super) struct Worn {
    /// The segment that it sits on.
    pub(super) segment: BodySegment,
    /// Where on it, segment axes, m; half way along it if nobody says.
    pub(super) offset_m: Option<Vector3<f64>>,
}

/// Adds to the joints what an N-pose between two times of the run, s, tells. `worn` says what the run's sensors sit on, `up` is the vertical in the
/// transmitter's axes.
pub(super) fn add_priors(
    limbs: &mut Limbs,
    run: &PoleRun,
    [from_s, to_s]: [f64; 2],
    worn: &[Worn],
    skeleton: &Skeleton,
    up: &Vector3<f64>,
) -> Result<(), String> {
    let begin_s = run.frames.first().map_or(0.0, |frame| frame.t_s);
    let means: Vec<Option<Mean>> = (0..worn.len())
        .map(|sensor| {
            let span = from_s..=to_s;
            let frames = run.frames.iter().filter(|frame| span.contains(&(frame.t_s - begin_s)));
            Mean::of(frames.filter_map(|frame| {
                let reading = (*frame.readings.get(sensor)?)?;
                Some((reading.position_m, reading.orientation?))
            }))
        })
        .collect();
    let right = right_of(worn, &means, up)
        .ok_or("the posture needs sensors with orientations on the same segment of both sides")?;
    let segment_axes = Matrix3::from_columns(&[up.cross(&right), *up, right]);
    let room_segment = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(segment_axes));
    // Sensor to segment.
    let mounts: Vec<Option<UnitQuaternion<f64>>> = means
        .iter()
        .map(|mean| mean.as_ref().map(|mean| room_segment.inverse() * mean.orientation))
        .collect();
    for joint in &mut limbs.joints {
        let [child, parent] = joint.sensors;
        let segment = worn[child].segment;
        let ends = [skeleton.joint_in_segment_m(segment), skeleton.joint_in_parent_m(segment)];
        for ((way, sensor), end) in joint.ways.iter_mut().zip(joint.sensors).zip(ends) {
            let Some(mount) = mounts[sensor].filter(|_| way.is_none()) else { continue };
            let seat = worn[sensor]
                .offset_m
                .unwrap_or_else(|| 0.5 * skeleton.end_in_segment_m(worn[sensor].segment));
            *way = Some(Way { m: mount.inverse() * (end - seat), sigma_m: WAY_SIGMA_M });
        }
        let (Some(first), Some(second)) = (mounts[child], mounts[parent]) else { continue };
        joint.range = range(segment).map(|(axis, about_deg, beside_deg)| JointRange {
            neutral: second.inverse() * first,
            axis: first.inverse() * axis,
            about_rad: [about_deg[0] - MARGIN_DEG, about_deg[1] + MARGIN_DEG].map(f64::to_radians),
            beside_rad: (beside_deg + MARGIN_DEG).to_radians(),
        });
    }
    Ok(())
}

/// A sensor in the posture.
struct Mean {
    position_m: Vector3<f64>,
    orientation: UnitQuaternion<f64>,
}

impl Mean {
    fn of(readings: impl Iterator<Item = (Vector3<f64>, UnitQuaternion<f64>)>) -> Option<Self> {
        let (positions_m, orientations): (Vec<_>, Vec<_>) = readings.unzip();
        (positions_m.len() >= LEAST_FRAMES).then(|| Self {
            position_m: positions_m.iter().sum::<Vector3<f64>>() / positions_m.len() as f64,
            orientation: so3::mean(&orientations),
        })
    }
}

/// The person's right, level: from the left sensor of each pair to the right one.
fn right_of(worn: &[Worn], means: &[Option<Mean>], up: &Vector3<f64>) -> Option<Vector3<f64>> {
    let at = |segment: BodySegment| {
        let sensor = worn.iter().position(|worn| worn.segment == segment)?;
        Some(means[sensor].as_ref()?.position_m)
    };
    let pairs = [
        (BodySegment::UpperArmR, BodySegment::UpperArmL),
        (BodySegment::ForearmR, BodySegment::ForearmL),
        (BodySegment::ThighR, BodySegment::ThighL),
        (BodySegment::ShankR, BodySegment::ShankL),
    ];
    let across: Vector3<f64> =
        pairs.into_iter().filter_map(|(right, left)| Some(at(right)? - at(left)?)).sum();
    Unit::try_new(across - up * up.dot(&across), 0.05).map(Unit::into_inner)
}

/// The axis of a joint that has limits of its own, child's segment axes, how far it turns about and beside it, degrees; from the N-pose.
fn range(segment: BodySegment) -> Option<(Unit<Vector3<f64>>, [f64; 2], f64)> {
    match segment {
        // Flexion about -z.
        BodySegment::ShankR | BodySegment::ShankL => Some((-Vector3::z_axis(), [-8.0, 155.0], 10.0)),
        // Pronation about the forearm, and flexion across it.
        BodySegment::ForearmR | BodySegment::ForearmL => Some((Vector3::y_axis(), [-95.0, 95.0], 158.0)),
        BodySegment::ThighR | BodySegment::ThighL => Some((Vector3::y_axis(), [-60.0, 60.0], 130.0)),
        BodySegment::Torso => Some((Vector3::y_axis(), [-60.0, 60.0], 90.0)),
        // An upper arm goes anywhere.
        _ => None,
    }
}
