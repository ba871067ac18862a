//! Ten boards, ten phones and ten trackers of a receiver behind radios, beside a Liberty on a wire: each leaves in turn and costs the others
//! nothing, what the radio loses is counted as it is where its packets have numbers, and capture times are as good as they are said to be.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use posed_drivers::open_imu::{Carrier, OpenImuSession, Settings};
use posed_drivers::{DeviceTime, Output, Session};
use posed_pipeline::clock::{RadioClock, Settings as ClockSettings};
use posed_simulator::faults::{Bytes, Fault};
use posed_simulator::scenario::DeviceScenario;
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};

use super::judge::{cycles, nearest};
use super::{QUIET, scene};
use posed_rig::Rig;

/// Devices of each kind, when the first of them leaves, for how long, how far the next is behind it, and after how long it leaves again, s.
const COUNT: u16 = 10;
const FIRST_S: f64 = 6.0;
const AWAY_S: f64 = 3.0;
const TURN_S: f64 = 1.5;
const ROUND_S: f64 = 60.0;
/// Samples a second of boards and phones, and what their radios add at most, ms.
const RADIOS: [(f64, f64); 2] = [(100.0, 40.0), (60.0, 60.0)];
/// What the receiver's radio adds at most, ms: its packets have neither time nor number, so that all of it is in their times.
const RECEIVER_MS: f64 = 6.0;
/// Standard deviation of what is timed by its arrival, as it is stated, s.
const ARRIVAL_SIGMA_S: f64 = 5e-3;
/// Sensors of the Liberty, which counts.
const STATIONS: u16 = 8;
/// Devices in the order of the stage, and the places of the first tracker and of the first station among the sensors.
const RECEIVER: usize = 2;
const LIBERTY: usize = 3;
const FIRST_TRACKER: usize = 2 * COUNT as usize;
const FIRST_STATION: usize = 3 * COUNT as usize;

fn stage() -> Stage {
    let mut text = String::from("name = \"radios\"\n");
    let sensor = |text: &mut String, device: &str, address: u16| {
        writeln!(
            text,
            "[[sensor]]\nname = \"{device}-{address}\"\ndevice = \"{device}\"\naddress = {address}"
        )
        .unwrap();
    };
    for (device, port) in [("boards", "udp://0.0.0.0:9301"), ("phones", "websocket")] {
        let ids: Vec<String> = (1..=COUNT).map(|k| format!("{device}-{k}")).collect();
        writeln!(
            text,
            "[[device]]\nname = \"{device}\"\ndriver = \"open-imu\"\nport = \"{port}\"\ndevices = {ids:?}"
        )
        .unwrap();
        (1..=COUNT).for_each(|address| sensor(&mut text, device, address));
    }
    let macs: Vec<String> = (1..=COUNT).map(|k| format!("C0:FF:EE:12:34:{k:02X}")).collect();
    let receiver = "[[device]]\nname = \"trackers\"\ndriver = \"slimevr\"\nport = \"/dev/hidraw0\"";
    writeln!(text, "{receiver}\ntrackers = {macs:?}").unwrap();
    (1..=COUNT).for_each(|address| sensor(&mut text, "trackers", address));
    text += "[[device]]\nname = \"liberty\"\ndriver = \"polhemus\"\nport = \"/dev/none\"\nbaud = 921600\n";
    (1..=STATIONS).for_each(|address| sensor(&mut text, "liberty", address));
    toml::from_str(&text).unwrap()
}

/// Two per cent of a device's datagrams, and each of its units away in turn.
fn faults(rate_hz: f64, seconds: f64) -> Vec<Fault> {
    let count = (0.02 * rate_hz * f64::from(COUNT) * seconds) as u32;
    let lost = Fault::LostDatagrams(Bytes { count, start_s: 2.0, end_s: seconds });
    let rounds = (seconds / ROUND_S).ceil() as u16;
    let leaves = (0..rounds).flat_map(|round| {
        (0..COUNT).map(move |k| Fault::BirdDies {
            address: k + 1,
            at_s: FIRST_S + ROUND_S * f64::from(round) + TURN_S * f64::from(k),
            duration_s: Some(AWAY_S),
        })
    });
    std::iter::once(lost).chain(leaves.filter(|leaves| leaves.span_s().0 < seconds - AWAY_S)).collect()
}

