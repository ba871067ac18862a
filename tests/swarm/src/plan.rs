//! What a seed means: a stage, what is simulated in its devices' place, and what happens to it.
//!
//! In: a seed, and which of its parts to leave out. Out: a [`Plan`]. A part is one setting, one fault or one event; all have
//! chance of their own, so that any may be left out and the others stay as they are: that is how a failing seed is made small.

use posed_simulator::faults::Fault;
use posed_simulator::inertial::ImuClass;
use posed_simulator::motion::{Motion, Orbit, Still};
use posed_simulator::scenario::{BodySpec, Scenario, SensorScenario};
use posed_stage::input::Input;

use crate::device::{Device, Honesty, Kind, device};
use crate::dice::Dice;
use crate::settings::{self, Setting};
use crate::trouble::{Event, LEAD_S, event, fault, moment};

/// Least time from the first fault to the end of the last.
const TROUBLE_S: f64 = 2.0;
/// After the last fault, for all to be as it was.
pub(crate) const CALM_S: f64 = 16.0;

/// What bytes that were damaged without a sign do to a filter is gone so long afterwards, s.
pub(crate) const BLIND_S: f64 = 8.0;
/// So long before it is read a record may have been measured, s.
const ON_ITS_WAY_S: f64 = 0.1;
/// Longest time between two reports of a device, s.
const REPORT_S: f64 = 0.5;
/// Reports a second that a device sends if it is often heard.
const SELDOM_HZ: f64 = 4.0;

/// A host that is late with its reads now and then.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sleep {
    pub(crate) share: f64,
    pub(crate) longest_s: f64,
}

/// A time of one device, s.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    pub(crate) device: usize,
    pub(crate) from_s: f64,
    pub(crate) until_s: f64,
}

impl Span {
    pub(crate) fn holds(&self, device: usize, t_s: f64) -> bool {
        self.device == device && (self.from_s..self.until_s).contains(&t_s)
    }
}

/// All that a seed says.
pub(crate) struct Plan {
    pub(crate) stage_toml: String,
    pub(crate) scenario: Scenario,
    pub(crate) devices: Vec<Honesty>,
    /// Nobody can tell damaged bytes from good ones.
    pub(crate) blind: Vec<Span>,
    /// A sensor is on the other side of its transmitter.
    pub(crate) flips: Vec<Span>,
    /// Rising in time.
    pub(crate) events: Vec<(f64, Event)>,
    pub(crate) sleep: Option<Sleep>,
    /// Whether the operating system knows when bytes came.
    pub(crate) modem_lines: Vec<bool>,
    /// When all faults and events are over, s.
    pub(crate) calm_from_s: f64,
    pub(crate) end_s: f64,
    /// A sensor whose values are to be printed.
    pub(crate) traced: Option<String>,
    /// Numbers of the parts, each of which may be left out.
    pub(crate) numbers: Vec<usize>,
    /// A line of each for a reader.
    pub(crate) parts: Vec<String>,
}

enum Part {
    /// A key of the stage file's top.
    Top(&'static str, toml::Value),
    Setting(usize, Setting),
    Fault(usize, Fault),
    Event(f64, Event),
    Sleep(Sleep),
}

impl Part {
    fn words(&self) -> String {
        match self {
            Self::Top(key, value) => format!("{key} = {value}"),
            Self::Setting(device, Setting { key, value }) => format!("d{device}: {key} = {value}"),
            Self::Fault(device, fault) => {
                format!("d{device}: {}", serde_json::to_string(fault).unwrap_or_default())
            }
            Self::Event(t_s, event) => {
                let text = format!("{event:?}");
                format!("{t_s:.3} s: {}", text.chars().take(120).collect::<String>())
            }
            Self::Sleep(sleep) => format!("{sleep:?}"),
        }
    }
}

fn top(dice: &mut Dice, sensors: &[String]) -> Part {
    match dice.below(4) {
        0 => Part::Top("frame_rate_hz", dice.log_range(5.0, 500.0).into()),
        1 => Part::Top("frame_wait_ms", dice.log_range(0.01, 200.0).into()),
        2 => {
            let mut keyframes = toml::Table::new();
            keyframes.insert("sensors".into(), vec![sensors[0].clone()].into());
            keyframes.insert("window_frames".into(), (2 + dice.below(60) as i64).into());
            Part::Top("keyframes", keyframes.into())
        }
        _ => {
            let mut faults = toml::Table::new();
            faults.insert("repair".into(), dice.chance(0.5).into());
            Part::Top("faults", faults.into())
        }
    }
}

/// How a sensor moves: a hand before the transmitter, or nothing that moves.
fn motion(dice: &mut Dice, magnetic: bool, may_rest: bool) -> Motion {
    let wxyz: [f64; 4] = std::array::from_fn(|_| dice.range(-1.0, 1.0));
    let norm = wxyz.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-3);
    let orientation_wxyz = if norm < 0.1 { [1.0, 0.0, 0.0, 0.0] } else { wxyz.map(|x| x / norm) };
    let center_m = [dice.range(0.45, 0.6), dice.range(-0.1, 0.1), dice.range(-0.1, 0.1)];
    if dice.chance(0.15) && may_rest {
        return Motion::Still(Still { position_m: center_m, orientation_wxyz });
    }
    // An IMU feels the acceleration: as a limb's, not a shaker's.
    let fastest_s = if magnetic { 1.8 } else { 3.0 };
    Motion::Orbit(Orbit {
        center_m,
        radius_m: [dice.range(0.0, 0.2), dice.range(0.0, 0.22), dice.range(0.0, 0.12)],
        phase_deg: dice.range(0.0, 360.0),
        period_s: dice.log_range(fastest_s, 10.0),
        orientation_wxyz,
        turn_deg: [dice.range(0.0, 40.0), dice.range(0.0, 40.0), dice.range(0.0, 80.0)],
        turn_period_s: dice.log_range(fastest_s, 10.0),
        ..Orbit::default()
    })
}

