//! Sensors that become faulty, as the pipeline sees them: each is named within a second, and the rest of the body moves on.

use nalgebra::Vector3;
use posed_drivers::Timestamp;
use posed_simulator::body::{Activity, Build, Script, SensorErrors, Wearer, WearerSpec};

use super::*;
use crate::frame::{FrameSample, FrameSensor};
use posed_fusion::body::{ANGLE_NAMES, angles};
use posed_fusion::faults::Cause;
use posed_geometry::GRAVITY_M_S2;
use posed_stage::output::{Inertial, Measured};

/// Ten IMUs of a chain, worn by somebody who reaches.
struct Rig {
    wearer: Wearer,
    stage: BodyStage,
    estimate: Estimate,
    number: u64,
}

type Records = [Option<Inertial>; SEGMENTS];

impl Rig {
    fn new() -> Self {
        let script = Script { activity: Activity::Reaching, calibration: false, facing: 0.6, mistake: None };
        let wearer = Wearer::new(WearerSpec {
            script,
            build: Build::of_height(1.8),
            errors: SensorErrors::calibrated(),
            magnetometer: true,
            disturbances: Vec::new(),
            rate_hz: 100.0,
            clumsiness_rad: 0.0,
            seed: 11,
        });
        let mut text = "name = \"worn\"\n[body]\nheight_m = 1.8\nmounting = \"given\"\n[[device]]\nname = \"x\"\ndriver = \"xbus\"\nport = \"/dev/none\"\n".to_owned();
        for segment in BodySegment::ALL {
            let (q, offset_m) = wearer.mounting(segment.index());
            text += &format!(
                "[[sensor]]\nname = \"{}\"\ndevice = \"x\"\naddress = {}\nmount_quat_wxyz = {:?}\noffset_m = {:?}\n",
                segment.name(),
                segment.index() + 1,
                orientation_to_wxyz(&q),
                <[f64; 3]>::from(offset_m)
            );
        }
        let stage = Stage::parse(&text).unwrap_or_else(|problems| panic!("{problems}"));
        let stage = BodyStage::new(&stage, 0).unwrap().unwrap();
        let mut rig = Self { wearer, stage, estimate: Estimate::default(), number: 0 };
        for _ in 0..800 {
            rig.step(|_| {});
        }
        assert_eq!(rig.stage.faults().count(), 0);
        rig
    }

    /// One frame, with records spoiled; the true segments.
    fn step(&mut self, spoil: impl Fn(&mut Records)) -> [Option<UnitQuaternion<f64>>; SEGMENTS] {
        let (samples, truth) = self.wearer.step();
        let mut records: Records = samples.map(|sample| {
            Some(Inertial {
                angular_velocity_rad_s: Some(sample.gyro_rad_s.into()),
                specific_force_m_s2: Some(sample.accel_m_s2.into()),
                magnetic_field: sample.mag_ut.map(Into::into),
                ..Inertial::default()
            })
        });
        spoil(&mut records);
        self.number += 1;
        let t_valid = Timestamp::from_nanos(self.number as i64 * 10_000_000);
        let sensor = |inertial: Option<Inertial>| {
            let measured = inertial.map(|_| Measured {
                t_valid,
                position_m: None,
                clipped: false,
                orientation_wxyz: None,
                button: None,
                inertial,
            });
            let samples =
                measured.map(|measured| FrameSample { measured, late: false }).into_iter().collect();
            FrameSensor { samples, missed: u32::from(inertial.is_none()) }
        };
        let frame =
            Frame { number: self.number, t_valid, sensors: records.map(sensor).to_vec(), ..Frame::default() };
        self.stage.frame(&frame, &self.estimate);
        truth.body.map(|placement| Some(UnitQuaternion::from_matrix(&placement.axes)))
    }
}

