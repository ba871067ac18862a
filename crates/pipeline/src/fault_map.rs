//! The fault map, live: what it reports about each frame before anything is filtered.
//!
//! What comes in: closed frames, in device axes. What goes out: a label per frame, and [`Advice`] per sensor. What it never
//! does: change a record, or look at a prediction. It states what `posed faults detect` reports about the same positions.

use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3};
use posed_state::{Plain, State};

use crate::frame::Frame;
use posed_fusion::faults::{Cause, Class, Debounce, Label, Mirror};
use posed_motion::fault_map::{FaultMap, FaultMapError, Frame as PoseFrame, Frames, Watch};
use posed_stage::input::SensorIndex;
use posed_stage::output::{Estimate, FrameLabel, Measured};

/// Cosine of the angle up to which a transmitter stands upright: 2.5 degrees.
const LEVEL: f64 = 0.999;

/// What the map reports about a sensor in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Advice {
    pub(super) label: Label,
    /// From the nearest place where the sensor was in training, m.
    pub(super) distance_m: Option<f64>,
    /// What has been wrong with it for most of the last frames, as it was first called.
    pub(super) lasting: Option<Cause>,
    /// It was not clean; a fault is published once that lasts.
    recent: Debounce,
}

impl Advice {
    fn none() -> Self {
        Self { label: Label::MISSING, distance_m: None, lasting: None, recent: Debounce::default() }
    }

    fn take(&mut self, label: Label, distance_m: f64) {
        let bad = matches!(label.class, Class::Inverted | Class::Anomalous);
        self.recent.push(bad);
        let lasts = self.recent.lasts();
        // A jump that ends as a wrong distance is one fault, not two. A flip may follow another fault, and says more.
        let first = self.lasting.filter(|_| label.class != Class::Inverted);
        self.lasting = first.or(label.cause.filter(|_| bad)).filter(|_| lasts);
        self.distance_m = Some(distance_m).filter(|distance| distance.is_finite());
        self.label = label;
    }
}

#[derive(Clone, Debug, State)]
pub(super) struct FaultMapStage {
    #[state(keep)]
    fault_map: FaultMap,
    watch: Watch,
    /// The stage's sensor that each of the network's is.
    #[state(keep)]
    order: Vec<SensorIndex>,
    /// The frame in transmitter axes turned z up, in the network's order; NaN where missing.
    positions_m: Vec<f64>,
    orientations_wxyz: Vec<f64>,
    /// By the stage's sensors; absent where the network does not know one.
    advice: Vec<Option<Advice>>,
}

impl FaultMapStage {
    /// For a stage with these sensors, those of magnetic trackers marked.
    ///
    /// # Errors
    /// The network knows other sensors than the stage's magnetic ones.
    pub(super) fn new<'a>(
        fault_map: &FaultMap,
        sensors: impl Iterator<Item = (&'a str, bool)>,
    ) -> Result<Self, FaultMapError> {
        let sensors: Vec<(&str, bool)> = sensors.collect();
        let magnetic: Vec<&str> = sensors.iter().filter(|sensor| sensor.1).map(|sensor| sensor.0).collect();
        fault_map.check_sensors(&magnetic)?;
        let at = |name: &String| sensors.iter().position(|sensor| sensor.0 == name).unwrap_or_default();
        Ok(Self {
            watch: fault_map.watch(),
            order: fault_map.sensors.iter().map(|name| at(name) as SensorIndex).collect(),
            positions_m: vec![f64::NAN; 3 * fault_map.sensors.len()],
            orientations_wxyz: vec![f64::NAN; 4 * fault_map.sensors.len()],
            advice: sensors.iter().map(|sensor| sensor.1.then(Advice::none)).collect(),
            fault_map: fault_map.clone(),
        })
    }

    /// Takes a network whose cells have other names, and goes on; false where more than that is different.
    pub(super) fn rename(&mut self, fault_map: &FaultMap) -> bool {
        let renamed = self.fault_map.is_renamed(fault_map);
        if renamed {
            self.fault_map.clone_from(fault_map);
        }
        renamed
    }

