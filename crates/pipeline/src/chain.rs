//! A chain of hinges, live: a custom skeleton with an IMU on each segment.
//!
//! What comes in: closed frames; a calibration, as a model. What goes out: segments, the angle of every hinge and how uncertain each
//! is, at the frame's time. What it never does: publish a chain before its axes are known, or before the headings between its
//! sensors have settled.

use posed_state::State;

use crate::frame::Frame;
use posed_fusion::body::Heading;
use posed_fusion::chain::{ChainCalibration, LiveChain};
use posed_geometry::orientation_to_wxyz;
use posed_stage::input::SensorIndex;
use posed_stage::layout::ChainLayout;
use posed_stage::output::{Body, SegmentEstimate, SegmentState};
use posed_stage::{BodyIndex, Stage};

/// Headings count as known from here on, rad; before, the axes have been level for too short a time.
const SETTLED_RAD: f64 = 0.1;

#[derive(Clone, Debug, State)]
pub(super) struct ChainStage {
    #[state(keep)]
    names: Vec<String>,
    #[state(keep)]
    parents: Vec<Option<usize>>,
    /// The IMU on each segment.
    #[state(keep)]
    imus: Vec<SensorIndex>,
    calibration: Option<ChainCalibration>,
    live: Option<LiveChain>,
    /// Whether the headings have been known.
    settled: bool,
    /// Since when, s.
    begun_s: Option<f64>,
    out: Body,
}

impl ChainStage {
    /// `None` where this body is no such chain.
    pub(super) fn new(stage: &Stage, body: BodyIndex) -> Option<Self> {
        let ChainLayout { segments, imus } = ChainLayout::of(stage, body)?;
        Some(Self {
            names: segments.iter().map(|segment| segment.name.clone()).collect(),
            parents: segments
                .iter()
                .map(|segment| segment.hinge.as_ref().map(|(parent, _)| *parent))
                .collect(),
            calibration: None,
            live: None,
            settled: false,
            begun_s: None,
            out: Body::unknown(body, imus.len()),
            imus,
        })
    }

    /// Takes a calibration; false where it is of other segments.
    pub(super) fn calibrate(&mut self, calibration: &ChainCalibration) -> bool {
        let same = calibration.segments.iter().map(|segment| &segment.name).eq(&self.names);
        let live = LiveChain::new(&self.parents, calibration).filter(|_| same);
        if live.is_some() {
            (self.live, self.settled, self.begun_s) = (live, false, None);
            self.calibration = Some(calibration.clone());
        }
        same && self.live.is_some()
    }

    /// A sensor's samples are corrected otherwise from now on.
    pub(super) fn restart(&mut self, sensor: SensorIndex) {
        if let Some(calibration) = self.calibration.as_ref().filter(|_| self.imus.contains(&sensor)) {
            (self.live, self.settled, self.begun_s) =
                (LiveChain::new(&self.parents, calibration), false, None);
        }
    }

    /// Whether its axes are known.
    pub(super) fn is_mounted(&self) -> bool {
        self.live.is_some()
    }

    /// Takes a closed frame; the chain, if there is news of it.
    pub(super) fn frame(&mut self, frame: &Frame) -> Option<&Body> {
        let live = self.live.as_mut()?;
        let mut news = false;
        for (segment, imu) in self.imus.iter().enumerate() {
            for sample in &frame.sensors[usize::from(*imu)].samples {
                if let Some(reported) = sample.measured.inertial.and_then(|inertial| inertial.sample()) {
                    live.push(segment, sample.measured.t_valid.as_secs_f64(), &reported);
                    news = true;
                }
            }
        }
        if !news {
            return None;
        }
        let t_s = frame.t_valid.as_secs_f64();
        live.advance(t_s);
        self.settled |= live.is_settled(SETTLED_RAD);
        if !self.settled {
            return None;
        }
        self.out.t_valid = frame.t_valid;
        self.out.heading = Heading::Held(t_s - *self.begun_s.get_or_insert(t_s));
        for (at, out) in self.out.segments.iter_mut().enumerate() {
            let pose = live.pose(at, t_s);
            *out = SegmentEstimate {
                state: if pose.is_some() { SegmentState::Ok } else { SegmentState::Missing },
                sensor: Some(self.imus[at]),
                orientation_wxyz: pose.map(|pose| orientation_to_wxyz(&pose.orientation)),
                sigma_rad: pose.map_or(std::f64::consts::PI, |pose| pose.sigma_rad),
                ..SegmentEstimate::default()
            };
            let hinged = pose.filter(|_| self.parents[at].is_some());
            self.out.angles_rad[at] = hinged.map(|pose| pose.flexion_rad);
            let sigma_rad = hinged.map_or(0.0, |pose| pose.sigma_rad);
            self.out.spread.sigma_rad[at] = sigma_rad;
            self.out.spread.covariance_rad2[at][0] = sigma_rad * sigma_rad;
        }
        Some(&self.out)
    }

    /// The latest chain; none before the first.
    pub(super) fn latest(&self) -> Option<&Body> {
        self.settled.then_some(&self.out)
    }
}
