//! The field in the live pipeline: correction, watch and guided run on virtual Flocks.

use nalgebra::Vector3;
use posed_field::{Cause, FieldMap, Prepared, Warning, solve};
use posed_pipeline::Pipeline;
use posed_recording::{Header, Writer};
use posed_simulator::motion::{Motion, Orbit, Still};
use posed_simulator::scenario::{
    BodySpec, DeviceScenario, HumSpec, Material, MetalSpec, Scenario, SensorScenario,
};
use posed_stage::input::{Entry, Input, Model, Request};
use posed_stage::output::{Estimate, FieldNews, Outcome, OutcomeKind, Output, SensorState};
use posed_stage::{FieldWatch, Stage};
use serde::Deserialize;

use crate::cli::posed;
use posed_rig::{Rig, Said, field_map, replay, stage};

fn rig(stage: &Stage) -> Rig {
    let devices = vec![DeviceScenario { name: "d0".into(), ..DeviceScenario::default() }];
    Rig::new(stage, &Scenario { devices, ..Scenario::default() })
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
    let mut stage = stage(&[3]);
    // A watch with much to say: this reference sensor does move.
    stage.field = Some(FieldWatch { reference_sensors: vec!["s0-2".into()], ..FieldWatch::default() });
    let mut rig = rig(&stage);
    rig.run_until(4.0);
    let before = rig.estimates().count();
    let map = field_map();
    let corrector = map.corrector();
    rig.push(swap(1, Some(map.clone())));
    rig.run_until(6.5);
    let (good, raw_m) = farthest_m(rig.estimates().take(before).skip(100), |z| *z);
    assert!(good > 100 && raw_m < 0.01, "{good} {raw_m}");
    // A swap moves all poses at once: the filters need a few records to believe it.
    let corrected = || rig.estimates().skip(before + 30);
    let (good, corrected_m) = farthest_m(corrected(), |z| corrector.position(z));
    let moved_m = farthest_m(corrected(), |z| *z).1;
    assert!(good > 400 && corrected_m < 0.01 && moved_m > 0.008, "{good} {corrected_m} {moved_m}");
    let sigma = corrected().flat_map(|e| &e.sensors).find_map(|sensor| sensor.pose).unwrap().sigma_m.unwrap();
    assert!(sigma.is_finite() && sigma > 0.0);
    let swapped = rig.emitted.iter().any(|emitted| {
        matches!(emitted, Said::Outcome(outcome)
            if matches!(outcome.what, OutcomeKind::ModelSwapped(Model::Field { version: 1, .. })))
    });
    assert!(swapped);
    // Going on from a snapshot says the same.
    let half = rig.log.len() / 2 + rig.log.len() / 4;
    let mut pipeline = Pipeline::new(&stage).unwrap();
    replay(&mut pipeline, &rig.log[..half]);
    let mut restored = Pipeline::restore(&stage, pipeline.models(), &pipeline.snapshot()).unwrap();
    assert_eq!(replay(&mut restored, &rig.log[half..]), replay(&mut pipeline, &rig.log[half..]));
    // Taken away, poses are the tracker's own again.
    rig.forget();
    rig.push(swap(0, None));
    rig.run_until(7.5);
    let (good, raw_m) = farthest_m(rig.estimates().skip(30), |z| *z);
    assert!(good > 100 && raw_m < 0.01, "{good} {raw_m}");
}

