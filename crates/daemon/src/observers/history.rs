//! The last hour of every sensor in steps of ten seconds, so that who looks in late sees what was before.
//!
//! In: the frames, and the counts that `status` is made of. Out: the steps, to who asks from another thread. Never: more than 360 of them, or a
//! wait of the fusion thread for who reads them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use posed_drivers::Timestamp;

use posed_pipeline::PipelineStatus;
use posed_protocol::{HealthHistory, SensorHistory, round};
use posed_recording::Thinned;
use posed_stage::Stage;
use posed_stage::output::{Estimate, SensorEstimate, SensorState};

/// Length of a step, s.
const BIN_S: f64 = 10.0;
/// Steps that are kept: an hour.
const BINS: usize = 360;
/// Distances that the noise of a step is the median of, at most.
const DISTANCES: usize = 256;
/// Median of the length of a vector whose three coordinates are normal with variance one (the root of the median of chi-square with three degrees of freedom).
const MEDIAN_LENGTH: f64 = 1.538_172_2;
/// Variance of a position's distance from the middle of its neighbours, that of each being one.
const VARIANCE: f64 = 1.5;

/// Gathers it; belongs to the fusion thread.
pub(super) struct History {
    /// Number of the step that goes on, since the stage's epoch; absent before the first count.
    current: Option<i64>,
    /// When it was counted first in this step.
    since: Timestamp,
    sensors: Vec<Gathered>,
    kept: Kept,
}

/// What is gathered of a sensor in a step.
struct Gathered {
    /// Index of its device.
    device: Option<usize>,
    /// Counts at the beginning of the step.
    samples: u64,
    lost: u64,
    frames: u32,
    faulty: u32,
    /// The last two measured positions, the newest last.
    before_m: [Option<[f64; 3]>; 2],
    distances_m: Thinned<f64>,
}

/// A step of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Bin {
    rate_hz: Option<f64>,
    lost: Option<f64>,
    faulty: Option<f64>,
    noise_m: Option<f64>,
    clock_sigma_s: Option<f64>,
    battery: Option<f64>,
    signal_dbm: Option<f64>,
}

/// The steps so far; clones are the same.
#[derive(Clone)]
pub(crate) struct Kept {
    names: Arc<[String]>,
    bins: Arc<Mutex<Bins>>,
}

#[derive(Default)]
struct Bins {
    newest_t_s: Option<f64>,
    bins: VecDeque<Arc<[Bin]>>,
}

impl Kept {
    fn lock(&self) -> MutexGuard<'_, Bins> {
        // Every change is complete before anything in it could panic.
        self.bins.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The last hour.
    pub(crate) fn history(&self) -> HealthHistory {
        let (newest_t_s, bins): (_, Vec<Arc<[Bin]>>) = {
            let kept = self.lock();
            (kept.newest_t_s, kept.bins.iter().cloned().collect())
        };
        let sensor = |(index, name): (usize, &String)| {
            let each = |steps: f64, of: fn(&Bin) -> Option<f64>| {
                let value =
                    |bin: &Arc<[Bin]>| bin.get(index).and_then(of).map(|value| round::to(steps, value));
                bins.iter().map(value).collect::<Vec<_>>()
            };
            SensorHistory {
                name: name.clone(),
                rate_hz: each(1e2, |bin| bin.rate_hz),
                lost: each(1e4, |bin| bin.lost),
                faulty: each(1e4, |bin| bin.faulty),
                noise_m: each(1e6, |bin| bin.noise_m),
                clock_sigma_s: each(1e7, |bin| bin.clock_sigma_s),
                battery: each(1e3, |bin| bin.battery),
                signal_dbm: each(1.0, |bin| bin.signal_dbm),
            }
        };
        let sensors = self.names.iter().enumerate().map(sensor).collect();
        HealthHistory { bin_s: BIN_S, newest_t_s, sensors }
    }
}

impl History {
    pub(super) fn new(stage: &Stage) -> Self {
        let sensor = |sensor: &posed_stage::Sensor| Gathered {
            device: stage.devices.iter().position(|device| device.name == sensor.device),
            samples: 0,
            lost: 0,
            frames: 0,
            faulty: 0,
            before_m: [None; 2],
            distances_m: Thinned::new(DISTANCES),
        };
        let names = stage.sensors.iter().map(|sensor| sensor.name.clone()).collect();
        Self {
            current: None,
            since: Timestamp::ZERO,
            sensors: stage.sensors.iter().map(sensor).collect(),
            kept: Kept { names, bins: Arc::default() },
        }
    }