/// Of a sample: host time of coming, ticks, capture time, stated deviation, and whether it is late.
type Stamped = (f64, u64, f64, f64, bool);

/// What a session and its clocks make of the same bytes as the pipeline.
struct Mirror {
    session: OpenImuSession,
    clocks: BTreeMap<u16, RadioClock>,
    /// By address.
    stamps: BTreeMap<u16, Vec<Stamped>>,
    /// By sensor: when it measured.
    truth: BTreeMap<usize, Vec<f64>>,
}

impl Mirror {
    fn new(device: &str) -> Self {
        let devices = (1..=COUNT).map(|k| format!("{device}-{k}")).collect();
        let wanted: Vec<u16> = (1..=COUNT).collect();
        let settings = Settings { devices, ..Settings::default() };
        Self {
            session: OpenImuSession::new(settings, Carrier::Envelopes { port: 0, websocket: 0 }, &wanted)
                .unwrap(),
            clocks: BTreeMap::new(),
            stamps: BTreeMap::new(),
            truth: BTreeMap::new(),
        }
    }

    fn see(&mut self, rig: &Rig, index: usize) {
        for Entry { t, input } in &rig.log {
            match input {
                Input::Bytes { device, bytes } if usize::from(*device) == index => {
                    self.session.handle_bytes(*t, bytes);
                }
                Input::Line { device, event } if usize::from(*device) == index => {
                    self.session.handle_line(*t, event)
                }
                _ => {}
            }
            while let Some(output) = self.session.poll_output() {
                let Output::Sample(sample) = output else { continue };
                let settings = ClockSettings { byte_time_s: 0.0, measurement_delay_s: 0.0 };
                let clock = self.clocks.entry(sample.address).or_insert_with(|| RadioClock::new(settings));
                let stamp = clock.push(&sample);
                let DeviceTime::Counter { ticks, .. } = sample.t_device else { panic!() };
                let (came_s, t_s) = (sample.arrival.t_read.as_secs_f64(), stamp.t_valid.as_secs_f64());
                let stamp = (came_s, ticks, t_s, stamp.sigma_s, stamp.is_late());
                self.stamps.entry(sample.address).or_default().push(stamp);
            }
        }
        for cycle in rig.host.truth.iter().filter(|cycle| cycle.device == index) {
            for row in &cycle.sensors {
                self.truth.entry(row.sensor).or_default().push(cycle.t.as_secs_f64());
            }
        }
    }

    /// Errors and stated deviations of the capture times of the sensor at an address, s; how many were late; and the first and last
    /// cycles that came of each of its lives.
    fn errors(&self, address: u16, sensor: usize, rate_hz: f64) -> (Vec<(f64, f64)>, usize, Vec<[u64; 2]>) {
        let (stamps, truth) = (&self.stamps[&address], &self.truth[&sensor]);
        let (mut errors, mut late, mut lives) = (Vec::new(), 0, Vec::new());
        // Between two restarts ticks show which cycle is which; the fastest arrival shows which is the first.
        for life in stamps.chunk_by(|a, b| a.1 <= b.1) {
            let cycle = |ticks: u64| ((ticks - life[0].1) as f64 * 1e-6 * rate_hz).round() as usize;
            let can_begin = |first: &usize| {
                life.iter().all(|(came_s, ticks, ..)| {
                    truth.get(first + cycle(*ticks)).is_some_and(|t_s| t_s + 2e-4 <= *came_s)
                })
            };
            let first =
                (0..truth.len()).rev().find(can_begin).expect("no sample comes before it is measured");
            lives.push([first, first + cycle(life[life.len() - 1].1)].map(|at| at as u64));
            for (_, ticks, t_s, sigma_s, is_late) in life {
                if *is_late {
                    late += 1;
                } else {
                    errors.push((t_s - truth[first + cycle(*ticks)], *sigma_s));
                }
            }
        }
        (errors, late, lives)
    }
}