#[test]
fn given_a_guided_run_the_pole_is_collected_and_handed_out() {
    let stage = stage(&[4]);
    let mut rig = rig(&stage);
    rig.run_until(2.0);
    let sensors = (0..4).map(|bird| format!("s0-{bird}")).collect();
    rig.push(Input::Request(Request::FieldStart { sensors, spacing_m: 0.3 }));
    rig.run_until(6.0);
    let progress: Vec<_> = rig
        .emitted
        .iter()
        .filter_map(|emitted| match emitted {
            Said::Outcome(outcome) => match &outcome.what {
                OutcomeKind::Field(FieldNews::Progress(progress)) => Some(progress.clone()),
                _ => None,
            },
            _ => None,
        })
        .collect();
    // One when it begins, then one a second.
    assert!((4..=5).contains(&progress.len()), "{progress:?}");
    let last = progress.last().unwrap();
    assert!(last.collecting && last.instants > 60 && !last.hint.is_empty(), "{last:?}");
    // A replay that begins in the middle of the run goes on collecting.
    let half = rig.log.len() * 3 / 4;
    let mut pipeline = Pipeline::new(&stage).unwrap();
    replay(&mut pipeline, &rig.log[..half]);
    let mut restored = Pipeline::restore(&stage, pipeline.models(), &pipeline.snapshot()).unwrap();
    assert_eq!(replay(&mut restored, &rig.log[half..]), replay(&mut pipeline, &rig.log[half..]));
    let mut runs = Vec::new();
    let finish = Entry { t: rig.host.now, input: Input::Request(Request::FieldFinish {}) };
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

/// Rms distance from the truth, m: of the records as measured, and of what is published.
fn off_m(rig: &Rig, stage: &Stage, skip: usize) -> [f64; 2] {
    let placed = stage.transmitter.pose_in_room.as_ref().unwrap();
    let room = posed_geometry::isometry(placed.position_m, placed.orientation_wxyz).unwrap();
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for estimate in rig.estimates().skip(skip) {
        let next = rig.host.truth.partition_point(|cycle| cycle.t < estimate.t_valid);
        if next == 0 || next == rig.host.truth.len() {
            continue;
        }
        let [a, b] = [&rig.host.truth[next - 1], &rig.host.truth[next]];
        let share = estimate.t_valid.seconds_since(a.t) / b.t.seconds_since(a.t);
        for (index, sensor) in estimate.sensors.iter().enumerate() {
            let (SensorState::Ok, Some(pose), Some(measured)) =
                (sensor.state, &sensor.pose, &sensor.measured)
            else {
                continue;
            };
            let [p, q] = [a, b].map(|cycle| cycle.sensors[index].pose.translation.vector);
            let truth = p.lerp(&q, share);
            let raw = room.transform_point(&measured.position_m.unwrap().into()).coords;
            squares[0] += (raw - truth).norm_squared();
            squares[1] += (Vector3::from(pose.position_m.unwrap()) - truth).norm_squared();
            count += 1.0;
        }
    }
    assert!(count > 500.0, "{count}");
    squares.map(|square| (square / count).sqrt())
}

/// The commands make the same map of the same log, and correct what was measured as the pipeline does.
fn from_the_recording(rig: &Rig, stage_toml: &str, map: &FieldMap) {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let header = Header::new(&Stage::parse(stage_toml).unwrap(), stage_toml, 0);
    let mut writer = Writer::new(std::fs::File::create(path("take.mcap")).unwrap(), header).unwrap();
    rig.log.iter().for_each(|entry| writer.entry(entry).unwrap());
    writer.finish("the end").unwrap();
    let (take, field, out) = (path("take.mcap"), path("field.json"), path("out.csv"));
    let solved = posed(["field", "solve", &take, "--spacing-m", "0.15", "-o", &field, "--corrected", &out]);
    assert!(solved.status.success(), "{}", String::from_utf8_lossy(&solved.stderr));
    assert_eq!(posed_stage::read_field_map(field.as_ref()).unwrap(), *map);
    let corrector = map.corrector();
    let good = rig.estimates().flat_map(|estimate| &estimate.sensors).filter(|s| s.state == SensorState::Ok);
    let expected: Vec<Vector3<f64>> = good
        .filter_map(|sensor| Some(corrector.position(&Vector3::from(sensor.measured?.position_m?))))
        .collect();
    let csv = std::fs::read_to_string(out).unwrap();
    let corrected: Vec<Vector3<f64>> = csv
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            Vector3::from_fn(|axis, _| cells[2 + axis].parse().unwrap())
        })
        .collect();
    assert_eq!(corrected, expected);
}