    /// Where it is read.
    pub(super) fn kept(&self) -> Kept {
        self.kept.clone()
    }

    pub(super) fn estimate(&mut self, estimate: &Estimate) {
        for (gathered, sensor) in self.sensors.iter_mut().zip(&estimate.sensors) {
            gathered.frame(sensor);
        }
    }

    /// Takes the counts as they stand now; once a second or oftener.
    pub(super) fn count(&mut self, now: Timestamp, pipeline: &PipelineStatus) {
        let number = (now.as_secs_f64() / BIN_S).floor() as i64;
        let Some(current) = self.current.replace(number) else {
            self.since = now;
            return self.begin(pipeline);
        };
        if number <= current {
            self.current = Some(current);
            return;
        }
        let seconds = now.seconds_since(self.since);
        let bin = self.sensors.iter_mut().enumerate().map(|(index, gathered)| {
            let clock = gathered.device.and_then(|device| pipeline.devices.get(device)?.clock);
            let counted = pipeline.sensors.get(index);
            let (samples, lost) = counted.map_or((0, 0), |counted| (counted.samples, counted.lost));
            let condition = counted.map(|counted| counted.condition).unwrap_or_default();
            Bin {
                clock_sigma_s: clock.map(|clock| clock.sigma_t_s),
                battery: condition.battery,
                signal_dbm: condition.signal_dbm,
                ..gathered.bin(seconds, samples, lost)
            }
        });
        let bin: Arc<[Bin]> = bin.collect();
        let mut kept = self.kept.lock();
        kept.bins.push_back(bin);
        // Nothing is known of steps in which nobody counted.
        let missed = usize::try_from(number - current - 1).unwrap_or(BINS).min(BINS);
        kept.bins.extend(std::iter::repeat_n(Arc::<[Bin]>::from([]), missed));
        let surplus = kept.bins.len().saturating_sub(BINS);
        kept.bins.drain(..surplus);
        kept.newest_t_s = Some(number as f64 * BIN_S);
        drop(kept);
        self.since = now;
        self.begin(pipeline);
    }

    /// Begins a step.
    fn begin(&mut self, pipeline: &PipelineStatus) {
        for (gathered, counted) in self.sensors.iter_mut().zip(&pipeline.sensors) {
            (gathered.samples, gathered.lost) = (counted.samples, counted.lost);
            (gathered.frames, gathered.faulty) = (0, 0);
            gathered.distances_m.clear();
        }
    }
}

impl Gathered {
    fn frame(&mut self, sensor: &SensorEstimate) {
        self.frames += 1;
        let is_faulty =
            matches!(sensor.state, SensorState::Suspect | SensorState::Stuck | SensorState::Repaired);
        self.faulty += u32::from(is_faulty);
        let measured = sensor.measured.filter(|_| !is_faulty).and_then(|measured| measured.position_m);
        if let ([Some(first), Some(middle)], Some(last)) = (self.before_m, measured) {
            let off = std::array::from_fn::<_, 3, _>(|axis| middle[axis] - 0.5 * (first[axis] + last[axis]));
            self.distances_m.push(|| off.iter().map(|value| value * value).sum::<f64>().sqrt());
        }
        self.before_m = [self.before_m[1], measured];
    }