/// Who is on the stage: what no part of the seed changes.
struct Cast {
    devices: Vec<Device>,
    delays_ms: Vec<f64>,
    sigma_signal_per_m3: f64,
    bodies: Vec<BodySpec>,
    sensors: Vec<SensorScenario>,
}

impl Cast {
    fn draw(dice: &mut Dice) -> Self {
        let count = *dice.pick(&[1, 1, 1, 2, 2, 3, 4]);
        let devices: Vec<Device> = (0..count).map(|at| device(dice, at)).collect();
        let sigma_signal_per_m3 = dice.log_range(5e-5, 1e-3);
        let (mut bodies, mut sensors) = (Vec::new(), Vec::new());
        for (at, device) in devices.iter().enumerate() {
            // Where there is no noise, nobody can tell what rests from what repeats itself.
            let may_rest = match device.kind {
                Kind::SlimeVr => false,
                kind if kind.is_magnetic() => sigma_signal_per_m3 > 3e-4,
                _ => device.behaviour.imu != ImuClass::Ideal,
            };
            for &address in &device.addresses {
                let name = sensor_name(at, address);
                let body = format!("body of {name}");
                let motion = motion(dice, device.kind.is_magnetic(), may_rest);
                bodies.push(BodySpec { name: body.clone(), motion });
                sensors.push(SensorScenario {
                    name,
                    body,
                    segment: None,
                    offset_m: [0.0; 3],
                    mount_quat_wxyz: [1.0, 0.0, 0.0, 0.0],
                });
            }
        }
        let delay_ms = |_: &Device| if dice.chance(0.3) { dice.range(0.0, 20.0) } else { 0.0 };
        let delays_ms = devices.iter().map(delay_ms).collect();
        Self { devices, delays_ms, sigma_signal_per_m3, bodies, sensors }
    }

    fn sensor_rows(&self) -> Vec<toml::Table> {
        let devices = self.devices.iter().enumerate();
        let owned =
            devices.flat_map(|(at, device)| device.addresses.iter().map(move |&address| (at, address)));
        let rows = owned.map(|(at, address)| {
            let mut row = toml::Table::new();
            row.insert("name".into(), sensor_name(at, address).into());
            row.insert("device".into(), format!("d{at}").into());
            row.insert("address".into(), i64::from(address).into());
            row
        });
        rows.collect()
    }
}

fn sensor_name(device: usize, address: u16) -> String {
    format!("s{device}-{address}")
}

/// What the seed says, without these of its parts.
pub(crate) fn plan(seed: u64, minutes: f64, without: &[usize]) -> Plan {
    let trouble_s = (minutes * 60.0 - LEAD_S - CALM_S).max(TROUBLE_S);
    let mut dice = Dice::new(seed, 0);
    let cast = Cast::draw(&mut dice);
    let parts = parts(seed, &mut dice, &cast, trouble_s);
    let devices = &cast.devices;
    let mut tables: Vec<toml::Table> = (0..)
        .zip(devices)
        .zip(&cast.delays_ms)
        .map(|((at, device), &delay_ms)| device.table(at, delay_ms))
        .collect();
    let mut stage = toml::Table::new();
    stage.insert("name".into(), format!("seed {seed}").into());
    stage.insert("sensor".into(), cast.sensor_rows().into());
    let mut plan = Plan {
        stage_toml: String::new(),
        scenario: Scenario {
            seed,
            sigma_signal_per_m3: cast.sigma_signal_per_m3,
            devices: devices.iter().map(|device| device.behaviour.clone()).collect(),
            ..Scenario::default()
        },
        devices: vec![Honesty { judged: true, returns: true, seldom: false }; devices.len()],
        blind: Vec::new(),
        flips: Vec::new(),
        events: Vec::new(),
        sleep: None,
        modem_lines: devices.iter().map(|device| device.modem_lines).collect(),
        calm_from_s: LEAD_S,
        end_s: 0.0,
        traced: None,
        numbers: Vec::new(),
        parts: Vec::new(),
    };
    for (number, part) in parts.into_iter().enumerate() {
        if without.contains(&number) {
            continue;
        }
        plan.parts.push(format!("{number}: {}", part.words()));
        plan.numbers.push(number);
        match part {
            Part::Top(key, value) => drop(stage.insert(key.into(), value)),
            Part::Setting(device, setting) => {
                let said = devices[device].kind.honesty(&setting);
                plan.devices[device].judged &= said.judged;
                plan.devices[device].returns &= said.returns;
                plan.devices[device].seldom |= said.seldom;
                tables[device].insert(setting.key, setting.value);
            }
            Part::Fault(device, fault) => plan.suffers(device, devices[device].kind, fault),
            Part::Event(t_s, event) => plan.meets(t_s, event),
            Part::Sleep(sleep) => plan.sleep = Some(sleep),
        }
    }
    for ((table, device), honesty) in tables.iter().zip(devices).zip(&mut plan.devices) {
        let set_hz = table.get("measurement_rate_hz").and_then(toml::Value::as_float);
        let measured_hz = set_hz.unwrap_or(device.behaviour.rate_hz);
        let every = table.get("report_every_cycles").and_then(toml::Value::as_integer).unwrap_or(1);
        // So seldom that nothing tells for how long the first reads of a line have waited; such a device is hardly ever good, since a
        // pose is kept for half a second.
        let often = measured_hz / every as f64 > SELDOM_HZ;
        honesty.judged &= often;
        honesty.returns &= often;
    }
    plan.events.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    plan.end_s = plan.calm_from_s + CALM_S;
    stage.insert("device".into(), tables.into());
    plan.stage_toml = toml::to_string(&stage).expect("a table");
    (plan.scenario.bodies, plan.scenario.sensors) = (cast.bodies, cast.sensors);
    plan
}

