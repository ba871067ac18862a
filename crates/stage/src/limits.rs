//! The `[server.limits]` table: what one client, and all together, may take of the daemon.

use serde::{Deserialize, Serialize};

/// What one client of the websocket, the page and VRPN, and all of them together, may take.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Connections at a time; one more is refused (HTTP 503).
    #[schemars(range(min = 1, max = 65_536))]
    pub connections: usize,
    /// Connections at a time from one IPv4 address or one IPv6 network of 64 bits.
    #[schemars(range(min = 1, max = 65_536))]
    pub connections_per_address: usize,
    /// Connections at a time that have not yet shown that they may be here, those for the page among them; one more closes the oldest of the address that has most.
    #[schemars(range(min = 1, max = 65_536))]
    pub waiting: usize,
    /// New connections per second from one IPv4 address or one IPv6 network of 64 bits on average, each request of a page among them; more are closed unanswered. One that is cut for what it sent counts fifty.
    #[schemars(range(min = 1.0, max = 1e6))]
    pub connections_per_s: f64,
    /// New connections that may come from there at once.
    #[schemars(range(min = 16.0, max = 1e6))]
    pub connection_burst: f64,
    /// Bytes of a client's message; a larger one closes (1009).
    #[schemars(range(min = 1024, max = 67_108_864))]
    pub message_bytes: usize,
    /// Messages per second that a client may send on average; more closes (1008).
    #[schemars(range(min = 1.0, max = 1e6))]
    pub messages_per_s: f64,
    /// Messages that a client may send at once.
    #[schemars(range(min = 1.0, max = 1e6))]
    pub message_burst: f64,
    /// Messages per second that all clients of one IPv4 address or one IPv6 network of 64 bits may send on average; whose message is one more is closed (1008).
    #[schemars(range(min = 1.0, max = 1e6))]
    pub messages_per_s_per_address: f64,
    /// Messages that they may send at once.
    #[schemars(range(min = 1.0, max = 1e6))]
    pub message_burst_per_address: f64,
    /// Bytes per second that may come over a connection on average, whatever they are; more cuts it.
    #[schemars(range(min = 1024.0, max = 1e9))]
    pub bytes_per_s: f64,
    /// Bytes that may come over a connection at once.
    #[schemars(range(min = 65_536.0, max = 1e9))]
    pub byte_burst: f64,
    /// Data messages per topic that wait for a client with `drop: latest`; one more takes the oldest one's place.
    #[schemars(range(min = 1, max = 65_536))]
    pub latest_messages: usize,
    /// Data messages that wait for a client with `drop: queue`; one more takes the oldest one's place.
    #[schemars(range(min = 1, max = 1_048_576))]
    pub queue_messages: usize,
    /// Bytes that wait for a client, replies and events included; data messages give way.
    #[schemars(range(min = 65_536, max = 1_073_741_824))]
    pub queue_bytes: usize,
    /// Bytes that wait for all clients; each has its equal share, and no more than `queue_bytes`.
    #[schemars(range(min = 1_048_576))]
    pub all_queues_bytes: usize,
    /// Replies and events that wait for a client; more closes (1008).
    #[schemars(range(min = 16, max = 1_048_576))]
    pub lossless_messages: usize,
    /// Events that are kept for `resume`, ten minutes at most.
    #[schemars(range(min = 0, max = 1_048_576))]
    pub events: usize,
    /// Different choices of sensors, fields and encoding over all clients; one more is refused.
    #[schemars(range(min = 1, max = 65_536))]
    pub views: usize,
    /// Time for the TLS handshake, and again for the HTTP request, s.
    #[schemars(range(min = 0.01, max = 3600.0))]
    pub greeting_timeout_s: f64,
    /// Time between two pings, s.
    #[schemars(range(min = 0.01, max = 3600.0))]
    pub ping_interval_s: f64,
    /// A client that sends nothing for so long, not even the answer to a ping, is gone, s.
    #[schemars(range(min = 0.01, max = 86_400.0))]
    pub silence_timeout_s: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 512,
            connections_per_address: 256,
            waiting: 256,
            connections_per_s: 20.0,
            connection_burst: 400.0,
            message_bytes: 64 << 10,
            messages_per_s: 50.0,
            message_burst: 200.0,
            messages_per_s_per_address: 300.0,
            message_burst_per_address: 3000.0,
            bytes_per_s: 131_072.0,
            byte_burst: 524_288.0,
            latest_messages: 16,
            queue_messages: 4096,
            queue_bytes: 8 << 20,
            all_queues_bytes: 256 << 20,
            lossless_messages: 8192,
            events: 4096,
            views: 64,
            greeting_timeout_s: 5.0,
            ping_interval_s: 15.0,
            silence_timeout_s: 45.0,
        }
    }
}
