//! What has to be sent to a flock, given what it is and what is wanted.
//!
//! A plan is a list of actions that the session works off; nothing here has time or state.

use std::collections::VecDeque;

use posed_state::Plain;

use super::examine::{Findings, Unit};
use super::family::Family;
use super::settings::{Mode, Settings};
use super::wire::value::{self, parameter};
use super::wire::{BirdStatus, Command, Range, Scale, Shape, UnitStatus};

/// Quiet time on either side of auto-configuration, as the maker's guide says. Others wait twice as long; here
/// a question answered, with the birds running, shows that the unit is done.
const AUTO_CONFIG_QUIET_MS: u64 = 300;
/// Quiet time after the auto-configuration of a 3D Guidance unit.
const GUIDANCE_QUIET_MS: u64 = 600;
/// First revision that tells the serial numbers of sensors.
const SENSOR_SERIAL_SINCE: (u8, u8) = (3, 71);
/// Gap after a command that sets something.
const SET_GAP_MS: u64 = 10;
/// One thing to do.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) enum Action {
    /// Send, then keep quiet.
    Send {
        /// The bytes; none = only wait.
        bytes: Vec<u8>,
        /// Then wait.
        quiet_ms: u64,
    },
    /// Ask for the flock's status until all wanted birds run.
    AwaitRunning,
    /// Let the birds run; they need some quiet time.
    Run,
    /// Ask for the error code and tell it in words.
    ReadError,
    /// Ask for the measurement rate.
    ReadRate,
    /// Ask for the serial number of this bird's sensor; 0 for a stand-alone unit.
    ReadSerial(u8),
    /// Start the stream, or the polls.
    Start,
}

/// A plan with what follows from it.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Plan {
    /// What to do, in order.
    pub(super) actions: VecDeque<Action>,
    /// Sentences for the operator.
    pub(super) warnings: Vec<String>,
}

/// Full scale and quaternion sense of the records to come.
pub(super) fn scale(settings: &Settings, findings: &Findings) -> Scale {
    let found = if findings.extended_range() { Range::In144 } else { Range::In36 };
    Scale { range: settings.range_in.unwrap_or(found), quaternion_sense: settings.quaternion_sense }
}

/// Makes the plan.
///
/// # Errors
/// A sentence for the operator: what is there does not fit what is wanted.
pub(super) fn plan(settings: &Settings, wanted: &[u8], findings: &Findings) -> Result<Plan, String> {
    let mut plan = Plan { actions: VecDeque::new(), warnings: Vec::new() };
    let group = wanted != [0];
    check_fit(settings, wanted, findings, group, &mut plan.warnings)?;
    if settings.family == Family::Guidance {
        plan.actions = guidance(settings, wanted, findings);
        return Ok(plan);
    }
    let wanted_units: Vec<Unit> =
        findings.units.iter().copied().filter(|unit| wanted.contains(&unit.address)).collect();
    let running = |unit: &Unit| unit.status.has(UnitStatus::ACCESSIBLE | UnitStatus::RUNNING);
    let configured = findings.status.has(BirdStatus::INITIALISED) && wanted_units.iter().all(running);
    let send = |plan: &mut Plan, command: Command, to: Option<u8>, quiet_ms: u64| {
        plan.actions.push_back(Action::Send { bytes: command.to_bytes(to, findings.addressing), quiet_ms });
    };
    let change = |number: u8, data: &[u8]| Command::Change { parameter: number, data: data.to_vec() };

    if group && !configured {
        auto_configure(settings, findings, &mut plan);
    }
    if let Some(hz) = settings.measurement_rate_hz
        && (hz - findings.rate_hz).abs() > 0.01
    {
        let word = value::rate_word(hz).to_le_bytes();
        send(&mut plan, change(parameter::MEASUREMENT_RATE, &word), None, SET_GAP_MS);
        plan.actions.push_back(Action::ReadRate);
    }
    // Every bird that will speak in group mode gets the same shape, wanted or not: the order needs its length.
    let birds: Vec<Option<u8>> =
        if group { findings.sensors().into_iter().map(Some).collect() } else { vec![None] };
    for to in birds {
        send(&mut plan, Command::Format(settings.format), to, SET_GAP_MS);
        send(&mut plan, Command::Hemisphere(settings.hemisphere.bytes()), to, SET_GAP_MS);
        send(&mut plan, Command::ButtonMode(settings.button), to, SET_GAP_MS);
        if let Some(filters) = settings.filters {
            let word = filters.word().to_le_bytes();
            send(&mut plan, change(parameter::FILTER_STATUS, &word), to, SET_GAP_MS);
        }
        if let Some(word) = value::scaling_word(scale(settings, findings).range) {
            let word = word.to_le_bytes();
            send(&mut plan, change(parameter::POSITION_SCALING, &word), to, SET_GAP_MS);
        }
    }
    send(&mut plan, change(parameter::GROUP_MODE, &[u8::from(group)]), None, SET_GAP_MS);
    plan.actions.push_back(Action::ReadError);
    // Firmware that does not know the parameter gives no answer.
    if findings.revision >= SENSOR_SERIAL_SINCE {
        let there = findings.sensors();
        let birds = wanted.iter().filter(|address| there.contains(address));
        plan.actions.extend(birds.map(|&address| Action::ReadSerial(address)));
    }
    // Auto-configured birds run, and have said so.
    let auto_configured = group && !configured;
    let asleep = findings.status.has(BirdStatus::ASLEEP);
    if asleep || !(auto_configured || findings.status.has(BirdStatus::RUNNING)) {
        plan.actions.push_back(Action::Run);
    }
    if settings.mode == Mode::Stream {
        send(&mut plan, Command::ReportRate(settings.report_every_cycles), None, SET_GAP_MS);
    }
    plan.actions.push_back(Action::Start);
    Ok(plan)
}