    /// Labels a frame; `room` is where the transmitter stands.
    pub(super) fn frame(&mut self, frame: &Frame, room: &Isometry3<f64>) -> FrameLabel {
        let rows = self.positions_m.chunks_exact_mut(3).zip(self.orientations_wxyz.chunks_exact_mut(4));
        for (sensor, (p, q)) in self.order.iter().zip(rows) {
            let newest = frame.sensors.get(usize::from(*sensor)).and_then(|slot| slot.samples.last());
            let pose = RawPose::of(newest.map(|sample| &sample.measured)).upright(room);
            p.copy_from_slice(&pose.position_m);
            q.copy_from_slice(&pose.orientation_wxyz);
        }
        let poses = PoseFrame { positions_m: &self.positions_m, orientations_wxyz: &self.orientations_wxyz };
        let judged = self.watch.push(&self.fault_map, poses);
        // Of a transmitter that does not stand upright the vertical axis is none of its own, in which a record is mirrored back.
        let is_level = (room.rotation * Vector3::z()).z.abs() > LEVEL;
        for (index, sensor) in self.order.iter().enumerate() {
            if let Some(advice) = &mut self.advice[usize::from(*sensor)] {
                let label = judged.sensors[index];
                let undone = is_level || label.mirror() != Some(Mirror::Vertical);
                let label = if undone { label } else { Label::anomalous(Cause::Jump) };
                advice.take(label, judged.distances_m[index]);
            }
        }
        FrameLabel {
            label: judged.label.class,
            cause: judged.label.cause,
            distance: judged.winner.map(|winner| winner.distance),
            cell: judged.winner.map(|winner| winner.cell as u32),
        }
    }

    /// What is said of a sensor of the stage in this frame.
    pub(super) fn advice(&self, sensor: usize) -> Option<&Advice> {
        self.advice.get(sensor)?.as_ref()
    }
}

/// A pose of a magnetic sensor before any repair; numbers are NaN where there are none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RawPose {
    /// In device axes, or in those that it was turned to, m.
    pub position_m: [f64; 3],
    /// Sensor to the same axes, unit quaternion, scalar first.
    pub orientation_wxyz: [f64; 4],
}

impl RawPose {
    /// A coordinate at the end of its words says nothing of the place: its position is none.
    fn of(measured: Option<&Measured>) -> Self {
        let whole = measured.filter(|measured| !measured.clipped);
        Self {
            position_m: whole.and_then(|measured| measured.position_m).unwrap_or([f64::NAN; 3]),
            orientation_wxyz: measured
                .and_then(|measured| measured.orientation_wxyz)
                .unwrap_or([f64::NAN; 4]),
        }
    }

    /// The same in transmitter axes turned z up: as fault maps see it. `room_transmitter` is transmitter to room, of which only
    /// the rotation counts: the origin stays at the transmitter. NaN stays NaN.
    pub fn upright(self, room_transmitter: &Isometry3<f64>) -> Self {
        let [w, x, y, z] = self.orientation_wxyz;
        let q = room_transmitter.rotation * UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        Self {
            position_m: (room_transmitter.rotation * Point3::from(self.position_m)).coords.into(),
            orientation_wxyz: [q.w, q.i, q.j, q.k],
        }
    }

    /// Appends it to the last frame of some.
    pub fn append_to(&self, frames: &mut Frames) {
        frames.positions_m.extend(self.position_m);
        frames.orientations_wxyz.extend(self.orientation_wxyz);
    }
}

/// Gives the raw pose of each of these sensors (indices in the stage) in this frame to `take`, in their order: device axes; NaN where
/// there is none, or no such sensor.
pub fn raw_poses(estimate: &Estimate, sensors: &[usize], mut take: impl FnMut(RawPose)) {
    for sensor in sensors {
        let sensor = estimate.sensors.get(*sensor);
        take(RawPose::of(sensor.and_then(|sensor| sensor.measured.as_ref())));
    }
}
