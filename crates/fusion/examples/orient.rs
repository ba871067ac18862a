//! The orientation of an IMU from a CSV file: `cargo run -p posed-fusion --example orient -- imu.csv`.
//!
//! Rows `t,ax,ay,az,gx,gy,gz` after a header (s, m/s², rad/s) come in; rows `t,qw,qx,qy,qz`, sensor to room, go out.

use nalgebra::Vector3;
use posed_fusion::ahrs::{Ahrs, ImuSample, Params};

#[expect(clippy::print_stdout, reason = "the answer")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("give a CSV file")?;
    let (mut filter, mut last_s) = (Ahrs::new(Params::default()), None);
    println!("t,qw,qx,qy,qz");
    for line in std::fs::read_to_string(path)?.lines().skip(1) {
        let row: Vec<f64> = line.split(',').map(str::parse).collect::<Result<_, _>>()?;
        let [t_s, ax, ay, az, gx, gy, gz] = row[..] else { return Err("give seven columns".into()) };
        let (accel_m_s2, gyro_rad_s) = (Vector3::new(ax, ay, az), Vector3::new(gx, gy, gz));
        let dt_s = last_s.replace(t_s).map_or(0.01, |last_s| t_s - last_s);
        let q = filter.push(&ImuSample { gyro_rad_s, accel_m_s2, mag: None }, dt_s);
        println!("{t_s},{},{},{},{}", q.w, q.i, q.j, q.k);
    }
    Ok(())
}
