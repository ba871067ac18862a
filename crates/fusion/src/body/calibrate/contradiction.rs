//! What contradicts that a pose or a movement was done as it was asked for.
//!
//! In: what the poses and movements of a recording show in the sensors' own axes. Out: the first [`Contradiction`] there is, a
//! sentence for the person who wears the sensors. No mounting need be known for it: between two poses a segment turns by a
//! known angle however its sensor sits, arms that are raised rise, a hinge's axis is level in who stands upright, and all that
//! shows which way the body faces shows the same way.
//!
//! Limits are wide, because a calibration must bear how people stand: what is found is another posture, no inaccuracy. What is
//! held wrong in every pose alike (an elbow that is never straight, somebody who sits) contradicts nothing here; trackers on the
//! body ([`super::super::places`]) can show that.

use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

use super::super::block::{Block, BlockKind};
use super::super::skeleton::{BodySegment, upright};
use super::facing::{ARMS, faced, posture, raised_to, turned_between};
use super::session::{Axis, Held, Seen, Session};
use posed_geometry::GRAVITY_M_S2;

/// From hanging to the height of the shoulders an arm turns by 90 degrees, within this.
const RAISED_DEG: f64 = 25.0;
/// About its own length an arm may turn by so much meanwhile, and upper arm and forearm by so much apart, degrees.
const STRAIGHT_DEG: f64 = 30.0;
/// Trunk and legs are as upright in one pose as in another within this, and arms hang and heads are held alike within the other, degrees.
const UPRIGHT_DEG: f64 = 15.0;
const HANGS_DEG: f64 = 25.0;
/// Within this an axis is level that should be, degrees, and within this a movement begins as the person stood.
const LEVEL_DEG: f64 = 25.0;
const START_DEG: f64 = 30.0;
/// Elbows' axes look inwards by up to 40 degrees in relaxed arms: by more than this two movements do not show one body.
const FACING_DEG: f64 = 50.0;
/// An axis whose level part is shorter shows no facing.
const SHOWS_FACING: f64 = 0.4;
/// Somebody who turns more slowly is at rest, rad/s; so long a rest bounds a movement, s; longer ones are not integrated, s.
const REST_RAD_S: f64 = 0.15;
const REST_S: f64 = 0.3;
const LONGEST_RAISE_S: f64 = 8.0;
/// Specific forces are wrong by so much while an arm is raised, m/s²: their biases turn with it.
const FORCE_M_S2: f64 = 0.3;

