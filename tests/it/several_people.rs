//! Several people on one stage, each with IMUs of their own: nobody's sensors, joints, counts or headings are somebody else's.

use std::collections::BTreeMap;

use nalgebra::{UnitQuaternion, Vector3};
use posed_fusion::body::{ANGLE_NAMES, BodySegment};
use posed_geometry::orientation_from_wxyz;
use posed_motion::exercise::{Exercise, Options, Stream, teach};
use posed_pipeline::Pipeline;
use posed_simulator::body::Activity;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input, Model, Plan, Request};
use posed_stage::output::Body;
use posed_stage::signals;

use crate::exercise::{counts, said_in};
use posed_rig::{Member, Rig, Said, people, replay};

const ANNA_AND_BERT: &[Member] = &[("anna", 1.6, Activity::Squats), ("bert", 1.9, Activity::Curls)];

fn of(rig: &Rig, index: u8) -> impl Iterator<Item = &Body> {
    rig.emitted.iter().filter_map(move |said| match said {
        Said::Body(body) if body.index == index => Some(&**body),
        _ => None,
    })
}

fn most_deg(rig: &Rig, index: u8, angle: &str) -> f64 {
    let at = ANGLE_NAMES.iter().position(|name| *name == angle).unwrap();
    of(rig, index).filter_map(|body| body.angles_rad[at]).fold(0.0, f64::max).to_degrees()
}

fn ahead_deg(rig: &Rig, index: u8) -> f64 {
    let pelvis = of(rig, index).last().unwrap().segments[BodySegment::Pelvis.index()];
    let q: UnitQuaternion<f64> = orientation_from_wxyz(pelvis.orientation_wxyz.unwrap()).unwrap();
    let forward = q * Vector3::x();
    libm::atan2(forward.y, forward.x).to_degrees()
}

#[test]
fn each_of_two_people_is_followed_by_their_own_sensors() {
    let (stage, scenario) = people(ANNA_AND_BERT);
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(6.0);
    // She squats and he curls; neither does what the other does.
    assert!(most_deg(&rig, 0, "knee_r_flexion") > 60.0, "{}", most_deg(&rig, 0, "knee_r_flexion"));
    assert!(most_deg(&rig, 1, "knee_r_flexion") < 15.0, "{}", most_deg(&rig, 1, "knee_r_flexion"));
    assert!(most_deg(&rig, 1, "elbow_r_flexion") > 60.0, "{}", most_deg(&rig, 1, "elbow_r_flexion"));
    // Each with their own lengths: a head of an upright person is where it is of their height.
    for (index, height_m) in [(0, 1.6), (1, 1.9)] {
        let standing = of(&rig, index).next().unwrap().segments[BodySegment::Head.index()];
        let neck_m = standing.position_m.unwrap()[2];
        assert!((neck_m - 0.818 * height_m).abs() < 0.03, "{neck_m} of {height_m}");
    }
    // Nobody stands in somebody else: side by side, where the stage file does not say.
    let [anna_m, bert_m] = [0, 1].map(|index| {
        of(&rig, index).last().unwrap().segments[BodySegment::Pelvis.index()].position_m.unwrap()
    });
    let apart_m = [0, 1].map(|axis| bert_m[axis] - anna_m[axis]);
    assert!(apart_m[0].abs() < 0.4 && (apart_m[1] - 1.0).abs() < 0.2, "{anna_m:?} {bert_m:?}");
    let sensors =
        |index| of(&rig, index).last().unwrap().segments.iter().filter_map(|segment| segment.sensor);
    assert!(sensors(0).all(|sensor| sensor < 15) && sensors(1).all(|sensor| sensor >= 15));
    // And a snapshot goes on as if nothing had been.
    let middle = rig.log.len() / 2;
    let mut pipeline = Pipeline::new(&stage).unwrap();
    let before = replay(&mut pipeline, &rig.log[..middle]).len();
    let mut restored = Pipeline::restore(&stage, pipeline.models(), &pipeline.snapshot()).unwrap();
    assert_eq!(replay(&mut restored, &rig.log[middle..]), rig.emitted[before..]);
}

/// One of them says which way is ahead; the other one keeps the heading, and who is meant must be said.
#[test]
fn a_heading_is_reset_for_one_of_them() {
    let (stage, scenario) = people(ANNA_AND_BERT);
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(1.0);
    let reset = |body: Option<&str>, sensor: Option<&str>| Request::HeadingReset {
        body: body.map(str::to_owned),
        sensor: sensor.map(str::to_owned),
        heading_rad: 0.5,
    };
    let refused = |rig: &Rig, request| rig.pipeline.check_request(&request).unwrap_err().to_string();
    assert!(refused(&rig, reset(None, None)).contains("say whom it is about"));
    assert!(refused(&rig, reset(Some("carl"), None)).contains("no body \"carl\""));
    assert!(refused(&rig, reset(Some("anna"), Some("bert-head"))).contains("no IMU"));
    rig.pipeline.check_request(&reset(None, Some("bert-head"))).unwrap();
    let before = ahead_deg(&rig, 0);
    rig.push(Input::Request(reset(Some("bert"), None)));
    rig.run_until(1.5);
    assert!((ahead_deg(&rig, 1) - 0.5_f64.to_degrees()).abs() < 3.0, "{}", ahead_deg(&rig, 1));
    assert!((ahead_deg(&rig, 0) - before).abs() < 3.0, "{} {before}", ahead_deg(&rig, 0));
    assert_eq!(rig.pipeline.status().requests_refused, 0);
}

