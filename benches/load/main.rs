//! The load program: how late messages are at many clients, what that costs, and what a bad client does to the others.
//!
//! ```text
//! cargo bench --bench load                                  all scenarios, 100 sensors x 100 Hz x 100 clients
//! cargo bench --bench load -- --sensors 8 --clients 1 --scenario quiet
//! cargo bench --bench load -- --vrpn                        VRPN clients instead of websockets
//! cargo bench --bench load -- --url ws://127.0.0.1:8787/ws  clients only, at a running daemon
//! ```
//! The server runs in this process, fed by a thread in the place of the fusion thread; the clients run in a second process
//! and the bad client in a third. Latency is from handing over the frame to having received the whole message and read its
//! time. With `--url` it is the age of the pose: from its capture time. `pause` is the longest time without a message at any client, `late` by how
//! much a thread that only sleeps and hands over frames, the server's runtime and the clients' came to run too late: of a pause of that length the computer, the
//! server or the clients are the cause. `peak MB` is the most memory that this process has had until then.
#![expect(clippy::print_stdout, reason = "the table is what it is for")]

mod bullies;
mod clients;
mod hostile;
mod serve;
mod vrpn;
mod wakes;

use std::process::{Child, Command, Stdio};
use std::time::Duration;

use clap::Parser;

use self::clients::Report;

#[derive(Parser, Clone, Debug)]
struct Args {
    /// Sensors of the stage.
    #[arg(long, default_value_t = 100)]
    sensors: u16,
    /// Frames per second.
    #[arg(long, default_value_t = 100.0)]
    rate_hz: f64,
    /// Clients that are measured.
    #[arg(long, default_value_t = 100)]
    clients: usize,
    /// Length of a scenario, after a second of warming up.
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// One scenario instead of all: quiet, stalled, greeting, flood, slow, crowd, beside, hostile; several with commas between them.
    #[arg(long)]
    scenario: Option<String>,
    /// VRPN clients instead of websockets.
    #[arg(long)]
    vrpn: bool,
    /// MessagePack instead of JSON.
    #[arg(long)]
    msgpack: bool,
    /// A running server, instead of one in this process.
    #[arg(long)]
    url: Option<String>,
    /// What a child process is: `clients`, or a scenario's bad client.
    #[arg(long, hide = true)]
    role: Option<String>,
    /// Given by cargo.
    #[arg(long, hide = true)]
    bench: bool,
}

const SCENARIOS: [(&str, &str); 8] = [
    ("quiet", "nobody else"),
    ("stalled", "one client subscribes and never reads"),
    ("greeting", "50 connections send half a request"),
    ("flood", "one client sends as fast as it can, and comes back"),
    ("slow", "five clients read five messages per second"),
    ("crowd", "10,000 connections one after another, 500 at a time"),
    ("beside", "what is hostile attacks another daemon of this computer"),
    ("hostile", "1,000 connections of ten kinds at once, each of which comes back"),
];

fn main() {
    let args = Args::parse();
    match (args.role.as_deref(), &args.url) {
        (Some("clients"), Some(url)) => println!("{}", clients::run(&args, url).to_line()),
        (Some(bully), Some(url)) => bullies::run(bully, url),
        _ => scenarios(&args),
    }
}

fn scenarios(args: &Args) {
    println!(
        "{} sensors x {} Hz x {} clients, {} s each, {}",
        args.sensors,
        args.rate_hz,
        args.clients,
        args.seconds,
        if args.vrpn {
            "VRPN"
        } else if args.msgpack {
            "MessagePack"
        } else {
            "JSON"
        }
    );
    println!(
        "{:<9} {:>9} {:>8} {:>7} {:>7} {:>7} {:>7} {:>8} {:>7} {:>14} {:>7} {:>7} {:>7}  load",
        "scenario",
        "msgs/s",
        "MB/s",
        "p50 ms",
        "p99 ms",
        "p99.9",
        "max",
        "pause ms",
        "dropped",
        "late ms",
        "server%",
        "client%",
        "peak MB"
    );
    for (name, what) in SCENARIOS {
        if args.scenario.as_deref().is_some_and(|some| !some.split(',').any(|wanted| wanted == name)) {
            continue;
        }
        if args.vrpn && !["quiet", "stalled", "greeting", "flood"].contains(&name) {
            continue;
        }
        let served = args.url.is_none().then(|| serve::start(args));
        let url =
            served.as_ref().map_or_else(|| args.url.clone().unwrap_or_default(), |served| served.url.clone());
        // What an attack takes of the computer alone: attackers have computers of their own elsewhere.
        let other = (name == "beside").then(|| serve::start(args));
        let (role, victim) = other.as_ref().map_or((name, &url), |other| ("hostile", &other.url));
        let mut bully = (name != "quiet").then(|| child(args, role, victim));
        // The bad client is there before the others come.
        std::thread::park_timeout(Duration::from_millis(if bully.is_some() { 500 } else { 0 }));
        let cpu_before = cpu_s(std::process::id());
        let clients = child(args, "clients", &url);
        let output = clients.wait_with_output().expect("the clients' process");
        let server_cpu_s = cpu_s(std::process::id()) - cpu_before;
        if let Some(bully) = &mut bully {
            let _ = bully.kill();
            let _ = bully.wait();
        }
        let line = String::from_utf8_lossy(&output.stdout);
        let report = Report::from_line(&line);
        // The server works a little longer than the clients measure: warming up and saying goodbye.
        let server = 100.0 * server_cpu_s / (args.seconds + clients::WARM_UP_S);
        let late_ms = served.as_ref().map_or([0.0; 2], |served| {
            [&served.thread, &served.runtime].map(|wakes| wakes.late_ms(report.begins_utc_s, args.seconds))
        });
        let late = format!("{:.1}/{:.1}/{:.1}", late_ms[0], late_ms[1], report.late_ms);
        let clients = report.cpu_percent;
        let peak_mb = peak_mb();
        println!(
            "{name:<9} {} {late:>14} {server:>7.1} {clients:>7.1} {peak_mb:>7.0}  {}  {what}",
            report.row(),
            load()
        );
        drop((served, other));
    }
}

fn child(args: &Args, role: &str, url: &str) -> Child {
    let exe = std::env::current_exe().expect("own path");
    // A thousand clients do not share the processors of a stage's computer: they have what it leaves over.
    let mut command = match role {
        "hostile" => Command::new("chrt"),
        _ => Command::new(&exe),
    };
    if role == "hostile" {
        command.args(["--idle", "0"]).arg(&exe);
    }
    command.args(["--role", role, "--url", url]).stdout(Stdio::piped());
    command.args(["--clients", &args.clients.to_string(), "--seconds", &args.seconds.to_string()]);
    command.args(["--rate-hz", &args.rate_hz.to_string()]);
    command.args(["--sensors", &args.sensors.to_string()]);
    if args.msgpack {
        command.arg("--msgpack");
    }
    command.spawn().expect("a process of our own")
}

/// Processor time that a process has used, in seconds.
fn cpu_s(pid: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // After the name in parentheses: state, then numbers; user and system time are the 12th and 13th, in 1/100 s.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |at: usize| fields.get(at).and_then(|field| field.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

/// Most memory that this process has had, with the frames and the server in it, MB.
fn peak_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
    let kilobytes = line.trim().trim_end_matches("kB").trim().parse::<f64>();
    kilobytes.unwrap_or(0.0) / 1000.0
}

/// The machine's load over the last minute: what else was going on.
fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().next().unwrap_or("?").to_owned()
}