/// What was held or done otherwise than asked for.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Contradiction {
    /// Arms went down where they should have gone up.
    #[error("the arms were lowered between n_pose and t_pose, not raised: begin with arms that hang")]
    Lowered,
    /// An arm is not at the height of the shoulders.
    #[error(
        "{segment} was raised by {found_deg:.0} degrees from n_pose to t_pose, not by 90: hold it sideways at the height of the shoulder"
    )]
    Raised {
        /// Of the arm.
        segment: &'static str,
        /// By how much it was raised, degrees.
        found_deg: f64,
    },
    /// An arm turned about its own length.
    #[error(
        "{segment} turned by {found_deg:.0} degrees about its length from n_pose to t_pose: palms to the body, then down; thumbs forward in both"
    )]
    Twisted {
        /// Of the arm.
        segment: &'static str,
        /// By how much, degrees.
        found_deg: f64,
    },
    /// Upper arm and forearm turned in different ways.
    #[error(
        "{elbow} was bent by {found_deg:.0} degrees more in one of the poses than in the other: keep the arm straight in both"
    )]
    Bent {
        /// The joint.
        elbow: &'static str,
        /// By how much, degrees.
        found_deg: f64,
    },
    /// Somebody stood in one pose in another way than in the first.
    #[error(
        "{segment} leans by {found_deg:.0} degrees in {pose} against the first n_pose: stand upright in all of them"
    )]
    Leans {
        /// Which segment.
        segment: &'static str,
        /// In which pose.
        pose: String,
        /// By how much, degrees.
        found_deg: f64,
    },
    /// A movement did not begin in the pose.
    #[error(
        "{movement} began {found_deg:.0} degrees from how {segment} was held in n_pose: begin it from there"
    )]
    Start {
        /// Which movement.
        movement: String,
        /// Which segment.
        segment: &'static str,
        /// By how much, degrees.
        found_deg: f64,
    },
    /// Another limb moved than the one that was to.
    #[error(
        "{moved} moved in {movement}, and {asked} did not: move what is asked for; where that was moved, the two sensors are swapped, which a \
         calibration of every limb puts right"
    )]
    Instead {
        /// Which movement.
        movement: String,
        /// What was to move.
        asked: &'static str,
        /// What did.
        moved: &'static str,
    },
    /// A movement's axis is steep where it should be level, or level where it should be upright.
    #[error(
        "the axis of {movement} is {found_deg:.0} degrees steeper in {segment} than in somebody who stands upright: stand as in n_pose, and move nothing else"
    )]
    Steep {
        /// Which movement.
        movement: String,
        /// Which segment.
        segment: &'static str,
        /// By how much, degrees.
        found_deg: f64,
    },
    /// A walk on which neither strides nor knees show which way is ahead.
    #[error(
        "the walk does not show which way the body faces: walk about once more, always forwards, some steps straight on"
    )]
    NoWay,
    /// Two movements show two bodies.
    #[error(
        "{first} and {second} disagree by {found_deg:.0} degrees about which way the body faces: repeat them as they are described, and see \
         whether iron nearby turns the magnetic field"
    )]
    Facing {
        /// One of them.
        first: String,
        /// The other.
        second: String,
        /// By how much, degrees.
        found_deg: f64,
    },
}

/// Holds poses and movements against one another.
pub(super) fn check(session: &Session<'_>, seen: &Seen) -> Result<(), Contradiction> {
    lowered(session, seen)?;
    if let (Some(low), Some(high)) = (seen.low(), seen.high()) {
        raised(session.magnetic, low, high)?;
    }
    upright_in_all(seen)?;
    for axis in &seen.axes {
        begins_in_pose(session, seen, axis)?;
        level(seen, axis)?;
    }
    one_body(session.magnetic, seen)
}

/// Whatever hung in the first pose is not lower in the second, wherever it sits.
pub(super) fn lowered(session: &Session<'_>, seen: &Seen) -> Result<(), Contradiction> {
    if let (Some(low), Some((block, high))) = (seen.low(), seen.spread.first())
        && rise_m(session, low, high, block).is_some_and(|rise_m| rise_m < 0.0)
    {
        return Err(Contradiction::Lowered);
    }
    Ok(())
}

/// By how much the sensors that gravity turned in rose before a pose, m, together; `None` where it can't be said.
///
/// Twice integrated specific force between two times of rest: what the velocity is wrong by at the end is taken out evenly.
fn rise_m(session: &Session<'_>, low: &Held, high: &Held, block: &Block) -> Option<f64> {
    let mut sum_m = None;
    for segment in BodySegment::ALL {
        let index = segment.index();
        let (Some(low), Some(high)) = (low[index], high[index]) else { continue };
        if tilt_deg(&low, &high) < 90.0 - RAISED_DEG {
            continue;
        }
        let Some((rise_m, duration_s)) = risen_m(session, index, block) else { continue };
        if rise_m.abs() > FORCE_M_S2 * duration_s.powi(2) / 12.0 {
            *sum_m.get_or_insert(0.0) += rise_m;
        }
    }
    sum_m
}