/// The least that published drivers of 3D Guidance units send, and group mode, which gives each record its address.
fn guidance(settings: &Settings, wanted: &[u8], findings: &Findings) -> VecDeque<Action> {
    let mut actions = VecDeque::new();
    let mut send = |command: Command, to: Option<u8>, quiet_ms| {
        actions.push_back(Action::Send { bytes: command.to_bytes(to, findings.addressing), quiet_ms });
    };
    let change = |number: u8, data: &[u8]| Command::Change { parameter: number, data: data.to_vec() };
    send(change(parameter::FBB_AUTO_CONFIG, &[1]), None, GUIDANCE_QUIET_MS);
    let rate_hz = settings.measurement_rate_hz;
    if let Some(hz) = rate_hz {
        send(change(parameter::MEASUREMENT_RATE, &value::rate_word(hz).to_le_bytes()), None, SET_GAP_MS);
    }
    let range = u8::from(scale(settings, findings).range == Range::In72);
    send(change(parameter::POSITION_SCALING, &[range]), None, SET_GAP_MS);
    for address in findings.sensors() {
        send(Command::Format(settings.format), Some(address), SET_GAP_MS);
        send(Command::Hemisphere(settings.hemisphere.bytes()), Some(address), SET_GAP_MS);
    }
    send(change(parameter::GROUP_MODE, &[1]), None, SET_GAP_MS);
    actions.extend(rate_hz.map(|_| Action::ReadRate));
    actions.push_back(Action::ReadError);
    let there = findings.sensors();
    let present = wanted.iter().filter(|address| there.contains(address));
    actions.extend(present.map(|&address| Action::ReadSerial(address)));
    actions.extend([Action::Run, Action::Start]);
    actions
}

fn check_fit(
    settings: &Settings,
    wanted: &[u8],
    findings: &Findings,
    group: bool,
    warnings: &mut Vec<String>,
) -> Result<(), String> {
    let found = findings.units.iter().map(|unit| unit.address.to_string()).collect::<Vec<_>>().join(", ");
    let (family, model) = (settings.family, &findings.model);
    if family == Family::Guidance && !model.is_empty() && !Family::may_be_guidance(model) {
        return Err(format!(
            "the unit calls itself {model}: a Flock, which has no `family = \"3d-guidance\"`"
        ));
    }
    if family == Family::Guidance && findings.units.is_empty() {
        return Err("no sensor is plugged into the unit; plug one in, and wait until it is found".into());
    }
    if group && findings.stand_alone() && Family::may_be_guidance(model) {
        return Err(format!(
            "the unit calls itself {model} and lists no birds; of a trakSTAR or driveBAY set family = \"3d-guidance\""
        ));
    }
    if group && findings.stand_alone() {
        return Err(
            "the unit is switched to stand-alone (address 0); give its sensor address = 0, or set the \
                    unit's address switches 4 to 7"
                .into(),
        );
    }
    if !group && !findings.stand_alone() {
        return Err(format!(
            "the unit is part of a flock with addresses {found}; address 0 is a stand-alone unit"
        ));
    }
    if group {
        let usable = |address: &&u8| !findings.sensors().contains(*address);
        let missing: Vec<u8> = wanted.iter().filter(usable).copied().collect();
        let list = missing.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
        if missing.len() == wanted.len() {
            return Err(format!(
                "none of the wanted birds ({list}) is on the bus with a sensor; found {found}. Check the FLY switches, \
                 the bus cable, the address switches and the sensor plugs"
            ));
        }
        if !missing.is_empty() {
            warnings.push(format!(
                "bird {list} is not on the bus, or has no sensor; the others go on without it. Check its power, FLY switch, \
                 bus cable, address switches and sensor plug"
            ));
        }
    }
    if findings.extended_range() && settings.range_in.is_some_and(|range| range != Range::In144) {
        return Err(
            "the flock has an extended range controller, whose positions have a range of 144 inches; set \
                    range_in = 144 or leave it out"
                .into(),
        );
    }
    if !findings.extended_range() && settings.range_in == Some(Range::In144) {
        return Err("the flock has no extended range controller, so that its positions have a range of 36 or 72 inches; \
                    set range_in to one of them or leave it out"
            .into());
    }
    Ok(())
}