#[test]
fn an_ill_sensor_is_named_within_a_second_and_the_rest_of_the_body_moves_on() {
    let set_specific_force = |record: &mut Option<Inertial>, specific_force_m_s2: [f64; 3]| {
        if let Some(record) = record {
            record.specific_force_m_s2 = Some(specific_force_m_s2);
        }
    };
    type Spoil<'a> = &'a dyn Fn(&mut Records, usize);
    let same = Inertial {
        angular_velocity_rad_s: Some([1.0, 0.0, 0.0]),
        specific_force_m_s2: Some([0.0, 0.0, GRAVITY_M_S2]),
        ..Inertial::default()
    };
    let cases: [(BodySegment, Spoil<'_>, Cause); 6] = [
        (BodySegment::ForearmR, &|all, i| all[i] = None, Cause::Missing),
        (BodySegment::ThighL, &|all, i| set_specific_force(&mut all[i], [f64::NAN; 3]), Cause::NotFinite),
        (BodySegment::Torso, &|all, i| all[i] = Some(same), Cause::Stuck),
        (BodySegment::ShankR, &|all, i| set_specific_force(&mut all[i], [156.9, 0.0, 3.0]), Cause::Saturated),
        (BodySegment::ForearmL, &|all, i| all.swap(i, BodySegment::UpperArmL.index()), Cause::Misfit),
        // Its strap has slipped: see below.
        (BodySegment::UpperArmR, &|_, _| {}, Cause::Misfit),
    ];
    let healthy = Rig::new();
    for (segment, spoil, expected) in cases {
        let mut rig = Rig {
            wearer: healthy.wearer.clone(),
            stage: healthy.stage.clone(),
            estimate: Estimate::default(),
            ..healthy
        };
        if segment == BodySegment::UpperArmR {
            rig.wearer.slip(segment.index(), Vector3::new(0.9, 0.0, 0.0));
        }
        let mut truth = [None; SEGMENTS];
        for _ in 0..100 {
            truth = rig.step(|records| spoil(records, segment.index()));
        }
        let named: Vec<_> = rig.stage.faults().collect();
        let same_arm =
            |name: &str| name.ends_with(&segment.name()[segment.name().len() - 2..]) && name.contains("arm");
        let right = |(_, name, fault): &(SensorIndex, &str, Cause)| {
            *fault == expected && (*name == segment.name() || (expected == Cause::Misfit && same_arm(name)))
        };
        assert!(named.iter().any(right), "{segment:?}: {named:?}");
        let name = if segment.side() < 0.0 { "knee_r_flexion" } else { "knee_l_flexion" };
        let knee = ANGLE_NAMES.iter().position(|known| *known == name).unwrap();
        let off = rig.stage.latest().unwrap().angles_rad[knee].unwrap() - angles(&truth)[knee].unwrap();
        assert!(off.to_degrees().abs() < 3.0, "{segment:?}: {name} is wrong by {} degrees", off.to_degrees());
    }
}

#[test]
fn sensors_that_were_found_on_other_segments_count_there_from_then_on() {
    let mut rig = Rig::new();
    // The units of the left forearm and upper arm were strapped on the wrong way round.
    let (upper, fore) = (BodySegment::UpperArmL, BodySegment::ForearmL);
    let swap = |records: &mut Records| records.swap(upper.index(), fore.index());
    for _ in 0..100 {
        rig.step(swap);
    }
    assert!(rig.stage.faults().any(|(_, _, fault)| fault == Cause::Misfit));
    let names = BodySegment::ALL.map(BodySegment::name);
    let index = |name: &str| names.iter().position(|known| *known == name).map(|at| at as SensorIndex);
    let found = |swapped: [BodySegment; 2]| -> Vec<MountedSensor> {
        let found = |segment: BodySegment| {
            let other = swapped.iter().position(|known| *known == segment).map(|at| swapped[1 - at]);
            let (q, offset_m) = rig.wearer.mounting(segment.index());
            MountedSensor {
                sensor: other.unwrap_or(segment).name().into(),
                segment: Some(segment.name().into()),
                mount_quat_wxyz: orientation_to_wxyz(&q),
                offset_m: offset_m.into(),
                sigma_deg: None,
            }
        };
        BodySegment::ALL.into_iter().map(found).collect()
    };
    let right = found([upper, fore]);
    // Nobody may be left out, sit in two places or on top of another.
    let mut twice = right.clone();
    twice[fore.index()].segment = Some("torso".into());
    let mut nowhere = right.clone();
    nowhere[fore.index()].sensor = "torso".into();
    for wrong in [&right[1..], &twice, &nowhere] {
        assert!(!rig.stage.mount(wrong, index));
    }
    assert!(rig.stage.mount(&right, index));
    let mut truth = [None; SEGMENTS];
    for _ in 0..800 {
        truth = rig.step(swap);
    }
    assert_eq!(rig.stage.faults().collect::<Vec<_>>(), []);
    let body = rig.stage.latest().unwrap();
    assert_eq!(body.segments[fore.index()].sensor, index("upper_arm_l"));
    let elbow = ANGLE_NAMES.iter().position(|known| *known == "elbow_l_flexion").unwrap();
    let off = body.angles_rad[elbow].unwrap() - angles(&truth)[elbow].unwrap();
    assert!(off.to_degrees().abs() < 2.0, "{} degrees", off.to_degrees());
}