#[test]
fn given_the_stage_with_a_pole_its_guided_run_makes_a_map_that_brings_poses_to_the_truth() {
    let stage_toml = include_str!("../../config/field-pole.toml");
    let stage = Stage::parse(stage_toml).unwrap();
    let scenario = Scenario::deserialize(stage.simulation.clone().unwrap()).unwrap();
    let mut rig = Rig::new(&stage, &scenario);
    let sensors = stage.sensors.iter().map(|sensor| sensor.name.clone()).collect();
    rig.push(Input::Request(Request::FieldStart { sensors, spacing_m: 0.15 }));
    rig.run_until(22.0);
    let [before, uncorrected] = off_m(&rig, &stage, 500);
    let last = rig.emitted.iter().rev().find_map(|emitted| match emitted {
        Said::Outcome(Outcome { what: OutcomeKind::Field(FieldNews::Progress(progress)), .. }) => {
            Some(progress)
        }
        _ => None,
    });
    let last = last.unwrap();
    assert!(last.hint.is_empty() && last.covered > 0.7 && last.directions == 1.0, "{last:?}");
    let mut run = None;
    let finish = Entry { t: rig.host.now, input: Input::Request(Request::FieldFinish {}) };
    rig.pipeline.push(&finish, &mut |output| {
        if let Output::PoleRun(collected) = output {
            run = Some(collected.clone());
        }
    });
    let solution = solve(run.unwrap(), &[], &mut |_| {});
    assert!(solution.report.accepted, "{:?}", solution.report);
    let map = solution.map.unwrap();
    from_the_recording(&rig, stage_toml, &map);
    rig.forget();
    rig.push(swap(1, Some(map)));
    rig.run_until(27.0);
    let [after, corrected] = off_m(&rig, &stage, 50);
    assert!(before > 5e-3 && after > 5e-3 && uncorrected > 5e-3);
    assert!(corrected < 0.25 * after, "{after} {corrected}");
}

/// Minutes of motion before steel is brought in: `POSED_WATCH_MINUTES=30` runs the half hour.
fn quiet_minutes() -> u32 {
    std::env::var("POSED_WATCH_MINUTES").ok().and_then(|text| text.parse().ok()).unwrap_or(1)
}

/// What was said of disturbances so far: when, by what, and whether it began. Forgets all else.
fn disturbances(rig: &mut Rig, news: &mut Vec<(f64, Cause, bool)>) {
    news.extend(rig.emitted.iter().filter_map(|emitted| match emitted {
        Said::Outcome(Outcome {
            t_decided,
            what: OutcomeKind::Field(FieldNews::Warning(Warning::Disturbed { cause, active, .. })),
            ..
        }) => Some((t_decided.as_secs_f64(), *cause, *active)),
        _ => None,
    }));
    rig.forget();
}