fn auto_configure(settings: &Settings, findings: &Findings, plan: &mut Plan) {
    let Plan { actions, warnings } = plan;
    let mut send = |command: Command, quiet_ms| {
        let bytes = command.to_bytes(None, findings.addressing);
        actions.push_back(Action::Send { bytes, quiet_ms });
    };
    let highest = findings.units.last().map_or(1, |unit| unit.address);
    let units = settings.units.unwrap_or(highest);
    if units > 1 {
        send(Command::FbbReset, AUTO_CONFIG_QUIET_MS);
    }
    let found = findings.units.iter().find_map(|unit| Some((unit.address, unit.status.transmitter()?)));
    let transmitter =
        settings.transmitter_address.map(|address| (address, settings.transmitter_number)).or(found);
    match transmitter.map(|(address, number)| (address, Command::next_transmitter(address, number))) {
        None | Some((1, Some(Command::NextTransmitter { number: 0, .. }))) => {}
        Some((_, Some(command))) => send(command, AUTO_CONFIG_QUIET_MS),
        // Cut to four bits, the address would be another unit's.
        Some((address, None)) => warnings.push(format!(
            "the transmitter is at unit {address}, and the command that chooses it has room for addresses up to 15; give its unit              such an address"
        )),
    }
    if units == 1 {
        actions.push_back(Action::Send { bytes: Vec::new(), quiet_ms: AUTO_CONFIG_QUIET_MS });
    }
    let command = Command::Change { parameter: parameter::FBB_AUTO_CONFIG, data: vec![units] };
    let bytes = command.to_bytes(None, findings.addressing);
    actions.push_back(Action::Send { bytes, quiet_ms: AUTO_CONFIG_QUIET_MS });
    actions.push_back(Action::AwaitRunning);
}

/// Rate of records per bird in Hz, and a warning where the line is too slow for every cycle.
///
/// A unit starts a cycle's records only when those of the one before are out, so a slow line divides the rate. `baud` is in bit/s;
/// 0: the line has no limit.
pub(super) fn record_rate_hz(
    settings: &Settings,
    measurement_rate_hz: f64,
    birds: &[(u8, Shape)],
    baud: u32,
) -> (f64, Option<String>) {
    let bytes: usize = birds.iter().map(|(_, shape)| shape.len()).sum();
    let requested_hz = measurement_rate_hz / f64::from(settings.report_every_cycles.cycles());
    let send_s = bytes as f64 * 10.0 / f64::from(baud);
    let load = send_s * requested_hz;
    if baud == 0 || load <= 1.0 {
        return (requested_hz, None);
    }
    let every = (send_s * measurement_rate_hz).ceil().max(f64::from(settings.report_every_cycles.cycles()));
    let rate_hz = measurement_rate_hz / every;
    let warning = format!(
        "{} birds with {bytes} bytes a cycle need {:.0} baud at {requested_hz:.1} Hz, and the line has {baud}: the unit \
         skips cycles and sends at {rate_hz:.1} Hz. Raise the baud rate, choose a shorter format, or report_every_cycles",
        birds.len(),
        bytes as f64 * 10.0 * requested_hz,
    );
    (rate_hz, Some(warning))
}
