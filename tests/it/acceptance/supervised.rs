//! A pipeline that panics goes on: with all that it knew where leaving an entry out helps, and from the beginning where it does not.

use std::panic::{AssertUnwindSafe, catch_unwind};

use posed_drivers::LineEvent;
use posed_pipeline::SupervisedPipeline;
use posed_rig::{Rig, Said, stage};
use posed_simulator::faults::Fault;
use posed_simulator::scenario::{DeviceScenario, Scenario};
use posed_stage::input::Input;
use posed_stage::output::{Estimate, SensorState};

use super::judge::judge;

/// Noise of the scene's field, per m^3.
const NOISE: f64 = 2e-4;

/// A stage, and the entries at which it panicked.
struct Panicking {
    rig: Rig,
    at: Vec<usize>,
}

impl Panicking {
    fn start() -> Self {
        Self::with(Vec::new())
    }

    /// The same with faults of the first device.
    fn with(faults: Vec<Fault>) -> Self {
        let device =
            |number: usize| DeviceScenario { name: format!("d{number}"), ..DeviceScenario::default() };
        let devices =
            vec![DeviceScenario { faults, ..device(0) }, DeviceScenario { rate_hz: 60.0, ..device(1) }];
        let scenario = Scenario { devices, sigma_signal_per_m3: NOISE, ..Scenario::default() };
        let mut rig = Rig::new(&stage(&[2, 2]), &scenario);
        rig.run_until(4.0);
        Self { rig, at: Vec::new() }
    }

    /// The next entry brings a panic.
    fn panic_next(&mut self) {
        self.rig.pipeline.panic_next();
        self.at.push(self.rig.log.len());
    }

    /// What holds of all of it: right, in order, and the same in a replay.
    fn check(&self, until_s: f64) {
        // Frames have the times of the faster one's cycles.
        let judged = judge(&self.rig, 0, 3.0, until_s, NOISE);
        assert_eq!(judged.wrong(), 0, "{judged:?}");
        let frames: Vec<&Estimate> = self.rig.estimates().collect();
        assert!(frames.windows(2).all(|two| two[0].frame < two[1].frame && two[0].t_valid < two[1].t_valid));
        let mut again = SupervisedPipeline::new(&stage(&[2, 2])).unwrap();
        let mut emitted = Vec::new();
        for (number, entry) in self.rig.log.iter().enumerate() {
            if self.at.contains(&number) {
                again.panic_next();
            }
            again.push(entry, &mut |output| emitted.extend(Said::of_tracking(&output)));
        }
        assert!(emitted == self.rig.emitted, "a replay goes on in another way");
        assert_eq!(again.snapshot(), self.rig.pipeline.snapshot());
    }
}

/// Frames in which all are good.
fn good(rig: &Rig, from_s: f64) -> usize {
    let all_good =
        |estimate: &&Estimate| estimate.sensors.iter().all(|sensor| sensor.state == SensorState::Ok);
    rig.estimates().filter(|estimate| estimate.t_valid.as_secs_f64() > from_s).filter(all_good).count()
}

#[test]
fn an_entry_that_brings_a_panic_is_left_out_and_nothing_else_is_lost() {
    let mut calm = Panicking::start();
    calm.rig.run_until(12.0);
    let mut panicking = Panicking::start();
    for k in 0..32 {
        panicking.rig.run_until(4.1 + 0.2371 * f64::from(k));
        panicking.panic_next();
    }
    panicking.rig.run_until(12.0);
    panicking.check(12.0);
    let status = panicking.rig.pipeline.status();
    assert_eq!((status.entries_left_out, status.begun_anew), (32, 0));
    let (undisturbed, left) = (good(&calm.rig, 4.0), good(&panicking.rig, 4.0));
    println!("{left} good frames of {undisturbed}");
    assert!(left + 3 * 32 > undisturbed, "{left} good frames of {undisturbed}");
}

#[test]
fn a_state_that_brings_panics_is_given_up_and_the_devices_are_set_up_anew() {
    let mut panicking = Panicking::start();
    for _ in 0..2 {
        panicking.panic_next();
        panicking.rig.push(Input::Timer);
    }
    let status = panicking.rig.pipeline.status();
    assert_eq!((status.entries_left_out, status.begun_anew), (2, 1));
    panicking.rig.run_until(7.0);
    assert!(good(&panicking.rig, 4.0) > 50, "all are good again");
    panicking.check(7.0);
}

#[test]
fn a_tracker_that_is_stuck_or_mirrored_is_that_still_after_a_new_beginning() {
    let flipped = Fault::HemisphereFlip { address: 1, at_s: 3.5, duration_s: 4.0 };
    let stuck = Fault::OutOfRange { address: 2, at_s: 3.5, duration_s: 4.0 };
    let mut panicking = Panicking::with(vec![flipped, stuck]);
    for _ in 0..2 {
        panicking.panic_next();
        panicking.rig.push(Input::Timer);
    }
    assert_eq!(panicking.rig.pipeline.begun_anew(), 1);
    panicking.rig.run_until(12.0);
    assert!(good(&panicking.rig, 8.0) > 100, "all are good again");
    panicking.check(12.0);
}

#[test]
fn a_port_that_opens_is_never_left_out() {
    let mut panicking = Panicking::start();
    let closed = LineEvent::Closed { reason: "unplugged".to_owned() };
    panicking.rig.push(Input::Line { device: 0, event: closed });
    panicking.panic_next();
    panicking.rig.push(Input::Line { device: 0, event: LineEvent::Opened { modem_lines: false } });
    assert_eq!(panicking.rig.pipeline.begun_anew(), 1);
    panicking.rig.run_until(8.0);
    assert!(good(&panicking.rig, 4.0) > 50, "all are good again");
    panicking.check(8.0);
}

#[test]
fn what_cannot_even_begin_anew_ends_with_its_panic() {
    let mut panicking = Panicking::start();
    let mut attempts = 0;
    let ended = (0..10).any(|_| {
        attempts += 1;
        panicking.panic_next();
        let Panicking { rig, .. } = &mut panicking;
        catch_unwind(AssertUnwindSafe(|| rig.push(Input::Timer))).is_err()
    });
    assert!(ended && attempts == 5, "{attempts}");
}

#[test]
fn a_panic_of_who_takes_the_outputs_is_not_the_pipelines() {
    let mut panicking = Panicking::start();
    let mut count = 0;
    let log = panicking.rig.log.clone();
    let mut again = SupervisedPipeline::new(&stage(&[2, 2])).unwrap();
    let ended = log.iter().any(|entry| {
        let mut emit = |_: posed_stage::output::Output<'_>| {
            count += 1;
            assert!(count < 100, "whoever takes the outputs");
        };
        catch_unwind(AssertUnwindSafe(|| again.push(entry, &mut emit))).is_err()
    });
    assert!(ended);
    panicking.rig.run_until(4.1);
    assert_eq!(panicking.rig.pipeline.entries_left_out(), 0);
}
