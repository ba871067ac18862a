//! What goes wrong on a stage, and what others do to it: faults of devices and lines, and entries that nobody expects.

use posed_drivers::LineEvent;
use posed_simulator::faults::{Bytes, Fault};
use posed_stage::input::{Input, Model, Plan as Sets, Request};

use crate::device::Device;
use crate::dice::Dice;
use crate::models;

/// Before it no fault begins: devices are set up.
pub(crate) const LEAD_S: f64 = 5.0;

/// What happens to a stage beside what its devices do.
#[derive(Clone, Debug)]
pub(crate) enum Event {
    /// An entry of the log.
    Input(Input),
    /// The pipeline panics at the next entries, so many.
    Panic(u8),
    /// A snapshot is taken, and what is restored from it runs beside the original from then on.
    Snapshot,
}

/// A moment of trouble: when it begins, and how long it may last, s.
pub(crate) fn moment(dice: &mut Dice, trouble_s: f64) -> (f64, f64) {
    let at_s = dice.range(LEAD_S, LEAD_S + trouble_s - 0.5);
    (at_s, dice.log_range(0.02, LEAD_S + trouble_s - at_s))
}

/// A fault of a device or its line.
pub(crate) fn fault(dice: &mut Dice, device: &Device, trouble_s: f64) -> Fault {
    let (at_s, duration_s) = moment(dice, trouble_s);
    let address = *dice.pick(&device.addresses);
    let bytes = Bytes { count: 1 + dice.below(40) as u32, start_s: at_s, end_s: at_s + duration_s };
    let lasting = Some(duration_s);
    match dice.below(if device.port.starts_with("udp") { 24 } else { 20 }) {
        0 => Fault::LostBytes(bytes),
        1 => Fault::InsertedBytes(bytes),
        2 => Fault::Bit7Flips(bytes),
        3 => Fault::DataBitFlips(bytes),
        4 => Fault::Bursts { start_s: at_s, end_s: at_s + duration_s, burst_ms: dice.range(1.0, 64.0) },
        5 => Fault::Unplug { at_s, duration_s: lasting, power: dice.chance(0.5) },
        6 => Fault::PhaseCut { at_s },
        7 => Fault::Stall { at_s, duration_s: duration_s.min(4.0) },
        8 => Fault::PowerCycle { at_s },
        9 => Fault::BirdDies { address, at_s, duration_s: lasting },
        10 => Fault::HemisphereFlip { address, at_s, duration_s },
        11 => Fault::OutOfRange { address, at_s, duration_s },
        12 => Fault::BadMatrix { address, at_s, duration_s },
        13 => {
            let [code, detail] = [dice.below(40) as u8, dice.below(16) as u8];
            Fault::Error { address, at_s, code, detail }
        }
        14 => Fault::CounterRestart { at_s },
        15 => Fault::LostPeriods { at_s, count: 1 + dice.below(40) as u32 },
        // Nobody sets it up anew.
        16 => Fault::WrongOutput {
            at_s,
            duration_s: lasting.filter(|_| device.kind.is_left_alone() || dice.chance(0.7)),
        },
        17 => Fault::LowBattery { address, at_s },
        18 => Fault::Unplug { at_s, duration_s: lasting, power: false },
        19 => Fault::LostBytes(Bytes { count: 200, ..bytes }),
        20 => Fault::LostDatagrams(bytes),
        21 => Fault::DuplicatedDatagrams(bytes),
        22 => Fault::ReorderedDatagrams(bytes),
        _ if dice.chance(0.5) => Fault::DelayedDatagrams { at_s, duration_s },
        _ => Fault::AddressChange { address, at_s },
    }
}

/// What a client, a stranger or the system does.
pub(crate) fn event(dice: &mut Dice, devices: &[Device], sensors: &[String]) -> Event {
    let device = dice.below(devices.len()) as u16;
    let sensor = || sensors[0].clone();
    let input = match dice.below(12) {
        0 | 1 => return Event::Snapshot,
        2 => {
            let count = 1 + dice.below(60);
            Input::Bytes { device, bytes: dice.bytes(count) }
        }
        3 => {
            let event = LineEvent::Dropped { bytes: dice.below(2000) as u64 };
            Input::Line { device, event }
        }
        4 => Input::Line {
            device: if dice.chance(0.1) { 999 } else { device },
            event: LineEvent::Opened { modem_lines: devices[usize::from(device)].modem_lines },
        },
        5 => Input::Timer,
        6 => Input::Request(Request::FieldStart {
            sensors: sensors.iter().take(1 + dice.below(4)).cloned().collect(),
            spacing_m: *dice.pick(&[0.1, 0.3, f64::NAN, -1.0, 1e300]),
        }),
        7 => Input::Request(Request::FieldFinish {}),
        8 => {
            let exercises = if dice.chance(0.7) { vec!["wave".to_owned()] } else { Vec::new() };
            let plan = Sets {
                repetitions: Some(dice.below(20) as u32),
                sets: dice.chance(0.5).then_some(2),
                rest_s: *dice.pick(&[0.0, 1.0, 4000.0, f64::NAN]),
            };
            let subject = format!("subject {}", dice.below(80));
            Input::Request(Request::ExerciseSelect {
                subject,
                exercises,
                plan,
                sensors: Default::default(),
                body: None,
            })
        }
        9 => Input::Model(Model::Exercise { exercise: Box::new(models::wave(&sensor(), dice)) }),
        10 => Input::Model(models::numbers(dice, &format!("d{device}"), &sensor())),
        _ => Input::SegmentationNetwork(dice.bytes(200)),
    };
    Event::Input(input)
}
