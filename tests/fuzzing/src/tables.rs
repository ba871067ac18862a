//! Tables and other files that a user gives to the command line.

use posed_recording::table::{
    Imu, Poses, SegmentLabels, SequenceOptions, Sequences, Streams, TableReader, Unit, Up, read_labelled,
};
use posed_simulator::motion::{Ending, File, Tracks};

use crate::files::file;

/// The first byte chooses who reads, the others are the file. What is read without an error holds together.
///
/// # Panics
/// That does not hold.
pub(crate) fn tables(data: &[u8]) {
    let Some((&choice, bytes)) = data.split_first() else { return };
    let rate_hz = (choice & 0x80 != 0).then_some(50.0);
    let table = || TableReader::new("table.csv", std::io::Cursor::new(bytes.to_vec()));
    match choice % 8 {
        0 => {
            let Ok(poses) = table().and_then(Poses::from_table) else { return };
            let frames = poses.frames();
            assert_eq!(frames.positions_m.len(), 3 * frames.t_s.len() * poses.sensors.len());
        }
        1 => {
            let Ok(imu) = table().and_then(|table| Imu::from_table(table, rate_hz)) else { return };
            assert!(imu.rows.iter().all(|row| row.sensor < imu.sensors.len()));
        }
        2 => {
            let options = options(choice, rate_hz);
            let Ok(read) = table().and_then(|table| Sequences::from_table(table, &options)) else { return };
            assert_eq!(read.positions_m.len(), read.frames.len() * read.joints.len());
        }
        3 => {
            let read = table().and_then(|table| Streams::from_table(table, None, rate_hz));
            let Ok(streams) = read else { return };
            assert_eq!(streams.values.len(), streams.t_s.len() * streams.columns.len());
        }
        4 => _ = SegmentLabels::read(&file("labels.csv", bytes)),
        5 => {
            let path = file("beside.csv", b"t,a_x,a_y,a_z\n0,0,0,0\n0.5,1,1,1\n1,2,2,2\n");
            file("beside.eaf", bytes);
            let _ = read_labelled(&path, &options(choice, None));
        }
        kind => {
            let path = file(if kind == 6 { "motion.csv" } else { "motion.bvh" }, bytes);
            let file = File {
                path,
                unit_m: None,
                up: None,
                origin_m: [0.0; 3],
                heading_deg: 0.0,
                speed: 1.0,
                ending: if rate_hz.is_some() { Ending::ThereAndBack } else { Ending::Hold },
            };
            let Ok(tracks) = Tracks::read(&file, "/".as_ref()) else { return };
            for track in 0..tracks.names().count() {
                for t_s in [-1.0, 0.0, 0.1, 1e9] {
                    let pose = tracks.pose(track, t_s);
                    assert!((pose.rotation.norm() - 1.0).abs() < 1e-6, "no rotation: {pose:?}");
                }
            }
        }
    }
}

fn options(choice: u8, rate_hz: Option<f64>) -> SequenceOptions {
    let unit = [Unit::M, Unit::Mm, Unit::Cm][usize::from(choice >> 3) % 3];
    SequenceOptions { rate_hz, unit, up: if choice & 0x40 == 0 { Up::Y } else { Up::Z } }
}
