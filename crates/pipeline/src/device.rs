//! One device: its session, its clocks, and who its sensors are.

use posed_drivers::{Condition, Loss, State};
use posed_state::Plain;

use super::sensor::Sensor;
use super::session::DeviceSession;
use super::source::Source;
use super::{ClockStatus, DeviceStatus, PipelineError};
use crate::clock;
use posed_stage::input::{DeviceIndex, SensorIndex};
use posed_stage::{Stage, TimeBase};

/// Bits of one byte on a serial line: start, eight, stop.
const BITS_PER_BYTE: f64 = 10.0;

/// Index of a [`Source`] in the pipeline's list: what frames know as a device.
pub(super) type SourceIndex = u16;

/// A sensor of the stage file on this device.
#[derive(Clone, Copy, Debug, Plain)]
pub(super) struct SensorRoute {
    pub(super) address: u16,
    pub(super) sensor: SensorIndex,
    pub(super) source: SourceIndex,
}

#[derive(Clone, Debug, posed_state::State)]
pub(super) struct Device {
    #[state(same)]
    pub(super) name: String,
    pub(super) session: DeviceSession,
    /// By address.
    #[state(keep)]
    pub(super) sensors: Vec<SensorRoute>,
    /// Whether some sensor is identified by its serial number.
    #[state(keep)]
    by_serial: bool,
    /// Its sources in the pipeline's list: from here on, so many.
    #[state(keep)]
    pub(super) first_source: SourceIndex,
    #[state(keep)]
    pub(super) sources: u16,
    pub(super) streaming: bool,
}

/// Where the samples of an address go.
#[derive(Clone, Copy, Debug)]
pub(super) struct Route {
    /// Nobody in the stage file has this address.
    pub(super) sensor: Option<SensorIndex>,
    pub(super) source: SourceIndex,
}

impl Device {
    /// The device at `index` of the stage, whose sources are appended to `sources`.
    pub(super) fn new(
        stage: &Stage,
        index: usize,
        owners: &[DeviceIndex],
        sources: &mut Vec<Source>,
    ) -> Result<Self, PipelineError> {
        let device = &stage.devices[index];
        let value =
            |ok: bool, key, expected| if ok { Ok(()) } else { Err(PipelineError::Value { key, expected }) };
        value(device.baud > 0, "baud", "a line rate above 0")?;
        let delay_s = device.measurement_delay_ms * 1e-3;
        value((0.0..=1.0).contains(&delay_s), "measurement_delay_ms", "0 to 1000")?;
        let settings = clock::Settings {
            byte_time_s: device
                .driver
                .line_baud(&device.port, device.baud)
                .map_or(0.0, |baud| BITS_PER_BYTE / f64::from(baud)),
            measurement_delay_s: delay_s + device.driver.delay_s(),
        };
        let first_source = sources.len() as SourceIndex;
        let mut bases: Vec<TimeBase> = Vec::new();
        let mut source_of = |address: u16| {
            let base = device.driver.time_base(address);
            let at = bases.iter().position(|known| *known == base).unwrap_or_else(|| {
                bases.push(base);
                sources.push(Source::new(base, settings));
                bases.len() - 1
            });
            first_source + at as SourceIndex
        };
        let mine = (0..)
            .zip(stage.sensors.iter().zip(owners))
            .filter(|(_, (_, owner))| usize::from(**owner) == index)
            .map(|(at, (sensor, _))| (sensor, at));
        let mut by_serial = false;
        let mut sensors: Vec<SensorRoute> = mine
            .map(|(sensor, at)| {
                by_serial |= sensor.serial.is_some();
                let address = sensor.address;
                SensorRoute { address, sensor: at, source: source_of(address) }
            })
            .collect();
        if sensors.is_empty() {
            source_of(0);
        }
        sensors.sort_unstable_by_key(|placed| placed.address);
        let wanted: Vec<u16> = sensors.iter().map(|placed| placed.address).collect();
        let session = DeviceSession::new(device, &wanted, stage.server.port_for_others())
            .map_err(|source| PipelineError::Settings { device: device.name.clone(), source })?;
        let count = bases.len() as u16;
        let name = device.name.clone();
        Ok(Self { name, session, sensors, by_serial, first_source, sources: count, streaming: false })
    }

