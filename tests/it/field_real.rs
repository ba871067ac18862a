//! Maps of a real tracker's recordings, judged on eight machined landmarks that the same tracker has touched.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use posed_field::{Corrector, PoleReading, PoleRun, rigid, solve};
use posed_geometry::orientation_from_wxyz;
use posed_recording::table::TableReader;

/// Tip of the stylus in its own frame, m.
const TIP_M: [f64; 3] = [0.108_565, 0.007_773_85, 0.002_538_9];
/// Landmarks in the phantom's frame, mm, and the rows in which the tip stood on each.
const LANDMARKS: [([f64; 3], [usize; 2]); 8] = [
    ([104.3, 5.0, 20.0], [77, 160]),
    ([104.3, 45.0, 20.0], [173, 252]),
    ([104.3, 45.0, 0.0], [277, 351]),
    ([104.3, -5.0, 0.0], [364, 455]),
    ([-34.3, 45.0, 15.0], [531, 611]),
    ([-34.3, -5.0, 20.0], [624, 713]),
    ([-34.3, -5.0, 0.0], [728, 818]),
    ([-34.3, 45.0, 0.0], [833, 928]),
];

fn path(name: &str) -> PathBuf {
    posed_rig::recording("magnetic-plus", &format!("{name}.csv.gz"))
}

/// Time and readings of the named sensors, one row per frame; `None` for a sensor that was not tracked.
fn rows(path: &Path, names: &[&str]) -> Vec<(f64, Vec<Option<PoleReading>>)> {
    let mut table = TableReader::open(path).unwrap();
    let [t] = table.require(["t"]).unwrap();
    let columns: Vec<([usize; 3], [usize; 4])> = names
        .iter()
        .map(|name| {
            let [x, y, z] = ["x", "y", "z"].map(|axis| format!("{name}_{axis}"));
            let [w, i, j, k] = ["qw", "qx", "qy", "qz"].map(|part| format!("{name}_{part}"));
            let position = table.require([x.as_str(), y.as_str(), z.as_str()]).unwrap();
            (position, table.require([w.as_str(), i.as_str(), j.as_str(), k.as_str()]).unwrap())
        })
        .collect();
    let mut rows = Vec::new();
    while table.next_row().unwrap() {
        let t_s = table.required_number(t).unwrap();
        let reading = |(position, orientation): &([usize; 3], [usize; 4])| {
            let mm = table.vector(*position).unwrap()?;
            let wxyz = orientation.map(|column| table.required_number(column).unwrap());
            Some(PoleReading {
                position_m: Vector3::from(mm) / 1e3,
                orientation: orientation_from_wxyz(wxyz),
            })
        };
        rows.push((t_s, columns.iter().map(reading).collect()));
    }
    rows
}

/// Rms distance of the touched landmarks from the machined ones after a rigid fit, m.
fn landmarks_m(
    rows: &[(f64, Vec<Option<PoleReading>>)],
    correct: impl Fn(&PoleReading) -> (Vector3<f64>, UnitQuaternion<f64>),
) -> f64 {
    let pose = |reading: &PoleReading| {
        let (p, q) = correct(reading);
        Isometry3::from_parts(Translation3::from(p), q)
    };
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = LANDMARKS
        .iter()
        .map(|(position_mm, [first, last])| {
            let tips: Vec<Vector3<f64>> = rows[*first..=*last]
                .iter()
                .filter_map(|(_, readings)| {
                    let [reference, stylus] = [readings[0].as_ref()?, readings[1].as_ref()?].map(pose);
                    Some((reference.inverse() * stylus * nalgebra::Point3::from(TIP_M)).coords)
                })
                .collect();
            let median = Vector3::from_fn(|axis, _| {
                let mut values: Vec<f64> = tips.iter().map(|tip| tip[axis]).collect();
                values.sort_by(f64::total_cmp);
                values[values.len() / 2]
            });
            (median, Vector3::from(*position_mm) / 1e3)
        })
        .collect();
    let motion = rigid(&pairs);
    let off = |(a, b): &(Vector3<f64>, Vector3<f64>)| {
        (motion.rotation * a + motion.translation.vector - b).norm_squared()
    };
    (pairs.iter().map(off).sum::<f64>() / pairs.len() as f64).sqrt()
}

#[test]
fn given_maps_of_a_real_tracker_none_is_accepted_that_makes_its_landmarks_worse() {
    let names = ["probe", "reference", "stylus"];
    let [water, wires] =
        ["WaterTankBottomTranslationTrackerBuffer", "fCal_Test_Calibration_3NWires"].map(path);
    let touched = rows(&path("EightLandmarkPointsTrackedForPhantomRegistration"), &["reference", "stylus"]);
    let raw_m = landmarks_m(&touched, |reading| (reading.position_m, reading.orientation.unwrap()));
    assert!((raw_m - 0.38e-3).abs() < 0.02e-3, "{raw_m}");
    let mut worse = 0;
    for (path, stride) in [(water, 12), (wires, 2)] {
        let readings = rows(&path, &names);
        // No pole at all, whatever length is claimed for it.
        for spacing_m in [0.1, 0.2] {
            let rows = readings.iter().step_by(stride).flat_map(|(t_s, readings)| {
                let known = readings.iter().enumerate();
                known.filter_map(move |(sensor, reading)| Some((*t_s, sensor, (*reading)?)))
            });
            let run = PoleRun::grouped(names.map(String::from).to_vec(), spacing_m, rows).unwrap();
            let Some(map) = solve(run, &[], &mut |_| {}).map else { continue };
            let corrector: Corrector = map.corrector();
            let corrected_m = landmarks_m(&touched, |reading| {
                let orientation = corrector.orientation(&reading.position_m, &reading.orientation.unwrap());
                (corrector.position(&reading.position_m), orientation)
            });
            let bad = corrected_m > raw_m + 1e-5;
            worse += usize::from(bad);
            assert!(!(bad && map.report.accepted), "{corrected_m} m: {:?}", map.report);
        }
    }
    // The solver did make maps, and it was its refusal that kept them out.
    assert!(worse > 0);
}
