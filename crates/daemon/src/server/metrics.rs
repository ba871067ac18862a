//! What `/metrics` says, in the text format of Prometheus.

use std::sync::Mutex;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};

use posed_protocol::{LinkState, Status};

/// Labels of a metric, as pairs.
type Labels = Vec<(&'static str, String)>;

/// All metrics of the daemon. Names start with `posed_`.
#[derive(Debug, Default)]
pub(super) struct Metrics {
    registry: Mutex<Registry>,
    pub(super) clients: Gauge,
    pub(super) frames: Counter,
    pub(super) bodies: Counter,
    pub(super) messages: Counter,
    pub(super) dropped: Counter,
    pub(super) bytes: Counter,
    pub(super) requests: Counter,
    pub(super) vrpn_clients: Gauge,
    pub(super) vrpn_dropped: Counter,
    pub(super) vmc_sent: Counter,
    pub(super) vmc_lost: Counter,
    pub(super) mvn_sent: Counter,
    pub(super) mvn_lost: Counter,
    pub(super) lsl_lost: Counter,
    refused: Family<Labels, Counter>,
    device_streaming: Family<Labels, Gauge>,
    device_records: Family<Labels, Gauge>,
    device_rejected: Family<Labels, Gauge>,
    device_bytes_skipped: Family<Labels, Gauge>,
    sensor_lost: Family<Labels, Gauge>,
    problems: Gauge,
    host_clock_synchronised: Gauge,
    host_clock_max_error: Gauge<f64, AtomicU64>,
    latency: Family<Labels, Gauge<f64, AtomicU64>>,
}

impl Metrics {
    pub(super) fn new() -> Self {
        let metrics = Self::default();
        {
            let mut all = Registry::with_prefix("posed");
            all.register("clients", "Connected websocket clients", metrics.clients.clone());
            all.register("frames", "Frames published", metrics.frames.clone());
            all.register("bodies", "Message bodies serialised", metrics.bodies.clone());
            all.register("messages", "Data messages queued for clients", metrics.messages.clone());
            all.register(
                "messages_dropped",
                "Data messages dropped for slow clients",
                metrics.dropped.clone(),
            );
            all.register_with_unit("sent", "Payload sent to clients", Unit::Bytes, metrics.bytes.clone());
            all.register("requests", "Messages received from clients", metrics.requests.clone());
            all.register("vrpn_clients", "Connected VRPN clients", metrics.vrpn_clients.clone());
            let dropped = metrics.vrpn_dropped.clone();
            all.register("vrpn_frames_dropped", "Frames dropped for slow VRPN clients", dropped);
            all.register("vmc_datagrams", "Datagrams sent to avatars", metrics.vmc_sent.clone());
            all.register("vmc_datagrams_lost", "Datagrams that could not be sent", metrics.vmc_lost.clone());
            let sent = "Datagrams of MVN's network stream sent";
            all.register("mvn_datagrams", sent, metrics.mvn_sent.clone());
            let lost = "Datagrams of MVN's network stream that could not be sent";
            all.register("mvn_datagrams_lost", lost, metrics.mvn_lost.clone());
            all.register(
                "lsl_samples_lost",
                "Samples that liblsl was too slow for",
                metrics.lsl_lost.clone(),
            );
            all.register("connections_refused", "Connections refused or cut", metrics.refused.clone());
            all.register("device_streaming", "1 while records come in", metrics.device_streaming.clone());
            all.register("device_records", "Records accepted", metrics.device_records.clone());
            all.register("device_rejected", "Records refused", metrics.device_rejected.clone());
            let skipped = metrics.device_bytes_skipped.clone();
            all.register("device_bytes_skipped", "Bytes of no record and no answer", skipped);
            all.register("sensor_lost", "Expected samples not published as ok", metrics.sensor_lost.clone());
            all.register("problems", "Problems named on the status topic", metrics.problems.clone());
            let synchronised = "1 while the computer's clock follows another by NTP or PTP";
            all.register("host_clock_synchronised", synchronised, metrics.host_clock_synchronised.clone());
            let most = "How far off the computer's clock may be at most";
            all.register_with_unit(
                "host_clock_max_error",
                most,
                Unit::Seconds,
                metrics.host_clock_max_error.clone(),
            );
            let latency = "How long a stage of the flow takes; of `segments` the processor time per frame";
            all.register_with_unit("latency", latency, Unit::Seconds, metrics.latency.clone());
            *metrics.registry.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = all;
        }
        metrics
    }

    /// Counts a connection that was refused or cut.
    pub(super) fn refuse(&self, reason: &'static str) {
        self.refused.get_or_create(&vec![("reason", reason.to_owned())]).inc();
    }

    /// Connections refused so far because there were too many, or too many new ones.
    pub(super) fn refused_over_limit(&self) -> u64 {
        let of = |reason: &str| self.refused.get_or_create(&vec![("reason", reason.to_owned())]).get();
        of("limit") + of("rate")
    }

    /// Takes over the numbers of a status.
    pub(super) fn take(&self, status: &Status) {
        for device in &status.devices {
            let labels = vec![("device", device.name.clone())];
            self.device_streaming.get_or_create(&labels).set((device.state == LinkState::Streaming).into());
            self.device_records.get_or_create(&labels).set(signed(device.records));
            self.device_rejected.get_or_create(&labels).set(signed(device.rejected));
            self.device_bytes_skipped.get_or_create(&labels).set(signed(device.bytes_skipped));
        }
        for sensor in &status.sensors {
            let labels = vec![("sensor", sensor.name.clone())];
            self.sensor_lost.get_or_create(&labels).set(signed(sensor.lost));
        }
        for stage in &status.latency {
            for (quantile, ms) in [("0.5", stage.p50_ms), ("0.99", stage.p99_ms), ("1", stage.max_ms)] {
                let labels = vec![("stage", stage.stage.clone()), ("quantile", quantile.to_owned())];
                self.latency.get_or_create(&labels).set(ms * 1e-3);
            }
        }
        if let Some(clock) = &status.host_clock {
            self.host_clock_synchronised.set(clock.synchronised.into());
            self.host_clock_max_error.set(clock.max_error_s);
        }
        self.problems.set(signed(status.problems.len() as u64));
    }

    /// The text.
    pub(super) fn text(&self) -> String {
        let mut text = String::new();
        let registry = self.registry.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        // Writing to a String cannot fail.
        let _ = encode(&mut text, &registry);
        text
    }
}

fn signed(count: u64) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}
