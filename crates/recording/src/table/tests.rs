//! Tests of the typed tables.

use std::io::Cursor;
use std::path::PathBuf;

use proptest::prelude::*;

use super::*;

fn table(text: &str) -> TableReader {
    TableReader::new("a.csv", Cursor::new(text.as_bytes().to_vec())).unwrap()
}

fn temporary(name: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    (folder, path)
}

#[test]
fn poses_have_sensors_gaps_and_unit_quaternions() {
    let text =
        "t,sensor,extra,x,y,z,qw,qx,qy,qz\n0,a,,1,2,3,1,0,0,0\n0,b,,1,2,3,,,,\n0.5,a,x,,,,1.001,0,0,0\n";
    let poses = Poses::from_table(table(text)).unwrap();
    assert_eq!(poses.sensors, ["a", "b"]);
    let [first, second, third] = poses.rows[..] else { panic!("not three rows") };
    assert_eq!(
        (first.position_m, first.orientation_wxyz),
        (Some([1.0, 2.0, 3.0]), Some([1.0, 0.0, 0.0, 0.0]))
    );
    assert_eq!((second.sensor, second.orientation_wxyz), (1, None));
    assert_eq!(
        (third.t_s, third.position_m, third.orientation_wxyz),
        (0.5, None, Some([1.0, 0.0, 0.0, 0.0]))
    );
    let bare = Poses::from_table(table("t,x,y,z\n0,1,2,3\n")).unwrap();
    assert_eq!((bare.sensors.len(), bare.rows[0].orientation_wxyz), (1, None));
}

#[test]
fn poses_that_are_wrong_are_refused() {
    for (text, emitted) in [
        ("t,x,y\n", "`z` among them"),
        ("t,x,y,z,qw\n", "`qx` among them"),
        ("t,x,y,z\n,1,2,3\n", "line 2, column t: expected a number, found an empty cell"),
        ("t,x,y,z\n0,1,2,\n", "column z"),
        ("t,sensor,x,y,z\n0,,1,2,3\n", "the name of a sensor"),
        ("t,x,y,z,qw,qx,qy,qz\n0,1,2,3,0.7,0,0,0\n", "column qw: expected a unit quaternion"),
    ] {
        let error = Poses::from_table(table(text)).unwrap_err().to_string();
        assert!(error.contains(emitted), "{error}");
    }
}

#[test]
fn imu_rows_take_their_time_from_a_column_or_a_rate() {
    let rows = "sensor,ax,ay,az,gx,gy,gz\na,1,2,3,4,5,6\nb,1,2,3,4,5,6\na,1,2,3,,,\n";
    let imu = Imu::from_table(table(rows), Some(50.0)).unwrap();
    let times: Vec<_> = imu.rows.iter().map(|row| row.t_s).collect();
    assert_eq!(times, [0.0, 0.0, 0.02], "every sensor counts for itself");
    assert_eq!((imu.magnetometer, imu.rows[2].gyro_rad_s), (false, None));
    let error = Imu::from_table(table(rows), None).unwrap_err().to_string();
    assert!(error.contains("--rate-hz"), "{error}");
    assert!(Imu::from_table(table(rows), Some(0.0)).unwrap_err().to_string().contains("above 0 Hz"));
    let nine = "t,ax,ay,az,gx,gy,gz,mx,my,mz\n7,1,2,3,4,5,6,7,8,9\n7.5,1,2,3,4,5,6,,,\n";
    let imu = Imu::from_table(table(nine), Some(50.0)).unwrap();
    assert_eq!((imu.rows[0].t_s, imu.rows[0].mag, imu.rows[1].mag), (7.0, Some([7.0, 8.0, 9.0]), None));
}

#[test]
fn streams_are_chosen_by_name_or_all_but_the_time() {
    let text = "t,a,b,name\n0,1,,x\n1,3,4,y\n";
    let chosen = Streams::from_table(table(text), Some(&["b".to_owned(), "a".to_owned()]), None).unwrap();
    assert_eq!((chosen.row(0), chosen.row(1)), (&[None, Some(1.0)][..], &[Some(4.0), Some(3.0)][..]));
    let error = Streams::from_table(table(text), None, None).unwrap_err().to_string();
    assert!(error.contains("column name: expected a number"), "{error}");
    let error = Streams::from_table(table(text), Some(&["c".to_owned()]), None).unwrap_err().to_string();
    assert!(error.contains("`c`") && error.contains("t,a,b,name"), "{error}");
    assert!(Streams::from_table(table("t\n1\n"), None, None).is_err());
}

#[test]
fn sequences_are_turned_to_metres_and_z_up() {
    let text = "t,hip_x,hip_y,hip_z,label,transition\n0,1000,2000,3000,walk,0\n1,,,,,1\n";
    let options = SequenceOptions { unit: Unit::Mm, ..SequenceOptions::default() };
    let sequences = Sequences::from_table(table(text), &options).unwrap();
    assert_eq!(sequences.joints, ["hip"]);
    assert_eq!(sequences.positions_m(0), [Some([1.0, -3.0, 2.0])]);
    assert_eq!(sequences.positions_m(1), [None]);
    assert_eq!((sequences.frames[0].label.as_deref(), sequences.frames[1].transition), (Some("walk"), true));
    let options = SequenceOptions { up: Up::Z, unit: Unit::Cm, ..options };
    let sequences = Sequences::from_table(table(text), &options).unwrap();
    assert_eq!(sequences.positions_m(0), [Some([10.0, 20.0, 30.0])]);
    for (text, emitted) in [
        ("t,hip_x,hip_y\n", "`hip_z` among them"),
        ("t,label\n", "NAME_x,NAME_y,NAME_z"),
        ("t,a_x,a_y,a_z,transition\n0,1,2,3,yes\n", "column transition: expected 0 or 1"),
    ] {
        let error = Sequences::from_table(table(text), &SequenceOptions::default()).unwrap_err().to_string();
        assert!(error.contains(emitted), "{error}");
    }
}

