//! A body for tests of what is sent of it.

use nalgebra::{UnitQuaternion, Vector3};

use posed_drivers::Timestamp;
use posed_fusion::body::{ANGLES, Heading, SEGMENTS, Skeleton};
use posed_geometry::orientation_to_wxyz;
use posed_stage::output::{Body, PositionSource, SegmentEstimate, SegmentState};

/// A body of 1.8 m all of whose segments a sensor shows, with these orientations (segment to room), its hips somewhere.
pub(crate) fn body(t_ms: i64, orientations: &[UnitQuaternion<f64>; SEGMENTS]) -> Body {
    let origins = Skeleton::from_height(1.8).origins_m(orientations, Vector3::new(0.4, -0.3, 0.95));
    let segments = (0..SEGMENTS)
        .map(|at| SegmentEstimate {
            state: SegmentState::Ok,
            sensor: Some(0),
            position_m: Some(origins[at].into()),
            orientation_wxyz: Some(orientation_to_wxyz(&orientations[at])),
            sigma_rad: 0.01,
            fault: None,
            learnt: None,
        })
        .collect();
    Body {
        index: 0,
        t_valid: Timestamp::from_nanos(t_ms * 1_000_000),
        heading: Heading::Field,
        heading_sigma_rad: Some(0.02),
        position_source: PositionSource::Trackers,
        position_sigma_m: Some(0.02),
        contacts: None,
        segments,
        angles_rad: [None; ANGLES],
        spread: Default::default(),
    }
}
