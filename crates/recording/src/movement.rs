//! The body's movement of a recording, for programs that draw or analyse it.

use std::path::Path;

use nalgebra::Vector3;
use thiserror::Error;

use super::export::go_on;
use super::{Item, ReadError, Take};
use crate::animation::{Animation, AnimationError, Format};
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton, completed};
use posed_geometry::orientation_from_wxyz;
use posed_protocol::Figure;
use posed_stage::Stage;
use posed_stage::layout::skeleton_of;

/// Why a recording cannot be turned into an animation.
#[derive(Debug, Error)]
pub enum MovementError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// It is not said which of several bodies, or there is none of that name.
    #[error("{0}")]
    WhichBody(String),
    /// It holds no body.
    #[error(
        "the recording holds no such body: its stage has no [[body]] with `height_m`, or nobody knew how its sensors sat"
    )]
    NoBody,
    /// The animation cannot be written.
    #[error(transparent)]
    Animation(#[from] AnimationError),
}

/// Writes a body of a recording, the one of that name or the only one, as an animation; returns the number of its `body` messages, which are its frames. Segments that
/// nothing showed stand as their parents do. The hips are where the pelvis, or else the first segment with a position, puts them;
/// without any position they are above the room's origin, with the lower foot on the floor. `progress` receives the bytes of the
/// recording read so far and says whether to go on.
///
/// # Errors
/// The recording cannot be read, holds no body or only one frame of it, or the file cannot be written; nothing is left behind.
pub fn animation(
    recording: &Path,
    output: &Path,
    format: Format,
    body: Option<&str>,
    mut progress: impl FnMut(u64) -> bool,
) -> Result<u64, MovementError> {
    let mut take = Take::open(recording)?;
    let stage = Stage::parse(&take.header().stage_toml)
        .map_err(|problems| ReadError::NotARecording(format!("its stage file is wrong: {problems}")))?;
    let several = stage.bodies.len() > 1;
    let stage = stage.of_body(body).map_err(MovementError::WhichBody)?;
    let mut skeleton = stage.bodies.first().and_then(skeleton_of).ok_or(MovementError::NoBody)?;
    let mut animation = Animation::new(skeleton);
    let mut frames = 0;
    while let Some(item) = take.next() {
        go_on(progress(take.bytes_read()))?;
        let Item::Message(message) = item? else { continue };
        if &*message.topic != "body" {
            continue;
        }
        let figure: Figure = serde_json::from_slice(&message.json)
            .map_err(|error| ReadError::NotARecording(format!("a `body` message cannot be read: {error}")))?;
        if several && stage.bodies.iter().all(|body| body.name != figure.name) {
            continue;
        }
        skeleton.learn(|segment| {
            let entry = figure.segments.iter().find(|entry| entry.name == segment.name())?;
            entry.learnt?.length_m
        });
        push(&mut animation, &skeleton, &figure);
        frames += 1;
    }
    animation.resize(skeleton);
    if frames == 0 {
        return Err(MovementError::NoBody);
    }
    animation.write(output, format)?;
    Ok(frames)
}

fn push(animation: &mut Animation, skeleton: &Skeleton, figure: &Figure) {
    let mut known = [None; SEGMENTS];
    let mut seen: Option<(BodySegment, Vector3<f64>)> = None;
    for entry in &figure.segments {
        let Some(segment) = BodySegment::named(&entry.name) else { continue };
        known[segment.index()] = entry.orientation_wxyz.and_then(orientation_from_wxyz);
        if let Some(position_m) = entry.position_m
            && (seen.is_none() || segment == BodySegment::Pelvis)
        {
            seen = Some((segment, position_m.into()));
        }
    }
    let all = completed(&known);
    let from_hips = skeleton.origins_m(&all, Vector3::zeros());
    let pelvis_m = seen.map_or_else(
        || skeleton.standing_m(&all),
        |(segment, position_m)| position_m - from_hips[segment.index()],
    );
    animation.push(figure.t_s, all, pelvis_m);
}