    pub(super) fn source_range(&self) -> std::ops::Range<usize> {
        let first = usize::from(self.first_source);
        first..first + usize::from(self.sources)
    }

    /// Where a sample belongs: by the unit's serial number where the stage file asks for one, else by its address.
    pub(super) fn route(&self, address: u16, all: &[Sensor]) -> Route {
        let placed = self.placed(address, all);
        Route {
            sensor: placed.map(|placed| placed.sensor),
            source: placed.map_or(self.first_source, |placed| placed.source),
        }
    }

    fn placed(&self, address: u16, all: &[Sensor]) -> Option<SensorRoute> {
        let at_address = || {
            let at = self.sensors.binary_search_by_key(&address, |placed| placed.address).ok()?;
            Some(self.sensors[at])
        };
        if !self.by_serial {
            return at_address();
        }
        let info = self.session.get().sensors().iter().find(|info| info.address == address);
        let serial = info.and_then(|info| info.serial.as_deref());
        let wanted = |placed: &SensorRoute| all[usize::from(placed.sensor)].serial();
        let same = self.sensors.iter().find(|placed| serial.is_some() && wanted(placed) == serial);
        same.copied().or_else(|| at_address().filter(|placed| wanted(placed).is_none()))
    }

    /// Who answers at an address: the serial number that the device reports, else that of the stage file, else the sensor's name.
    pub(super) fn unit<'a>(&'a self, address: u16, sensor: &'a Sensor) -> &'a str {
        let info = self.session.get().sensors().iter().find(|info| info.address == address);
        info.and_then(|info| info.serial.as_deref()).or(sensor.serial()).unwrap_or(sensor.name())
    }

    /// What the device itself knows to be lost of a sensor; `None` where only frames can tell.
    pub(super) fn counted(&self, sensor: SensorIndex, all: &[Sensor]) -> Option<Loss> {
        if !self.session.counts_losses() {
            return None;
        }
        let losses = self.session.get().losses();
        let found = losses.iter().find(|loss| self.route(loss.address, all).sensor == Some(sensor));
        Some(found.copied().unwrap_or_default())
    }

    /// What a sensor reports of itself; nothing where its device does not.
    pub(super) fn condition(&self, sensor: SensorIndex, all: &[Sensor]) -> Condition {
        let conditions = self.session.get().conditions();
        let found = conditions.iter().find(|known| self.route(known.address, all).sensor == Some(sensor));
        found.copied().unwrap_or_default()
    }

    pub(super) fn status(&self, sources: &[Source]) -> DeviceStatus {
        let session = self.session.get();
        // Units with clocks of their own: the first that is known speaks for all.
        let clocks = sources[self.source_range()].iter();
        let mut known = clocks.filter_map(|source| Some((source.period_s()?, source.sigma_t_s()?)));
        let clock = known.next().filter(|_| self.streaming);
        DeviceStatus {
            state: session.state().clone(),
            rate_hz: clock.map(|(period_s, _)| period_s.recip()),
            counters: session.counters(),
            clock: clock.map(|(period_s, sigma_t_s)| ClockStatus { period_s, sigma_t_s }),
            found: session.found().to_vec(),
        }
    }

    /// Whether it has just begun or ended to stream.
    pub(super) fn turned(&mut self) -> Option<bool> {
        let streaming = *self.session.get().state() == State::Streaming;
        let before = std::mem::replace(&mut self.streaming, streaming);
        (streaming != before).then_some(streaming)
    }
}

/// Index of a sensor's device.
pub(super) fn owner(stage: &Stage, sensor: &posed_stage::Sensor) -> Result<DeviceIndex, PipelineError> {
    let found = stage.devices.iter().position(|device| device.name == sensor.device);
    found.map(|index| index as DeviceIndex).ok_or_else(|| PipelineError::UnknownDevice {
        sensor: sensor.name.clone(),
        device: sensor.device.clone(),
    })
}