/// Of one sensor, with how long it took, s.
fn risen_m(session: &Session<'_>, index: usize, block: &Block) -> Option<(f64, f64)> {
    let end = session.recording.partition_point(|(t_s, _)| *t_s <= block.start_s);
    let (mut first, mut rests_since, mut moved) = (None, None, false);
    for k in (0..end).rev() {
        let (t_s, samples) = &session.recording[k];
        if block.start_s - t_s > LONGEST_RAISE_S {
            return None;
        }
        let rests = samples[index].is_none_or(|sample| sample.gyro_rad_s.norm() < REST_RAD_S);
        moved |= !rests;
        rests_since = if rests && moved { rests_since.or(Some(*t_s)) } else { None };
        if rests_since.is_some_and(|since_s: f64| since_s - t_s >= REST_S) {
            first = Some(k);
            break;
        }
    }
    let span = first?..end;
    let (mut velocity_m_s, mut rise_m, mut last_s) = (0.0, 0.0, None);
    for k in span.clone() {
        let (t_s, samples) = &session.recording[k];
        let dt_s = last_s.map_or(0.0, |last_s| t_s - last_s);
        last_s = Some(*t_s);
        if let Some(sample) = samples[index] {
            velocity_m_s += ((session.tracks[index][k] * sample.accel_m_s2).z - GRAVITY_M_S2) * dt_s;
        }
        rise_m += velocity_m_s * dt_s;
    }
    let duration_s = last_s? - session.recording[span.start].0;
    Some((rise_m - 0.5 * velocity_m_s * duration_s, duration_s))
}

/// Both arms were raised by a quarter turn, straight.
fn raised(magnetic: bool, low: &Held, high: &Held) -> Result<(), Contradiction> {
    let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turned_between(low, high));
    let rotation = |segment: BodySegment| {
        let (low, high) = (low[segment.index()]?, high[segment.index()]?);
        Some(turned * high * low.inverse())
    };
    for [upper, fore] in [ARMS[0], ARMS[1]] {
        let above = rotation(upper);
        if let Some(rotation) = &above {
            quarter_turn(upper, rotation)?;
        }
        let Some(below) = rotation(fore) else { continue };
        let elbow = if fore.side() > 0.0 { "elbow_r" } else { "elbow_l" };
        let done = quarter_turn(fore, &below);
        let Some(above) = above else {
            done?;
            continue;
        };
        // Whatever its own heading is worth, an arm whose upper half is right and whose lower is not is bent.
        let found_deg = above.angle_to(&below).to_degrees();
        if done.is_err() || magnetic && found_deg > STRAIGHT_DEG {
            return Err(Contradiction::Bent { elbow, found_deg });
        }
    }
    Ok(())
}

/// A rotation of a segment that hung takes it to the height of the shoulders, and does not turn it about its length.
fn quarter_turn(segment: BodySegment, rotation: &UnitQuaternion<f64>) -> Result<(), Contradiction> {
    let segment = segment.name();
    let found_deg = (rotation * Vector3::z()).angle(&Vector3::z()).to_degrees();
    if (found_deg - 90.0).abs() > RAISED_DEG {
        return Err(Contradiction::Raised { segment, found_deg });
    }
    let swing = UnitQuaternion::rotation_between(&-Vector3::z(), &raised_to(rotation));
    let found_deg = swing.map_or(0.0, |swing| swing.angle_to(rotation).to_degrees());
    if found_deg > STRAIGHT_DEG {
        return Err(Contradiction::Twisted { segment, found_deg });
    }
    Ok(())
}

/// Trunk and legs are as upright in all poses as in the first, and arms that hang again hang alike.
fn upright_in_all(seen: &Seen) -> Result<(), Contradiction> {
    let leans = |block: &Block, held: &Held| {
        BodySegment::ALL.into_iter().try_for_each(|segment| {
            // Shoulders rise with the arms.
            let is_arm = BodySegment::ARMS.contains(&segment) || BodySegment::SHOULDERS.contains(&segment);
            let limit_deg = match block.kind {
                BlockKind::TPose if is_arm => return Ok(()),
                _ if is_arm || segment == BodySegment::Head => HANGS_DEG,
                _ => UPRIGHT_DEG,
            };
            leans(seen, segment, block, held, limit_deg, segment.name())
        })
    };
    seen.standing.iter().skip(1).chain(&seen.spread).try_for_each(|(block, held)| leans(block, held))
}