/// Shares of errors within 8 ms and within two stated deviations, and the mean of those, ms.
fn shares(errors: &[(f64, f64)]) -> (f64, f64, f64) {
    let share = |good: &dyn Fn(&(f64, f64)) -> bool| {
        errors.iter().filter(|error| good(error)).count() as f64 / errors.len() as f64
    };
    let near = share(&|(error_s, _)| error_s.abs() <= 8e-3);
    let stated = share(&|(error_s, sigma_s)| error_s.abs() <= 2.0 * sigma_s);
    (near, stated, 1e3 * errors.iter().map(|(_, sigma_s)| sigma_s).sum::<f64>() / errors.len() as f64)
}

/// Errors of what came through the receiver: none comes as late as the next is measured, so that it is the latest before.
fn by_receiver(rig: &Rig, newest_s: &mut [f64], errors: &mut Vec<(f64, f64)>) {
    let mut truth: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for cycle in rig.host.truth.iter().filter(|cycle| cycle.device == RECEIVER) {
        cycle.sensors.iter().for_each(|row| truth.entry(row.sensor).or_default().push(cycle.t.as_secs_f64()));
    }
    for estimate in rig.estimates() {
        for (k, newest_s) in newest_s.iter_mut().enumerate() {
            let Some(measured) = estimate.sensors[FIRST_TRACKER + k].measured else { continue };
            let t_s = measured.t_valid.as_secs_f64();
            let times = &truth[&(FIRST_TRACKER + k)];
            let before = times.partition_point(|at_s| *at_s < t_s);
            // What was measured before the last look is forgotten.
            if t_s > *newest_s && before > 0 {
                errors.push((t_s - times[before - 1], ARRIVAL_SIGMA_S));
                *newest_s = t_s;
            }
        }
    }
}

