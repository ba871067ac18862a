//! How an exercise was taught, as a figure that moves: for who is to do the same.
//!
//! In: the newest revision of an exercise. Out: the figure at equal distances in time. It shows what the exercise looks at: a joint that is
//! not among its channels hangs straight.

use super::super::server::Refusal;
use super::Calls;
use posed_fusion::body::{ANGLE_NAMES, ANGLES, BodySegment, SEGMENTS, Skeleton, of_joint, orientations};
use posed_motion::exercise::{Exercise, Joint};
use posed_protocol::{Demonstration, FigureSegment};
use posed_sessions::course_at;
use posed_stage::layout::skeleton_of;

/// Figures of a demonstration: as many as a repetition of 3 s has at 15 Hz.
const FRAMES: usize = 45;
/// Height of a figure on a stage that does not know its person's, m.
const USUAL_HEIGHT_M: f64 = 1.75;

impl Calls {
    /// How an exercise of the folder was taught.
    pub(super) fn demonstration(&self, name: &str) -> Result<Demonstration, Refusal> {
        let kept = self.exercises.newest(name).map_err(Refusal::failed)?;
        let exercise = kept.ok_or_else(|| Refusal::bad_request(format!("there is no exercise {name:?}")))?;
        let skeleton = self.stage.bodies.first().and_then(skeleton_of);
        let skeleton = skeleton.unwrap_or_else(|| Skeleton::from_height(USUAL_HEIGHT_M));
        demonstration(&exercise, &skeleton).ok_or_else(|| {
            let why = "it was not taught from joint angles, so that no figure can show it";
            Refusal::bad_request(format!("{name}: {why}"))
        })
    }
}

/// `None` where none of its channels is an angle of the body.
fn demonstration(exercise: &Exercise, skeleton: &Skeleton) -> Option<Demonstration> {
    let channels = exercise.channels.iter().zip(&exercise.movement.states.mean);
    let shown: Vec<_> = channels
        .filter_map(|(column, states)| {
            angle_of_column(column).map(|(angle, rad)| (column, angle, rad, states))
        })
        .collect();
    // As messages have it: without the shoulders where nothing is known of them.
    let mut shoulders = BodySegment::SHOULDERS.into_iter().flat_map(of_joint);
    let is_shown = |joint_angle: usize| shown.iter().any(|(_, angle, ..)| *angle == joint_angle);
    let moved = shoulders.any(is_shown);
    let segments = &BodySegment::ALL[..if moved { SEGMENTS } else { BodySegment::BEFORE_SHOULDERS }];
    let frame = |number: usize| {
        let mut known_rad = [None; ANGLES];
        for (_, angle, rad, states) in &shown {
            known_rad[*angle] = Some(rad * course_at(states, number, FRAMES));
        }
        figure(&orientations(&known_rad), skeleton, segments)
    };
    (!shown.is_empty()).then(|| Demonstration {
        exercise: exercise.name.clone(),
        revision: exercise.revision,
        duration_s: exercise.durations.median_s,
        angles: shown.iter().map(|(column, ..)| (*column).clone()).collect(),
        frames: (0..FRAMES).map(frame).collect(),
    })
}

/// The angle that a column holds, `elbow_r_flexion_deg` or `elbow_r_flexion_rad`: where it is in [`ANGLE_NAMES`], and rad per unit; `None`
/// of any other column.
fn angle_of_column(column: &str) -> Option<(usize, f64)> {
    let rad = Joint::of(column)?.degrees.to_radians();
    let (name, _) = column.rsplit_once('_')?;
    ANGLE_NAMES.iter().position(|known| *known == name).map(|index| (index, rad))
}

fn figure(
    orientations: &[nalgebra::UnitQuaternion<f64>; SEGMENTS],
    skeleton: &Skeleton,
    segments: &[BodySegment],
) -> Vec<FigureSegment> {
    let origins_m = skeleton.origins_m(orientations, skeleton.standing_m(orientations));
    let segment = |segment: &BodySegment| FigureSegment {
        name: segment.name().to_owned(),
        position_m: origins_m[segment.index()].into(),
        orientation_wxyz: posed_geometry::orientation_to_wxyz(&orientations[segment.index()]),
    };
    segments.iter().map(segment).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_of_other_quantities_are_no_angles() {
        let (index, rad) = angle_of_column("elbow_r_flexion_deg").unwrap();
        assert_eq!((index, rad), (8, 1.0_f64.to_radians()));
        let (index, rad) = angle_of_column("elbow_r_flexion_rad").unwrap();
        assert!(index == 8 && (rad - 1.0).abs() < 1e-15, "{rad}");
        for column in ["elbow_r_flexion", "wand_x_m", "elbow_flexion_deg", "_deg"] {
            assert_eq!(angle_of_column(column), None, "{column}");
        }
    }
}