/// The same of sensors of which nobody knows yet where they sit.
pub(super) fn hangs_again(seen: &Seen) -> Result<(), Contradiction> {
    let leans = |block: &Block, held: &Held| {
        BodySegment::ALL
            .into_iter()
            .try_for_each(|segment| leans(seen, segment, block, held, HANGS_DEG, "a sensor"))
    };
    seen.standing.iter().skip(1).try_for_each(|(block, held)| leans(block, held))
}

fn leans(
    seen: &Seen,
    at: BodySegment,
    block: &Block,
    held: &Held,
    limit_deg: f64,
    segment: &'static str,
) -> Result<(), Contradiction> {
    let first = seen.low().and_then(|first| first[at.index()]);
    let (Some(first), Some(held)) = (first, held[at.index()]) else { return Ok(()) };
    let found_deg = tilt_deg(&first, &held);
    if found_deg > limit_deg {
        return Err(Contradiction::Leans { segment, pose: block.kind.name(), found_deg });
    }
    Ok(())
}

/// A limb that is to move does so from how it hung, or from a posture that the movement goes through.
fn begins_in_pose(session: &Session<'_>, seen: &Seen, axis: &Axis) -> Result<(), Contradiction> {
    let BlockKind::Move(segment, _) = axis.block.kind else { return Ok(()) };
    let index = segment.index();
    let Some(held) = seen.low().and_then(|held| held[index]) else { return Ok(()) };
    let Some(start) = session.tracks[index].get(session.range(&axis.block).start) else { return Ok(()) };
    // About its own axis it may begin anywhere: the pose shows which way it went.
    let steepness = |q: &UnitQuaternion<f64>| libm::asin((q * axis.sensor).z.clamp(-1.0, 1.0));
    let found_deg = (steepness(&held) - steepness(start)).abs().to_degrees();
    if axis.segment == segment && found_deg > START_DEG {
        let movement = axis.block.kind.name();
        return Err(Contradiction::Start { movement, segment: segment.name(), found_deg });
    }
    Ok(())
}

/// An axis is as level in the sensor as in somebody who holds the pose.
fn level(seen: &Seen, axis: &Axis) -> Result<(), Contradiction> {
    let Some(held) = seen.reference().and_then(|held| held[axis.segment.index()]) else { return Ok(()) };
    let steepness_deg = |v: Vector3<f64>| libm::asin(v.z.clamp(-1.0, 1.0)).to_degrees();
    let asked = upright() * posture(axis.segment, seen.low().is_none()) * axis.in_segment;
    let found_deg = (steepness_deg(held * axis.sensor) - steepness_deg(asked)).abs();
    if found_deg > LEVEL_DEG {
        let (movement, segment) = (axis.block.kind.name(), axis.segment.name());
        return Err(Contradiction::Steep { movement, segment, found_deg });
    }
    Ok(())
}

/// All that shows which way the body faces shows one way: of the whole body where headings are those of the room, else of each
/// sensor.
fn one_body(magnetic: bool, seen: &Seen) -> Result<(), Contradiction> {
    let mut faced: Vec<_> = faced(seen).filter(|faced| faced.forward.norm() > SHOWS_FACING).collect();
    faced.sort_by_key(|faced| (faced.segment.index(), faced.kind != BlockKind::TPose));
    for (k, one) in faced.iter().enumerate() {
        for other in &faced[..k] {
            if !magnetic && one.segment != other.segment {
                continue;
            }
            let found_deg = one.forward.angle(&other.forward).to_degrees();
            if found_deg > FACING_DEG {
                let name = |kind: BlockKind, segment: BodySegment| match kind {
                    BlockKind::Move(..) => kind.name(),
                    _ => format!("{} ({})", kind.name(), segment.name()),
                };
                let (first, second) = (name(other.kind, other.segment), name(one.kind, one.segment));
                return Err(Contradiction::Facing { first, second, found_deg });
            }
        }
    }
    Ok(())
}

/// How far gravity turned in a sensor, degrees.
fn tilt_deg(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>) -> f64 {
    (a.inverse() * Vector3::z()).angle(&(b.inverse() * Vector3::z())).to_degrees()
}