#[test]
fn radios_lose_what_they_lose_and_are_timed_as_well_as_is_said() {
    let seconds: f64 = std::env::var("POSED_SOAK_S").ok().and_then(|text| text.parse().ok()).unwrap_or(24.0);
    let stage = stage();
    let names: Vec<&str> = stage.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
    let radio = |name: &str, (rate_hz, radio_jitter_ms): (f64, f64)| DeviceScenario {
        name: name.into(),
        drift_ppm: 200.0,
        radio_jitter_ms,
        faults: faults(rate_hz, seconds),
        ..DeviceScenario::default()
    };
    let liberty = DeviceScenario { name: "liberty".into(), drift_ppm: 50.0, ..DeviceScenario::default() };
    let receiver = radio("trackers", (100.0, RECEIVER_MS));
    let devices = vec![radio("boards", RADIOS[0]), radio("phones", RADIOS[1]), receiver, liberty];
    let mut rig = Rig::new(&stage, &scene(5, QUIET, &names, devices));
    let mut mirrors = ["boards", "phones"].map(Mirror::new);
    let mut lost: BTreeMap<(usize, u16), Vec<u64>> = BTreeMap::new();
    let mut on_wire: Vec<f64> = Vec::new();
    let (mut newest_s, mut received) = (vec![0.0; usize::from(COUNT)], Vec::new());
    // All stream before the first of them leaves.
    let mut t_s = 5.0;
    rig.run_until(t_s);
    let before = rig.pipeline.status();
    while t_s < seconds {
        t_s = (t_s + 10.0).min(seconds);
        rig.run_until(t_s);
        mirrors.iter_mut().enumerate().for_each(|(index, mirror)| mirror.see(&rig, index));
        by_receiver(&rig, &mut newest_s, &mut received);
        for (device, _, loss) in &rig.host.losses {
            lost.entry((*device, loss.address.expect("of one sensor"))).or_default().push(loss.cycle);
        }
        let frames = cycles(&rig, LIBERTY);
        for estimate in rig.estimates().filter(|estimate| estimate.t_valid.as_secs_f64() > 5.0) {
            let Some(measured) = estimate.sensors[FIRST_STATION].measured else { continue };
            let t_s = measured.t_valid.as_secs_f64();
            on_wire.push(t_s - nearest(&frames, t_s).t.as_secs_f64());
        }
        rig.forget();
    }
    let status = rig.pipeline.status();
    on_wire.sort_by(f64::total_cmp);
    let quantiles_ms = [0.0, 0.025, 0.25, 0.5, 0.75, 0.975, 1.0]
        .map(|share| 1e3 * on_wire[((on_wire.len() - 1) as f64 * share) as usize]);
    let near = on_wire.iter().filter(|error_s| error_s.abs() <= 1e-3).count() as f64 / on_wire.len() as f64;
    println!("the Liberty: {near:.4} of {} within 1 ms: {quantiles_ms:.2?} ms", on_wire.len());
    assert!(near >= 0.99, "{near}");
    for (device, (rate_hz, jitter_ms)) in RADIOS.into_iter().enumerate() {
        let (mut all, mut late_of_all, mut lost_of_all) = (Vec::new(), 0, 0);
        for address in 1..=COUNT {
            let at = device * usize::from(COUNT) + usize::from(address) - 1;
            let (errors, late, lives) = mirrors[device].errors(address, at, rate_hz);
            // What is lost as the last thing before it leaves, or as the first when it begins anew, nobody can know.
            let known = |cycle: &&u64| lives.iter().any(|[first, last]| (first..last).contains(cycle));
            let expected =
                lost.get(&(device, address)).map_or(0, |cycles| cycles.iter().filter(known).count());
            let counted = &status.sensors[at];
            assert_eq!(counted.missed, expected as u64, "{}", stage.sensors[at].name);
            assert!(!counted.estimated, "{}", stage.sensors[at].name);
            all.extend(errors);
            late_of_all += late;
            lost_of_all += expected;
        }
        let (near, stated, sigma_ms) = shares(&all);
        println!(
            "{device}: jitter {jitter_ms} ms, {near:.4} within 8 ms, {stated:.4} within 2 sigma of {sigma_ms:.2} ms; {late_of_all} of {} late; \
             {lost_of_all} lost and counted",
            all.len()
        );
        assert!(near >= 0.95 && stated >= 0.95, "{near} {stated}");
        assert!(late_of_all < all.len() / 10, "{late_of_all} late");
        let clock = status.devices[device].clock.expect("its clock is known");
        assert!((1e-3..2e-2).contains(&clock.sigma_t_s), "{}", clock.sigma_t_s);
    }
    let (near, stated, _) = shares(&received);
    println!("the receiver: {near:.4} of {} within 8 ms, {stated:.4} within 2 sigma", received.len());
    assert!(near >= 0.95 && stated >= 0.95 && received.len() > 1000, "{near} {stated}");
    for tracker in FIRST_TRACKER..FIRST_STATION {
        // Nothing in its packets says what is missing: nothing is stated as counted.
        let counted = &status.sensors[tracker];
        assert!(counted.estimated || counted.missed == 0, "{}: {counted:?}", stage.sensors[tracker].name);
    }
    // Nobody else lost anything.
    for station in FIRST_STATION..FIRST_STATION + usize::from(STATIONS) {
        let (counted, name) = (&status.sensors[station], &stage.sensors[station].name);
        let before = &before.sensors[station];
        assert_eq!((counted.lost, counted.missed), (before.lost, before.missed), "{name}");
        assert!(!counted.estimated, "{name}");
    }
}
