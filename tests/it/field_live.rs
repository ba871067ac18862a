//! The field in the live pipeline: correction, watch and guided run on virtual Flocks.

use nalgebra::Vector3;
use posed::field::{FieldMap, FieldNoise, Prepared, fit_known};
use posed::input::{Input, Model, Request};
use posed::output::{Estimate, FieldNews, OutcomeKind, Output, SensorState};
use posed::pipeline::Pipeline;
use posed::stage::Stage;
use posed_simulator::scenario::{DeviceScenario, Scenario};

use crate::rig::{Rig, Said, replay, stage};

fn rig(stage: &Stage) -> Rig {
    let devices = vec![DeviceScenario { name: "d0".into(), ..DeviceScenario::default() }];
    Rig::new(stage, &Scenario { devices, ..Scenario::default() })
}

/// A map of a tracker that says everything three percent too long, for two metres around it.
fn map() -> FieldMap {
    let pairs: Vec<_> = (0..900)
        .map(|k| {
            let place = |n: usize| (k * n % 31) as f64 / 15.0 - 1.0;
            let p = Vector3::new(place(1), place(7), place(12)) * 2.0;
            (p * 1.03, p)
        })
        .filter(|(z, _)| z.norm() > 0.1)
        .collect();
    fit_known(&pairs, FieldNoise { sigma_signal: 1e-5, floor_m: 3e-4 }).unwrap()
}

fn swap(version: u32, map: Option<FieldMap>) -> Input {
    Input::Model(Model::Field { version, map: map.map(Prepared::new) })
}

/// Largest distance of published positions from what `of` makes of the measured ones, among good ones.
fn farthest_m<'a>(
    estimates: impl Iterator<Item = &'a Estimate>,
    of: impl Fn(&Vector3<f64>) -> Vector3<f64>,
) -> (usize, f64) {
    let mut worst = (0, 0.0_f64);
    for sensor in estimates.flat_map(|estimate| &estimate.sensors) {
        let (SensorState::Ok, Some(pose), Some(measured)) = (sensor.state, &sensor.pose, &sensor.measured)
        else {
            continue;
        };
        let z = Vector3::from(measured.position_m.unwrap());
        worst.0 += 1;
        worst.1 = worst.1.max((Vector3::from(pose.position_m.unwrap()) - of(&z)).norm());
    }
    worst
}

#[test]
fn given_a_map_every_pose_is_corrected_from_the_next_frame_on() {
    let stage = stage(&[3]);
    let mut rig = rig(&stage);
    rig.run_until(2.5);
    let before = rig.estimates().count();
    let map = map();
    let corrector = map.corrector();
    rig.push(swap(1, Some(map.clone())));
    rig.run_until(5.0);
    let (good, raw_m) = farthest_m(rig.estimates().take(before).skip(100), |z| *z);
    assert!(good > 100 && raw_m < 0.01, "{good} {raw_m}");
    // A swap moves all poses at once: the filters need a few records to believe it.
    let corrected = || rig.estimates().skip(before + 30);
    let (good, corrected_m) = farthest_m(corrected(), |z| corrector.position(z));
    let moved_m = farthest_m(corrected(), |z| *z).1;
    assert!(good > 400 && corrected_m < 0.01 && moved_m > 0.008, "{good} {corrected_m} {moved_m}");
    let sigma = corrected().flat_map(|e| &e.sensors).find_map(|sensor| sensor.pose).unwrap().sigma_m.unwrap();
    assert!(sigma.is_finite() && sigma > 0.0);
    let swapped = rig.said.iter().any(|said| {
        matches!(said, Said::Outcome(outcome)
            if matches!(outcome.what, OutcomeKind::ModelSwapped(Model::Field { version: 1, .. })))
    });
    assert!(swapped);
    // Going on from a snapshot says the same.
    let half = rig.log.len() / 2 + rig.log.len() / 4;
    let mut pipeline = Pipeline::new(&stage).unwrap();
    replay(&mut pipeline, &rig.log[..half]);
    let mut restored = Pipeline::restore(&stage, &pipeline.snapshot()).unwrap();
    assert_eq!(replay(&mut restored, &rig.log[half..]), replay(&mut pipeline, &rig.log[half..]));
    // Taken away, poses are the tracker's own again.
    rig.forget();
    rig.push(swap(0, None));
    rig.run_until(6.0);
    let (good, raw_m) = farthest_m(rig.estimates().skip(30), |z| *z);
    assert!(good > 100 && raw_m < 0.01, "{good} {raw_m}");
}

#[test]
fn given_a_guided_run_the_pole_is_collected_and_handed_out() {
    let mut rig = rig(&stage(&[4]));
    rig.run_until(2.0);
    let sensors = (0..4).map(|bird| format!("s0-{bird}")).collect();
    rig.push(Input::Request(Request::FieldStart { sensors, spacing_m: 0.3 }));
    rig.run_until(6.0);
    let progress: Vec<_> = rig
        .said
        .iter()
        .filter_map(|said| match said {
            Said::Outcome(outcome) => match &outcome.what {
                OutcomeKind::Field(FieldNews::Progress(progress)) => Some(progress.clone()),
                _ => None,
            },
            _ => None,
        })
        .collect();
    assert!((3..=4).contains(&progress.len()), "{progress:?}");
    let last = progress.last().unwrap();
    assert!(last.instants > 60 && !last.hint.is_empty(), "{last:?}");
    let mut runs = Vec::new();
    let finish = posed::input::Entry { t: rig.now, input: Input::Request(Request::FieldFinish {}) };
    for _ in 0..2 {
        rig.pipeline.push(&finish, &mut |output| {
            if let Output::PoleRun(run) = output {
                runs.push(run.clone());
            }
        });
    }
    assert!(runs[0].frames.len() >= last.instants && runs[0].sensors.len() == 4);
    assert!(runs[1].frames.is_empty(), "what was handed out is gone");
}
