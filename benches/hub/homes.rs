//! What a hub costs that has many stages of which few are looked at: simulated homes, viewers, and a hub, in three processes.
//!
//! ```text
//! cargo bench --bench homes --features zenoh                              200 homes, 100 viewers at 20 of them, 60 Hz and 20 Hz
//! cargo bench --bench homes --features zenoh -- --homes 50 --viewers 0
//! cargo bench --bench homes --features zenoh -- --router                  the homes connect to a router, and the hub to it
//! ```
//! A home is a stage's end of zenoh as the daemon has it, with a session of its own, fed with made-up frames of so many sensors in the place of the
//! distributor: what it publishes, and what it answers, is what a daemon does. Hub and viewers are the real ones. Processor time is from `/proc`; bytes are those of the hub's
//! links as the kernel counts them (`ss`), without headers. Each scenario prints a line of JSON.
#![expect(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "the lines are what it is for; this program owns its clock"
)]

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use clap::Parser;
use futures_util::{SinkExt, StreamExt};
use posed_daemon::link::{Context, Link};
use posed_daemon::server::Item;
use posed_daemon::{FusionInbox, StageClock};
use posed_drivers::Timestamp;
use posed_fusion::faults::Cause;
use posed_mesh::{Hub, HubOptions};
use posed_protocol::{Counters, DeviceStatus, LinkState, Names, SensorStatus, Status};
use posed_stage::Stage;
use posed_stage::output::{
    Estimate, Measured, Outcome, OutcomeKind, PoseEstimate, SensorEstimate, SensorState,
};
use serde_json::{Value, json};
use tokio_tungstenite::connect_async;
use tokio_tungstenite::tungstenite::Message;

/// What the page asks of each sensor.
const FIELDS: [&str; 7] =
    ["device", "position_m", "orientation_wxyz", "sigma_m", "measured", "fault", "change"];
/// Where the hub listens for homes, and a router in between.
const ZENOH: &str = "tcp/127.0.0.1:27551";
const ROUTER: &str = "tcp/127.0.0.1:27552";
const PAGE: &str = "127.0.0.1:28893";
/// Frames per second of a home.
const RATE_HZ: u64 = 100;

#[derive(Parser, Clone, Debug)]
struct Args {
    /// Homes.
    #[arg(long, default_value_t = 200)]
    homes: usize,
    /// Sensors of each.
    #[arg(long, default_value_t = 10)]
    sensors: u16,
    /// Viewers at the hub.
    #[arg(long, default_value_t = 100)]
    viewers: usize,
    /// Homes that they look at.
    #[arg(long, default_value_t = 20)]
    looked_at: usize,
    /// Rates that viewers ask for, one scenario each.
    #[arg(long, value_delimiter = ',', default_value = "60,20")]
    rates_hz: Vec<f64>,
    /// Fields that they ask for, instead of the page's.
    #[arg(long, value_delimiter = ',')]
    fields: Vec<String>,
    /// Length of a scenario.
    #[arg(long, default_value_t = 10)]
    seconds: u64,
    /// A router between homes and hub.
    #[arg(long)]
    router: bool,
    /// What a child process is: `hub`, `router`, `homes`.
    #[arg(long, hide = true)]
    role: Option<String>,
    /// Given by cargo.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() {
    let args = Args::parse();
    match args.role.as_deref() {
        Some("hub") => hub(&args),
        Some("router") => router(),
        Some("homes") => homes(&args),
        _ => measure(&args),
    }
}

/// A child process that ends with this one.
struct Role(Child);

impl Role {
    fn start(role: &str) -> Self {
        let own = std::env::args().skip(1);
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        // As `posed hub` has it.
        command.env(
            "ZENOH_RUNTIME",
            "(net: (worker_threads: 32), tx: (worker_threads: 32), rx: (worker_threads: 32))",
        );
        command.args(own).args(["--role", role]).stdin(Stdio::piped());
        Self(command.spawn().expect("a process"))
    }

    /// Processor time so far, s.
    fn used_s(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.0.id())).expect("/proc");
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
        let ticks = |at: usize| fields[at].parse::<f64>().expect("a number");
        // Linux counts in hundredths of a second.
        (ticks(11) + ticks(12)) / 100.0
    }

    fn resident_mb(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id())).expect("/proc");
        let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap_or_default();
        line.split_whitespace().nth(1).and_then(|kb| kb.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
    }
}