impl Plan {
    fn suffers(&mut self, device: usize, kind: Kind, fault: Fault) {
        let (start_s, end_s) = fault.span_s();
        if kind.cannot_see(&fault) {
            self.blind.push(Span { device, from_s: start_s - ON_ITS_WAY_S, until_s: end_s + BLIND_S });
        }
        if matches!(fault, Fault::OutOfRange { .. }) {
            // What it measured last may be new to the host, and comes with the next report.
            self.blind.push(Span { device, from_s: start_s, until_s: start_s + REPORT_S });
        }
        if matches!(fault, Fault::HemisphereFlip { .. }) {
            self.flips.push(Span { device, from_s: start_s, until_s: end_s + ON_ITS_WAY_S });
        }
        if kind == Kind::Xbus && matches!(fault, Fault::BirdDies { .. }) {
            // A chain is searched when its port opens, and a tracker that has come back is not found before.
            self.devices[device].returns = false;
        }
        self.calm_from_s = self.calm_from_s.max(if end_s.is_finite() { end_s } else { start_s });
        self.scenario.devices[device].faults.push(fault);
    }

    fn meets(&mut self, t_s: f64, event: Event) {
        self.calm_from_s = self.calm_from_s.max(t_s);
        if let Event::Input(Input::Bytes { device, .. }) = &event {
            let device = usize::from(*device);
            self.blind.push(Span { device, from_s: t_s - ON_ITS_WAY_S, until_s: t_s + BLIND_S });
        }
        self.events.push((t_s, event));
    }
}

fn parts(seed: u64, dice: &mut Dice, cast: &Cast, trouble_s: f64) -> Vec<Part> {
    let devices = &cast.devices;
    let sensors: Vec<String> = cast.sensors.iter().map(|sensor| sensor.name.clone()).collect();
    let mut parts = Vec::new();
    for (at, device) in devices.iter().enumerate() {
        let settings = settings::draw(dice, &device.kind.schema());
        parts.extend(settings.into_iter().map(|setting| Part::Setting(at, setting)));
    }
    let faults = *dice.pick(&[0, 1, 1, 2, 3, 5, 8]);
    let events = *dice.pick(&[0, 0, 1, 2, 4, 8]);
    let tops = *dice.pick(&[0, 0, 0, 1, 2]);
    let mut stream = 1;
    let mut own = || {
        stream += 1;
        Dice::new(seed, stream)
    };
    parts.extend((0..faults).map(|_| {
        let mut dice = own();
        let at = dice.below(devices.len());
        Part::Fault(at, fault(&mut dice, &devices[at], trouble_s))
    }));
    parts.extend((0..events).map(|_| {
        let mut dice = own();
        let (t_s, _) = moment(&mut dice, trouble_s);
        Part::Event(t_s, event(&mut dice, devices, &sensors))
    }));
    parts.extend((0..tops).map(|_| top(&mut own(), &sensors)));
    let mut dice = own();
    if dice.chance(0.3) {
        let longest_s = dice.log_range(0.005, 0.4);
        parts.push(Part::Sleep(Sleep { share: dice.log_range(1e-5, 0.001), longest_s }));
    }
    let mut dice = own();
    for _ in 0..*dice.pick(&[0, 0, 0, 0, 1, 1, 2, 5]) {
        let (t_s, _) = moment(&mut dice, trouble_s);
        // Twice in a row, and it begins anew: three times then is as often as it bears.
        parts.push(Part::Event(t_s, Event::Panic(*dice.pick(&[1, 1, 1, 2, 3]))));
    }
    parts
}
