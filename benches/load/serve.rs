//! A server in this process, and a thread that hands it frames.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use posed_daemon::Vital;
use posed_daemon::server::{Config, Hub, Server};
use posed_drivers::Timestamp;
use posed_stage::output::{Estimate, PoseEstimate, SensorEstimate, SensorState};
use posed_stage::{Sensor, Stage, Vrpn};
use tokio::sync::oneshot;

use super::Args;
use super::wakes::Wakes;

pub(crate) struct Served {
    pub(crate) url: String,
    stop: Option<oneshot::Sender<()>>,
    ends: Arc<AtomicBool>,
    /// Of the thread that hands over frames: what the computer is late by, whatever the server does.
    pub(crate) thread: Wakes,
    /// Of the server's runtime.
    pub(crate) runtime: Wakes,
    threads: Vec<std::thread::JoinHandle<()>>,
}

/// Starts server and frames.
#[expect(clippy::disallowed_methods, reason = "this program owns its threads")]
pub(crate) fn start(args: &Args) -> Served {
    let mut stage = Stage::parse("name = \"load\"").expect("a stage");
    for n in 0..args.sensors {
        let sensor = Sensor {
            name: format!("bird-{n}"),
            device: "flock".into(),
            address: n + 1,
            body: None,
            segment: None,
            mount_quat_wxyz: None,
            offset_m: None,
            imu: None,
            serial: None,
            magnetometer: true,
            gyro_delay_ms: 0.0,
        };
        stage.sensors.push(sensor);
    }
    stage.vrpn = args.vrpn.then(|| Vrpn { listen: Some("127.0.0.1:0".into()), call_back: false });
    let (thread, runtime) = (Wakes::default(), Wakes::default());
    let watched = runtime.clone();
    let (ready, started) = std::sync::mpsc::channel();
    let (stop, stopped) = oneshot::channel();
    let server = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
        runtime.expect("a runtime").block_on(async {
            tokio::spawn(watched.watch());
            let config = Config { listen: Some("127.0.0.1:0".into()), ..Config::new(Path::new("."), 0) };
            let (server, hub, _calls) = Server::bind(&stage, config).expect("a port");
            let url = match server.vrpn_address() {
                Some(address) => format!("vrpn://{address}"),
                None => format!("ws://{}/ws", server.address()),
            };
            ready.send((url, hub)).expect("who started this");
            server.run(async { _ = stopped.await }, Vital::default()).await;
        });
    });
    let (url, hub) = started.recv().expect("a server");
    let ends = Arc::new(AtomicBool::new(false));
    let frames = {
        let (ends, rate_hz, sensors) = (Arc::clone(&ends), args.rate_hz, args.sensors);
        let thread = thread.clone();
        std::thread::spawn(move || publish(&hub, rate_hz, sensors, &ends, &thread))
    };
    Served { url, stop: Some(stop), ends, thread, runtime, threads: vec![server, frames] }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// A frame per tick, its time the moment of handing over, its numbers all different.
#[expect(clippy::disallowed_methods, reason = "this program owns its clock")]
fn publish(hub: &Hub, rate_hz: f64, sensors: u16, ends: &AtomicBool, wakes: &Wakes) {
    let period = Duration::from_secs_f64(1.0 / rate_hz);
    let mut due = Instant::now();
    let mut frame = 0;
    let mut estimate = Estimate::default();
    while !ends.load(Ordering::Relaxed) {
        due += period;
        let before = Instant::now();
        std::thread::sleep(due.saturating_duration_since(before));
        let late = before.max(due).elapsed();
        frame += 1;
        estimate.frame = frame;
        estimate.sensors.clear();
        estimate.sensors.extend((0..sensors).map(|n| sensor(frame as f64 * 0.01 + f64::from(n))));
        let utc = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        estimate.t_valid = Timestamp::from_nanos(utc.as_nanos() as i64);
        hub.publish_estimate(&estimate);
        wakes.push(late);
    }
}

fn sensor(phase: f64) -> SensorEstimate {
    let (s, c) = (libm::sin(phase), libm::cos(phase));
    let pose = PoseEstimate {
        position_m: Some([0.7 * s, 0.7 * c, 1.0 + 0.3 * s * c]),
        orientation_wxyz: [c * 0.6, s * 0.6, c * 0.8, s * 0.8],
        velocity_m_s: Some([c, -s, 0.0]),
        angular_velocity_rad_s: [0.0; 3],
        covariance: [1e-7; 21],
        sigma_m: Some(0.001 + 0.0005 * s),
    };
    SensorEstimate {
        state: SensorState::Ok,
        pose: Some(pose),
        measured: None,
        fault: None,
        ..SensorEstimate::default()
    }
}