impl Drop for Role {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Until the process that has started this one ends.
fn until_orphaned() {
    let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
}

fn hub(args: &Args) {
    let ends =
        if args.router { format!("connect = [\"{ROUTER}\"]") } else { format!("listen = [\"{ZENOH}\"]") };
    let stage = Stage::parse(&format!("name = \"hub\"\n[zenoh]\n{ends}\n")).expect("a stage");
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let _hub = runtime.block_on(async {
        let options = HubOptions { stage, folder: ".".into(), http: Some(PAGE.to_owned()), fuse: Vec::new() };
        Hub::start(options).expect("a hub")
    });
    until_orphaned();
}

fn router() {
    use posed_mesh::zenoh::{Config, Wait, open};
    // As docs/hub.md has it.
    let gateway = r#"{"south": [{"filters": [{"region_names": ["posed-hub"]}]}, {"filters": [{"region_names": ["posed-stage"]}]}]}"#;
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_owned()),
        ("listen/endpoints", format!("[\"{ROUTER}\"]")),
        ("gateway", gateway.to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("a key of zenoh");
    }
    let _session = open(config).wait().expect("a router");
    until_orphaned();
}

/// One home.
struct Home {
    link: Link,
    names: Names,
    counters: Counters,
}

fn homes(args: &Args) {
    let zenoh = if args.router { ROUTER } else { ZENOH };
    let mut all: Vec<Home> = (0..args.homes).map(|number| home(number, args.sensors, zenoh)).collect();
    let begun = Instant::now();
    for frame in 0.. {
        let t_valid = Timestamp::from_nanos((frame * 1_000_000_000 / RATE_HZ) as i64);
        let estimate = estimate(frame, t_valid, args.sensors);
        for (number, home) in all.iter_mut().enumerate() {
            home.publish(Item::Estimate(estimate.clone()));
            // Each at another moment of the second.
            if (frame + number as u64).is_multiple_of(RATE_HZ) {
                home.publish(Item::Status(Box::new(status(t_valid, args.sensors))));
            }
            if (frame + number as u64).is_multiple_of(10 * RATE_HZ) {
                let what = OutcomeKind::Fault {
                    sensor: 0,
                    cause: Cause::Gate,
                    active: frame % (20 * RATE_HZ) < 10 * RATE_HZ,
                };
                home.publish(Item::Outcome(Box::new(Outcome { t_valid, t_decided: t_valid, what })));
            }
        }
        let next = begun + Duration::from_nanos((frame + 1) * 1_000_000_000 / RATE_HZ);
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
}

impl Home {
    fn publish(&mut self, item: Item) {
        let stamp =
            item.payload().map(|payload| self.counters.stamp(&payload)).expect("something to publish");
        self.link.feed.publish(&item, &stamp, &self.names);
    }
}

fn home(number: usize, sensors: u16, zenoh: &str) -> Home {
    let mut text = format!("name = \"Home {number}\"\n[zenoh]\nconnect = [\"{zenoh}\"]\n");
    for device in 0..sensors.div_ceil(4) {
        text += &format!(
            "[[device]]\nname = \"flock-{device}\"\ndriver = \"flock-of-birds\"\nport = \"/dev/flock-{device}\"\n"
        );
    }
    for sensor in 0..sensors {
        text += &format!(
            "[[sensor]]\nname = \"bird-{sensor}\"\ndevice = \"flock-{}\"\naddress = {}\n",
            sensor / 4,
            sensor % 4 + 1
        );
    }
    let stage = Stage::parse(&text).expect("a stage");
    let context = Context {
        stage: &stage,
        clock: StageClock::start(),
        inbox: FusionInbox::new(16),
        recordings: "none".into(),
    };
    let link = posed_mesh::connect(context).expect("a link");
    Home { link, names: Names::new(&stage), counters: Counters::default() }
}

fn estimate(frame: u64, t_valid: Timestamp, sensors: u16) -> Estimate {
    let number = |n: u64| libm::sin((frame + 17 * n) as f64 * 0.01);
    let sensor = |n: u16| {
        let at = u64::from(n);
        let position_m = [number(at), number(at + 1), number(at + 2)];
        let orientation_wxyz = [0.5, -0.5, 0.5, -0.5];
        let pose = PoseEstimate {
            position_m: Some(position_m),
            orientation_wxyz,
            velocity_m_s: Some(position_m),
            angular_velocity_rad_s: position_m,
            covariance: std::array::from_fn(|n| 1e-6 * number(n as u64)),
            sigma_m: Some(1e-3),
        };
        let measured = Measured {
            t_valid,
            position_m: Some(position_m),
            clipped: false,
            orientation_wxyz: Some(orientation_wxyz),
            button: None,
            inertial: None,
        };
        SensorEstimate {
            state: SensorState::Ok,
            pose: Some(pose),
            measured: Some(measured),
            ..SensorEstimate::default()
        }
    };
    Estimate {
        frame,
        t_valid,
        t_closed: t_valid,
        sigma_t_s: 1e-4,
        fault: None,
        sensors: (0..sensors).map(sensor).collect(),
    }
}

fn status(t: Timestamp, sensors: u16) -> Status {
    let device = |n: u16| DeviceStatus {
        name: format!("flock-{n}"),
        state: LinkState::Streaming,
        ..DeviceStatus::default()
    };
    let sensor = |n: u16| SensorStatus { name: format!("bird-{n}"), ..SensorStatus::default() };
    Status {
        t_s: t.as_nanos() as f64 * 1e-9,
        devices: (0..sensors.div_ceil(4)).map(device).collect(),
        sensors: (0..sensors).map(sensor).collect(),
        ..Status::default()
    }
}

/// Bytes that have gone over the hub's links with homes or the router: in, out.
fn link_bytes() -> (f64, f64) {
    let (mut taken, mut sent) = (0.0, 0.0);
    // The hub's end of each: it listens, or has connected to the router.
    for filter in ["sport = :27551", "dport = :27552"] {
        let listed = Command::new("ss").args(["-tinHO", filter]).output().expect("ss, of iproute2");
        for line in String::from_utf8_lossy(&listed.stdout).lines() {
            let of = |name: &str| {
                let found = line
                    .split_whitespace()
                    .find_map(|word| word.strip_prefix(name)?.strip_prefix(':')?.parse::<f64>().ok());
                found.unwrap_or(0.0)
            };
            taken += of("bytes_received");
            sent += of("bytes_sent");
        }
    }
    (taken, sent)
}

fn measure(args: &Args) {
    let router = args.router.then(|| Role::start("router"));
    let hub = Role::start("hub");
    let homes = Role::start("homes");
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(until_all_are_there(args.homes));
    let scenario = |name: &str, viewers: usize, rate_hz: f64| {
        let (stop, stopped) = tokio::sync::watch::channel(false);
        let watching: Vec<_> = (0..viewers)
            .map(|n| {
                let home = n % args.looked_at;
                runtime.spawn(watch(home, rate_hz, args.fields.clone(), stopped.clone()))
            })
            .collect();
        let pause = |seconds| {
            runtime.block_on(async move {
                tokio::time::sleep_until(tokio::time::Instant::now() + Duration::from_secs(seconds)).await
            })
        };
        pause(5);
        let before =
            (Instant::now(), hub.used_s(), homes.used_s(), router.as_ref().map(Role::used_s), link_bytes());
        let counted = |stopped: bool| _ = stop.send_replace(stopped);
        pause(args.seconds);
        let after =
            (Instant::now(), hub.used_s(), homes.used_s(), router.as_ref().map(Role::used_s), link_bytes());
        counted(true);
        let seen: Vec<Seen> =
            watching.into_iter().map(|task| runtime.block_on(task).expect("a viewer")).collect();
        let lasted_s = (after.0 - before.0).as_secs_f64();
        let rate = |a: f64, b: f64, digits: i32| {
            let scale = 10_f64.powi(digits);
            ((b - a) / lasted_s * scale).round() / scale
        };
        let mut first_s: Vec<f64> = seen.iter().map(|seen| seen.first_s).collect();
        first_s.sort_by(f64::total_cmp);
        let ms = |s: Option<&f64>| s.map(|s| (s * 1e3).round());
        let each = |of: fn(&Seen) -> f64| seen.iter().map(of).sum::<f64>();
        let line = json!({
            "scenario": name, "homes": args.homes, "viewers": viewers, "looked_at": if viewers > 0 { args.looked_at } else { 0 }, "rate_hz": rate_hz,
            "hub_cores": rate(before.1, after.1, 4), "hub_mb": hub.resident_mb().round(),
            "homes_cores": rate(before.2, after.2, 4),
            "router_cores": before.3.zip(after.3).map(|(a, b)| rate(a, b, 4)),
            "to_hub_bytes_per_s": rate(before.4.0, after.4.0, 0), "from_hub_bytes_per_s": rate(before.4.1, after.4.1, 0),
            "frames_per_s_and_viewer": (each(|seen| seen.frames_hz) / viewers.max(1) as f64 * 10.0).round() / 10.0,
            "to_viewers_bytes_per_s": each(|seen| seen.bytes_per_s).round(),
            "first_frame_ms": {"median": ms(first_s.get(viewers / 2)), "last": ms(first_s.last())},
        });
        println!("{line}");
        // Until nothing is asked for any more.
        pause(6);
    };
    scenario("nobody looks", 0, 0.0);
    for rate_hz in &args.rates_hz {
        if args.viewers > 0 {
            scenario("viewers", args.viewers, *rate_hz);
        }
    }
    scenario("nobody looks any more", 0, 0.0);
}

/// Until the hub says that all homes are there.
async fn until_all_are_there(homes: usize) {
    let mut socket = loop {
        match connect_async(format!("ws://{PAGE}/ws")).await {
            Ok((socket, _)) => break socket,
            Err(_) => tokio::time::sleep_until(tokio::time::Instant::now() + Duration::from_millis(50)).await,
        }
    };
    while let Some(Ok(message)) = socket.next().await {
        let Ok(message) = serde_json::from_str::<Value>(message.to_text().unwrap_or_default()) else {
            continue;
        };
        let present = |stage: &&Value| {
            stage["state"] == "present" && stage["frames_hz"].as_f64() > Some(0.5 * RATE_HZ as f64)
        };
        let there = message["stages"].as_array().map_or(0, |stages| stages.iter().filter(present).count());
        if there == homes {
            return;
        }
    }
    panic!("the hub has ended");
}

/// What a viewer has had.
struct Seen {
    /// From its subscription to its first frame.
    first_s: f64,
    frames_hz: f64,
    bytes_per_s: f64,
}

async fn watch(
    home: usize,
    rate_hz: f64,
    fields: Vec<String>,
    mut stopped: tokio::sync::watch::Receiver<bool>,
) -> Seen {
    let (mut socket, _) = connect_async(format!("ws://{PAGE}/home-{home}/ws")).await.expect("the hub");
    let fields = if fields.is_empty() { json!(FIELDS) } else { json!(fields) };
    let subscribe = json!({"type": "subscribe", "id": 1, "topics": ["sensors"], "max_rate_hz": rate_hz, "fields": fields});
    let begun = Instant::now();
    for request in [subscribe, json!({"type": "subscribe", "id": 2, "topics": ["status", "faults", "jobs"]})]
    {
        socket.send(Message::text(request.to_string())).await.expect("the hub");
    }
    let (mut first_s, mut frames, mut bytes, mut since) = (f64::NAN, 0_u32, 0, Instant::now());
    loop {
        let message = tokio::select! {
            message = socket.next() => message,
            _ = stopped.changed() => break,
        };
        let Some(Ok(message)) = message else { panic!("the hub has ended a connection") };
        let text = message.to_text().unwrap_or_default();
        bytes += text.len();
        if text.starts_with(r#"{"type":"sensors""#) {
            if first_s.is_nan() {
                first_s = begun.elapsed().as_secs_f64();
                (frames, bytes, since) = (0, 0, Instant::now());
            }
            frames += 1;
        }
    }
    let lasted_s = since.elapsed().as_secs_f64();
    Seen { first_s, frames_hz: f64::from(frames) / lasted_s, bytes_per_s: bytes as f64 / lasted_s }
}
