//! Many boards and phones behind radios beside a device on a wire: each leaves in turn and costs the others nothing, what the radio loses is
//! counted as it is, and capture times are as good as they are said to be.

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

/// Devices of each kind, when the first of them leaves, for how long, and how far the next is behind it, s.
const COUNT: u16 = 10;
const FIRST_S: f64 = 6.0;
const AWAY_S: f64 = 3.0;
const TURN_S: f64 = 1.5;
/// Samples a second of boards and phones, and what their radios add at most, ms.
const RADIOS: [(f64, f64); 2] = [(100.0, 40.0), (60.0, 60.0)];
/// Trackers of the chain on a wire, which count.
const TRACKERS: u16 = 3;

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
    text += "[[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"/dev/none\"\nbaud = 921600\nrate_hz = 100.0\n";
    (1..=TRACKERS).for_each(|address| sensor(&mut text, "chain", address));
    toml::from_str(&text).unwrap()
}

/// Two per cent of a device's datagrams, and each of its units away in turn.
fn faults(rate_hz: f64, seconds: f64) -> Vec<Fault> {
    let count = (0.02 * rate_hz * f64::from(COUNT) * seconds) as u32;
    let lost = Fault::LostDatagrams(Bytes { count, start_s: 2.0, end_s: seconds });
    let leaves = |k: u16| Fault::BirdDies {
        address: k + 1,
        at_s: FIRST_S + TURN_S * f64::from(k),
        duration_s: Some(AWAY_S),
    };
    std::iter::once(lost).chain((0..COUNT).map(leaves)).collect()
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
            session: OpenImuSession::new(settings, Carrier::Envelopes { port: 0 }, &wanted).unwrap(),
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

    /// Errors and stated deviations of the capture times of the sensor at an address, s; and how many were late.
    fn errors(&self, address: u16, sensor: usize, rate_hz: f64) -> (Vec<(f64, f64)>, usize) {
        let (stamps, truth) = (&self.stamps[&address], &self.truth[&sensor]);
        let (mut errors, mut late) = (Vec::new(), 0);
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
            for (_, ticks, t_s, sigma_s, is_late) in life {
                if *is_late {
                    late += 1;
                } else {
                    errors.push((t_s - truth[first + cycle(*ticks)], *sigma_s));
                }
            }
        }
        (errors, late)
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
    let chain = DeviceScenario { name: "chain".into(), drift_ppm: 50.0, ..DeviceScenario::default() };
    let devices = vec![radio("boards", RADIOS[0]), radio("phones", RADIOS[1]), chain];
    let mut rig = Rig::new(&stage, &scene(5, QUIET, &names, devices));
    let mut mirrors = ["boards", "phones"].map(Mirror::new);
    let mut lost: BTreeMap<(usize, u16), u64> = BTreeMap::new();
    let (mut on_wire, mut wire_frames) = (0, 0);
    // All stream before the first of them leaves.
    let mut t_s = 5.0;
    rig.run_until(t_s);
    let before = rig.pipeline.status();
    while t_s < seconds {
        t_s = (t_s + 10.0).min(seconds);
        rig.run_until(t_s);
        mirrors.iter_mut().enumerate().for_each(|(index, mirror)| mirror.see(&rig, index));
        for (device, _, loss) in &rig.host.losses {
            *lost.entry((*device, loss.address.expect("of one sensor"))).or_default() += 1;
        }
        let chain = cycles(&rig, 2);
        let first = usize::from(2 * COUNT);
        for estimate in rig.estimates().filter(|estimate| estimate.t_valid.as_secs_f64() > 5.0) {
            let Some(measured) = estimate.sensors[first].measured else { continue };
            let t_s = measured.t_valid.as_secs_f64();
            let error_s = t_s - nearest(&chain, t_s).t.as_secs_f64();
            wire_frames += 1;
            on_wire += usize::from(error_s.abs() <= 1e-3);
        }
        rig.forget();
    }
    let status = rig.pipeline.status();
    assert!(
        on_wire as f64 >= 0.95 * wire_frames as f64,
        "{on_wire} of {wire_frames} on the wire within 1 ms"
    );
    for (device, (rate_hz, jitter_ms)) in RADIOS.into_iter().enumerate() {
        let (mut all, mut late_of_all) = (Vec::new(), 0);
        for address in 1..=COUNT {
            let at = device * usize::from(COUNT) + usize::from(address) - 1;
            let hit = lost.get(&(device, address)).copied().unwrap_or(0);
            // What the pipeline calls lost is also what came and could not be published: the session counts the radio's.
            let counted = mirrors[device].session.losses()[usize::from(address) - 1];
            // What is lost as the last thing before it leaves, or before the end, nobody can know.
            let name = &stage.sensors[at].name;
            assert!(
                (hit.saturating_sub(3)..=hit).contains(&counted.lost),
                "{name}: {} of {hit}",
                counted.lost
            );
            assert!(!counted.estimated, "{name}");
            let (errors, late) = mirrors[device].errors(address, at, rate_hz);
            all.extend(errors);
            late_of_all += late;
        }
        let share = |good: &dyn Fn(&(f64, f64)) -> bool| {
            all.iter().filter(|error| good(error)).count() as f64 / all.len() as f64
        };
        let within_8_ms = share(&|(error_s, _)| error_s.abs() <= 8e-3);
        let within_2_sigma = share(&|(error_s, sigma_s)| error_s.abs() <= 2.0 * sigma_s);
        let sigma_ms = 1e3 * all.iter().map(|(_, sigma_s)| sigma_s).sum::<f64>() / all.len() as f64;
        println!(
            "{device}: jitter {jitter_ms} ms, {within_8_ms:.4} within 8 ms, {within_2_sigma:.4} within 2 sigma of {sigma_ms:.2} ms; \
             {late_of_all} of {} late",
            all.len()
        );
        assert!(within_8_ms >= 0.95 && within_2_sigma >= 0.95, "{within_8_ms} {within_2_sigma}");
        assert!(late_of_all < all.len() / 10, "{late_of_all} late");
        let clock = status.devices[device].clock.expect("its clock is known");
        assert!((1e-3..2e-2).contains(&clock.sigma_t_s), "{}", clock.sigma_t_s);
    }
    // Nobody else lost anything.
    for tracker in 0..usize::from(TRACKERS) {
        let at = 2 * usize::from(COUNT) + tracker;
        assert_eq!(status.sensors[at].lost, before.sensors[at].lost, "{}", stage.sensors[at].name);
    }
}