    /// What is known at the end of a step of so many seconds, with the counts as they stand then.
    fn bin(&self, seconds: f64, samples: u64, lost: u64) -> Bin {
        let share = |part: f64, of: f64| (of > 0.0).then(|| part / of);
        let (came, lost) =
            (samples.saturating_sub(self.samples) as f64, lost.saturating_sub(self.lost) as f64);
        let mut distances_m = self.distances_m.kept().to_vec();
        let middle = distances_m.len() / 2;
        let median_m =
            (!distances_m.is_empty()).then(|| *distances_m.select_nth_unstable_by(middle, f64::total_cmp).1);
        Bin {
            rate_hz: share(came, seconds),
            lost: share(lost, came + lost),
            faulty: share(f64::from(self.faulty), f64::from(self.frames)),
            noise_m: median_m.map(|median_m| median_m / (MEDIAN_LENGTH * VARIANCE.sqrt())),
            ..Bin::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_pipeline::{Pipeline, SensorStatus};
    use posed_stage::output::Measured;

    const STAGE: &str = "name = \"s\"\n[[device]]\nname = \"d\"\ndriver = \"flock-of-birds\"\nport = \"/dev/d\"\n\
        [[sensor]]\nname = \"a\"\ndevice = \"d\"\naddress = 1\n";

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    fn frame(state: SensorState, x_m: f64) -> Estimate {
        let measured = Measured {
            t_valid: Timestamp::ZERO,
            position_m: Some([x_m, 0.0, 0.0]),
            clipped: false,
            orientation_wxyz: None,
            button: None,
            inertial: None,
        };
        let measured = Some(measured);
        Estimate {
            sensors: vec![SensorEstimate { state, measured, ..Default::default() }],
            ..Default::default()
        }
    }

    #[test]
    fn steps_have_rates_and_shares_and_there_are_never_more_than_an_hour_of_them() {
        let stage = Stage::parse(STAGE).unwrap();
        let mut status = Pipeline::new(&stage).unwrap().status();
        let mut history = History::new(&stage);
        let kept = history.kept();
        assert_eq!(kept.history().newest_t_s, None);
        let mut counted = SensorStatus::default();
        for second in 0..=5000 {
            // A tenth of what is expected is lost, a quarter of the frames is faulty.
            for n in 0..100 {
                let state = if n % 4 == 0 { SensorState::Stuck } else { SensorState::Ok };
                history.estimate(&frame(state, 0.0));
            }
            (counted.samples, counted.lost) = (90 * second, 10 * second);
            counted.condition.battery = Some(0.8);
            status.sensors = vec![counted];
            history.count(at(second as f64), &status);
        }
        let hour = kept.history();
        assert_eq!((hour.bin_s, hour.newest_t_s), (10.0, Some(5000.0)));
        let SensorHistory { name, rate_hz, lost, faulty, noise_m, clock_sigma_s, battery, signal_dbm } =
            &hour.sensors[0];
        assert_eq!((name.as_str(), rate_hz.len(), battery.len()), ("a", BINS, BINS));
        assert!(battery.iter().all(|charge| *charge == Some(0.8)) && signal_dbm.iter().all(Option::is_none));
        assert!(rate_hz.iter().all(|rate| *rate == Some(90.0)), "{rate_hz:?}");
        assert!(
            lost.iter().all(|lost| *lost == Some(0.1)) && faulty.iter().all(|share| *share == Some(0.25))
        );
        assert!(noise_m.iter().all(|noise| *noise == Some(0.0)), "{noise_m:?}");
        assert!(clock_sigma_s.iter().all(Option::is_none));

        // Nobody counts for a minute, and a clock that goes back changes nothing.
        history.count(at(4000.0), &status);
        history.count(at(5061.0), &status);
        let later = kept.history();
        assert_eq!((later.newest_t_s, later.sensors[0].rate_hz.len()), (Some(5060.0), BINS));
        assert_eq!(later.sensors[0].rate_hz[BINS - 5..], [None; 5]);
    }

    #[test]
    fn noise_is_that_of_a_coordinate_and_a_steady_motion_adds_nothing() {
        let mut gathered = History::new(&Stage::parse(STAGE).unwrap()).sensors.remove(0);
        // Uniform noise of all three coordinates, on a straight way.
        let mut state = 7_u64;
        let mut uniform = || {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        for n in 0..1000 {
            let mut estimate = frame(SensorState::Ok, 0.0);
            let measured = estimate.sensors[0].measured.as_mut().unwrap();
            measured.position_m = Some(std::array::from_fn(|_| 0.01 * f64::from(n) + 1e-3 * uniform()));
            gathered.frame(&estimate.sensors[0]);
        }
        let noise_m = gathered.bin(10.0, 1000, 0).noise_m.unwrap();
        let expected_m = 1e-3 / 12.0_f64.sqrt();
        assert!((noise_m / expected_m - 1.0).abs() < 0.15, "{noise_m} m, put in {expected_m} m");
    }
}