/// Taught from one person's joints.
fn taught(rig: &Rig, stage: &Stage, body: &str) -> Exercise {
    let prefix = format!("{body}.");
    let own: Vec<String> =
        signals::columns_of(stage).into_iter().filter(|column| column.starts_with(&prefix)).collect();
    let (t_s, values) = said_in(rig, stage, &own, 0.0..f64::MAX);
    let columns: Vec<String> = own.iter().map(|column| column[prefix.len()..].to_owned()).collect();
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let lesson = |repetitions| {
        let options = Options { name: "squat".into(), repetitions, ..Options::default() };
        teach(&stream, &options).ok().map(|lesson| lesson.exercise)
    };
    (3..=8).find_map(lesson).expect("squats are an exercise")
}

#[test]
fn an_exercise_of_one_person_is_counted_for_everybody() {
    let (stage, scenario) = people(&[
        ("anna", 1.6, Activity::Squats),
        ("bert", 1.7, Activity::Curls),
        ("clara", 1.9, Activity::Squats),
    ]);
    let mut rig = Rig::new(&stage, &scenario);
    rig.run_until(14.0);
    let squat = taught(&rig, &stage, "anna");
    assert!(squat.channels.iter().all(|channel| !channel.contains('.')), "{:?}", squat.channels);
    rig.push(Input::Model(Model::Exercise { exercise: Box::new(squat) }));

    // Whoever is called otherwise says which body is theirs.
    let select = |subject: &str, body: Option<&str>| Request::ExerciseSelect {
        subject: subject.into(),
        exercises: vec!["squat".into()],
        plan: Plan::default(),
        sensors: BTreeMap::new(),
        body: body.map(str::to_owned),
    };
    let refused = rig.pipeline.check_request(&select("patient 7", Some("frank"))).unwrap_err().to_string();
    assert!(refused.contains("no body \"frank\""), "{refused}");
    rig.push(Input::Request(select("patient 7", Some("clara"))));
    rig.push(Input::Request(select("patient 8", Some("bert"))));
    assert_eq!(rig.pipeline.status().requests_refused, 0);
    rig.run_until(26.0);
    let counted = |of: &str| counts(&rig.emitted, of).len();
    let repetitions = ["anna", "clara", "patient 7"].map(counted);
    assert!(repetitions.iter().all(|count| *count >= 2), "{repetitions:?}");
    assert_eq!(["bert", "patient 8", "default"].map(counted), [0; 3]);
}

/// A calibration is of one of them.
#[test]
fn a_mounting_names_the_body_that_it_is_of() {
    let (stage, _) = people(ANNA_AND_BERT);
    let mut pipeline = Pipeline::new(&stage).unwrap();
    let mounted = |name: &str| posed_stage::input::MountedSensor {
        sensor: name.into(),
        segment: None,
        mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
        offset_m: [0.0; 3],
        sigma_deg: None,
    };
    let worn = &BodySegment::ALL[..BodySegment::BEFORE_SHOULDERS];
    let sensors = |who: &str| -> Vec<_> {
        worn.iter().map(|segment| mounted(&format!("{who}-{}", segment.name()))).collect()
    };
    let mut push = |body: Option<&str>, who: &str| {
        let model = Model::Mounting { body: body.map(str::to_owned), sensors: sensors(who) };
        let before = pipeline.status().models_refused;
        let t = posed_drivers::Timestamp::ZERO;
        pipeline.push(&Entry { t, input: Input::Model(model) }, &mut |_| {});
        pipeline.status().models_refused == before
    };
    assert!(push(Some("anna"), "anna") && push(Some("bert"), "bert"));
    // Nobody can be meant who is not named, and nobody wears what somebody else does.
    assert!(!push(None, "anna") && !push(Some("anna"), "bert") && !push(Some("carl"), "anna"));
    assert_eq!(pipeline.models().iter().count(), 2);
}

#[test]
fn one_of_several_people_is_looked_at_alone() {
    let (stage, _) = people(ANNA_AND_BERT);
    let alone = stage.clone().of_body(Some("bert")).unwrap();
    assert_eq!(signals::columns_of_wearer(&alone, 0).len(), signals::columns_of_wearer(&stage, 1).len());
    assert!(signals::columns_of(&alone).contains(&"elbow_r_flexion_deg".to_owned()));
    let wears = alone.sensors.iter().filter(|sensor| alone.wearer_of(sensor).is_some());
    assert!(wears.clone().count() == 15 && wears.into_iter().all(|sensor| sensor.name.starts_with("bert")));
    assert!(stage.clone().of_body(None).unwrap_err().contains("name one of `anna`, `bert`"));
    assert!(stage.of_body(Some("carl")).unwrap_err().contains("it has `anna`, `bert`"));
}
