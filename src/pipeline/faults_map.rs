//! The map of faults, live: what it says of each frame before anything is filtered.
//!
//! What comes in: closed frames, in device axes. What goes out: a label per frame, and [`Advice`] per sensor. What it never
//! does: change a record, or look at a prediction. It says what `posed faults detect` says of the same positions.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

use crate::faults::som::rules::{Cause, Class};
use crate::faults::som::{Network, NetworkError, Watch};
use crate::frame::Frame;
use crate::input::SensorIndex;
use crate::output::{Estimate, FaultCause, FrameLabel};

/// A fault is published once this many of the last five frames have it.
const LASTS: u32 = 3;
const RECENT: u8 = 0b1_1111;

/// What the map says of a sensor in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Advice {
    pub(super) class: Class,
    pub(super) cause: Cause,
    /// From the nearest place where the sensor was in training, m.
    pub(super) distance_m: Option<f64>,
    /// What has been wrong with it for most of the last frames, as it was first called.
    pub(super) lasting: Option<FaultCause>,
    /// One bit for each of the last five frames: it was not clean.
    recent: u8,
}

impl Advice {
    const NONE: Self =
        Self { class: Class::Unknown, cause: Cause::Missing, distance_m: None, lasting: None, recent: 0 };

    fn take(&mut self, (class, cause): (Class, Cause), distance_m: f64) {
        let bad = matches!(class, Class::Inverted | Class::Anomalous);
        self.recent = (self.recent << 1 | u8::from(bad)) & RECENT;
        let lasts = self.recent.count_ones() >= LASTS;
        // A jump that ends as a wrong distance is one fault, not two. A flip may follow another fault, and says more.
        let first = self.lasting.filter(|_| cause != Cause::Flip);
        self.lasting = first.or(published(cause)).filter(|_| lasts);
        self.distance_m = Some(distance_m).filter(|distance| distance.is_finite());
        (self.class, self.cause) = (class, cause);
    }
}

/// As what a cause is published.
fn published(cause: Cause) -> Option<FaultCause> {
    match cause {
        Cause::None | Cause::Missing => None,
        Cause::Flip => Some(FaultCause::Hemisphere),
        Cause::Frozen => Some(FaultCause::Stuck),
        Cause::Jump => Some(FaultCause::Jump),
        Cause::Bone => Some(FaultCause::Bone),
        Cause::Map => Some(FaultCause::Map),
        Cause::Distance => Some(FaultCause::Distance),
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct FaultsMap {
    network: Network,
    watch: Watch,
    /// The stage's sensor that each of the network's is.
    order: Vec<SensorIndex>,
    /// The frame in transmitter axes turned z up, in the network's order; NaN where missing.
    positions_m: Vec<f64>,
    /// By the stage's sensors; absent where the network does not know one.
    advice: Vec<Option<Advice>>,
}

impl FaultsMap {
    /// For a stage with these sensors, those of magnetic trackers marked.
    ///
    /// # Errors
    /// The network knows other sensors than the stage's magnetic ones.
    pub(super) fn new<'a>(
        network: &Network,
        sensors: impl Iterator<Item = (&'a str, bool)>,
    ) -> Result<Self, NetworkError> {
        let sensors: Vec<(&str, bool)> = sensors.collect();
        let magnetic: Vec<&str> = sensors.iter().filter(|sensor| sensor.1).map(|sensor| sensor.0).collect();
        network.check_sensors(&magnetic)?;
        let at = |name: &String| sensors.iter().position(|sensor| sensor.0 == name).unwrap_or_default();
        Ok(Self {
            watch: network.watch(),
            order: network.sensors.iter().map(|name| at(name) as SensorIndex).collect(),
            positions_m: vec![f64::NAN; 3 * network.sensors.len()],
            advice: sensors.iter().map(|sensor| sensor.1.then_some(Advice::NONE)).collect(),
            network: network.clone(),
        })
    }

    /// Takes a network whose cells have other names, and goes on; false where more than that is different.
    pub(super) fn rename(&mut self, network: &Network) -> bool {
        let renamed = self.network.is_renamed(network);
        if renamed {
            self.network.clone_from(network);
        }
        renamed
    }

    /// Labels a frame; `room` is where the transmitter stands.
    pub(super) fn frame(&mut self, frame: &Frame, room: &Isometry3<f64>) -> FrameLabel {
        for (sensor, p) in self.order.iter().zip(self.positions_m.chunks_exact_mut(3)) {
            let newest = frame.sensors.get(usize::from(*sensor)).and_then(|slot| slot.samples.last());
            let position_m = newest.and_then(|sample| sample.measured.position_m);
            p.copy_from_slice(&position_m.map_or([f64::NAN; 3], |p| upright(p, room)));
        }
        let verdict = self.watch.push(&self.network, &self.positions_m);
        for (index, sensor) in self.order.iter().enumerate() {
            if let Some(advice) = &mut self.advice[usize::from(*sensor)] {
                advice.take(verdict.sensors[index], verdict.distances_m[index]);
            }
        }
        FrameLabel {
            label: verdict.class,
            cause: verdict.cause,
            distance: verdict.winner.map(|winner| winner.distance),
            cell: verdict.winner.map(|winner| winner.cell as u32),
        }
    }

    /// What is said of a sensor of the stage in this frame.
    pub(super) fn advice(&self, sensor: usize) -> Option<&Advice> {
        self.advice.get(sensor)?.as_ref()
    }
}

/// The raw positions of some sensors of a frame, in device axes, m; NaN where there is none.
pub fn raw_positions(estimate: &Estimate, sensors: &[usize], mut take: impl FnMut([f64; 3])) {
    for sensor in sensors {
        let measured = estimate.sensors.get(*sensor).and_then(|sensor| sensor.measured.as_ref());
        take(measured.and_then(|measured| measured.position_m).unwrap_or([f64::NAN; 3]));
    }
}

/// A position in transmitter axes turned z up, m: as maps of faults see it.
pub fn upright(position_m: [f64; 3], room_transmitter: &Isometry3<f64>) -> [f64; 3] {
    (room_transmitter.rotation * Point3::from(position_m)).coords.into()
}