#[test]
fn a_name_that_looks_like_a_comment_or_like_nothing_is_quoted() {
    let (_folder, path) = temporary("a.csv");
    let mut writer = TableWriter::create(&path, &["#name"]).unwrap();
    for name in ["#1", "", "b"] {
        writer.text(name).unwrap();
        writer.end_row().unwrap();
    }
    writer.finish().unwrap();
    let mut table = TableReader::open(&path).unwrap();
    assert_eq!(table.columns(), ["#name"]);
    for name in ["#1", "", "b"] {
        assert!(table.next_row().unwrap());
        assert_eq!(table.text(0), name);
    }
}

#[test]
fn a_table_that_cannot_be_written_leaves_nothing() {
    let (folder, path) = temporary("a.csv");
    let mut writer = TableWriter::create(&path, &["t"]).unwrap();
    writer.number(1.0).unwrap();
    writer.end_row().unwrap();
    drop(writer);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let error = TableWriter::create(&folder.path().join("gone/a.csv"), &["t"]).err().unwrap();
    assert!(error.to_string().starts_with("cannot write"), "{error}");
    let error = Poses::read(&path).unwrap_err().to_string();
    assert!(error.starts_with("cannot read"), "{error}");
}

/// Finite numbers of all sizes.
fn number() -> impl Strategy<Value = f64> {
    any::<f64>().prop_filter("finite", |value| value.is_finite())
}

fn vector() -> impl Strategy<Value = Option<[f64; 3]>> {
    prop::option::of(prop::array::uniform3(number()))
}

/// Names with everything that CSV makes difficult, but without spaces around them.
fn name() -> impl Strategy<Value = String> {
    "[a-zA-Zäµ\"',;#][a-z \",;#\n]{0,6}[a-z\",#]"
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn poses_come_back_as_written(
        names in prop::collection::vec(name(), 1..4),
        rows in prop::collection::vec((number(), any::<usize>(), vector(), any::<bool>()), 1..20),
        zipped in any::<bool>(),
    ) {
        let mut poses = Poses::default();
        for (t_s, which, position_m, oriented) in rows {
            let name = &names[which % names.len()];
            let sensor = intern(&mut poses.sensors, name, 0);
            let orientation_wxyz = oriented.then_some([0.5, -0.5, 0.5, -0.5]);
            poses.rows.push(PoseRow { t_s, sensor, position_m, orientation_wxyz, state: None });
        }
        let (_folder, path) = temporary(if zipped { "a.csv.gz" } else { "a.csv" });
        poses.write(&path).unwrap();
        prop_assert_eq!(Poses::read(&path).unwrap(), poses);
    }

    #[test]
    fn imu_samples_come_back_as_written(
        rows in prop::collection::vec((number(), vector(), vector(), vector()), 1..20),
        magnetometer in any::<bool>(),
    ) {
        let rows = rows.into_iter().map(|(t_s, accel_m_s2, gyro_rad_s, mag)| {
            ImuRow { t_s, sensor: 0, accel_m_s2, gyro_rad_s, mag: mag.filter(|_| magnetometer) }
        });
        let imu = Imu { sensors: vec![String::new()], magnetometer, rows: rows.collect() };
        let (_folder, path) = temporary("a.csv");
        imu.write(&path).unwrap();
        prop_assert_eq!(Imu::read(&path, None).unwrap(), imu);
    }

    #[test]
    fn streams_come_back_as_written(
        rows in prop::collection::vec((number(), prop::array::uniform2(prop::option::of(number()))), 1..20),
    ) {
        let mut streams = Streams { columns: vec!["a".into(), "b \"c\"".into()], ..Streams::default() };
        for (t_s, values) in rows {
            streams.t_s.push(t_s);
            streams.values.extend(values);
        }
        let (_folder, path) = temporary("a.csv");
        streams.write(&path).unwrap();
        prop_assert_eq!(Streams::read(&path, None, None).unwrap(), streams);
    }

    #[test]
    fn sequences_come_back_as_written(
        rows in prop::collection::vec((number(), vector(), prop::option::of(name()), any::<bool>()), 1..20),
        labelled in any::<bool>(),
    ) {
        let mut sequences = Sequences { joints: vec!["left_knee".into()], labelled, ..Sequences::default() };
        for (t_s, position, label, transition) in rows {
            let (label, transition) = (label.filter(|_| labelled), transition && labelled);
            sequences.frames.push(SequenceFrame { t_s, label, transition });
            sequences.positions_m.push(position);
        }
        let (_folder, path) = temporary("a.csv");
        sequences.write(&path).unwrap();
        prop_assert_eq!(Sequences::read(&path, &SequenceOptions::default()).unwrap(), sequences);
    }

    #[test]
    fn any_bytes_are_rows_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..200), header in any::<bool>()) {
        let mut text = if header { b"t,x,y,z,qw,qx,qy,qz\n".to_vec() } else { Vec::new() };
        text.extend(bytes);
        if let Ok(table) = TableReader::new("a.csv", Cursor::new(text)) {
            let _ = Poses::from_table(table);
        }
    }
}