#[test]
fn given_a_motor_that_is_switched_on_the_reference_sensor_hears_the_mains_within_half_a_second() {
    let mut stage = stage(&[2]);
    stage.field = Some(FieldWatch { reference_sensors: vec!["s0-0".into()], ..FieldWatch::default() });
    let hum = HumSpec {
        frequency_hz: 50.0,
        amplitude_per_m3: [0.0, 0.004, 0.0],
        from_s: Some(25.0),
        until_s: Some(30.0),
    };
    let lamp = BodySpec {
        name: "lamp".into(),
        motion: Motion::Still(Still { position_m: [0.7, 0.1, 0.1], ..Still::default() }),
    };
    let on_the_lamp = SensorScenario {
        name: "s0-0".into(),
        body: "lamp".into(),
        segment: None,
        offset_m: [0.0; 3],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    let scenario = Scenario {
        devices: vec![DeviceScenario { name: "d0".into(), ..DeviceScenario::default() }],
        hum: Some(hum),
        bodies: vec![lamp],
        sensors: vec![on_the_lamp],
        ..Scenario::default()
    };
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(36.0);
    let mut news = Vec::new();
    disturbances(&mut rig, &mut news);
    let of_hum: Vec<_> = news.iter().filter(|(_, cause, _)| *cause == Cause::Hum).collect();
    let [(began_s, _, true), (ended_s, _, false)] = of_hum[..] else { panic!("{news:?}") };
    assert!((25.0..25.5).contains(began_s) && (30.0..32.0).contains(ended_s), "{news:?}");
}

#[test]
fn given_steel_that_is_brought_in_reference_and_pair_tell_of_it_within_half_a_second() {
    let brought_s = 60.0 * f64::from(quiet_minutes());
    let mut stage = stage(&[3]);
    stage.field = Some(FieldWatch {
        reference_sensors: vec!["s0-2".into()],
        rigid_pairs: vec![["s0-0".into(), "s0-1".into()]],
        ..FieldWatch::default()
    });
    let metal = MetalSpec {
        center_m: [0.9, 0.5, 0.0],
        radius_m: 0.12,
        material: Material::Iron,
        from_s: Some(brought_s),
        until_s: Some(brought_s + 5.0),
    };
    let lamp = BodySpec {
        name: "lamp".into(),
        motion: Motion::Still(Still { position_m: [0.7, 0.1, 0.1], ..Still::default() }),
    };
    let racket = BodySpec {
        name: "racket".into(),
        motion: Motion::Orbit(Orbit {
            center_m: [0.6, 0.2, 0.2],
            radius_m: [0.08, 0.1, 0.06],
            ..Orbit::default()
        }),
    };
    let sensor = |name: &str, body: &str, x_m: f64| SensorScenario {
        name: name.into(),
        body: body.into(),
        segment: None,
        offset_m: [x_m, 0.0, 0.0],
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
    };
    let devices = vec![DeviceScenario { name: "d0".into(), ..DeviceScenario::default() }];
    let scenario = Scenario {
        devices,
        metal: vec![metal],
        bodies: vec![lamp, racket],
        sensors: vec![
            sensor("s0-0", "racket", -0.1),
            sensor("s0-1", "racket", 0.1),
            sensor("s0-2", "lamp", 0.0),
        ],
        ..Scenario::default()
    };
    let mut rig = Rig::new(&stage, &scenario);
    let mut news = Vec::new();
    for minute in 1..=quiet_minutes() {
        rig.run_until(60.0 * f64::from(minute) - 4.0);
        disturbances(&mut rig, &mut news);
    }
    rig.run_until(brought_s);
    // What poses are worth before and while the steel is there.
    let sigma_m = |emitted: &[Said]| {
        let poses = emitted.iter().filter_map(|emitted| match emitted {
            Said::Estimate(estimate) => estimate.sensors[0].pose?.sigma_m,
            _ => None,
        });
        poses.fold(0.0, f64::max)
    };
    let before_m = sigma_m(&rig.emitted);
    disturbances(&mut rig, &mut news);
    assert!(news.is_empty(), "no false alarm: {news:?}");
    rig.run_until(brought_s + 4.0);
    let while_m = sigma_m(&rig.emitted);
    disturbances(&mut rig, &mut news);
    rig.run_until(brought_s + 12.0);
    disturbances(&mut rig, &mut news);
    for cause in [Cause::ReferenceSensor, Cause::RigidPair] {
        let began = news.iter().find(|(_, of, active)| *of == cause && *active);
        assert!(began.is_some_and(|(t, ..)| (brought_s..brought_s + 0.5).contains(t)), "{cause:?}: {news:?}");
        // A pair that is carried away from the steel is right again; the reference sensor stays beside it.
        let stays = if cause == Cause::ReferenceSensor { 5.0 } else { 0.0 };
        let ended = brought_s + stays..brought_s + 8.0;
        let last = news.iter().rfind(|(_, of, _)| *of == cause);
        assert!(last.is_some_and(|(t, _, active)| !active && ended.contains(t)), "{cause:?}: {news:?}");
    }
    assert!(while_m > 2.0 * before_m, "{before_m} {while_m}");
}
