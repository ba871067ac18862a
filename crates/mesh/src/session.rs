//! A zenoh session as stages and hubs need it: TCP and TLS only, nothing looked for by itself, broken links noticed and repaired quickly.

use std::thread::JoinHandle;

use serde_json::json;
use zenoh::{Config, Session, Wait};

use posed_stage::{Secret, Zenoh, ZenohTls};

/// A link that has brought nothing for so long is given up, ms. Short, because TCP alone would send again only many seconds after
/// a long cut is repaired; four signs of life fit in, so that loss does not end a link.
const LEASE_MS: u32 = 2000;
/// Time of one attempt to open a link, in round trips: TCP's one and zenoh's two, with room for a packet that is sent again. An attempt
/// that began in a cut must not outlast it by much.
const OPEN_ROUND_TRIPS: f64 = 5.0;
/// The least, ms: sending again takes 200 ms on any link.
const OPEN_MS: f64 = 500.0;
/// Who is connected to has time, ms: it does not know how far away the other one is.
const ACCEPT_MS: u32 = 10_000;
/// Distance of two attempts, ms.
const RETRY_MS: u32 = 100;
/// Longest wait for room in zenoh's queue before a link is given up, microseconds.
const BLOCKED_US: u32 = 1_000_000;
/// Largest message that is taken in, bytes.
const MESSAGE_BYTES: u32 = 64 << 20;

/// Why a stage is not on zenoh.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The stage file cannot be written without what is nobody else's business.
    #[error("{0}")]
    Stage(String),
    /// An address does not serve.
    #[error("[zenoh]: cannot begin (listening on {ends:?}): {error}")]
    Open {
        /// Addresses to listen on, joined by commas.
        ends: String,
        /// What zenoh said.
        error: zenoh::Error,
    },
    /// Something else that zenoh said.
    #[error("[zenoh]: {0}")]
    Zenoh(#[from] zenoh::Error),
    /// It has panicked.
    #[error("[zenoh]: zenoh has crashed at its start")]
    Crashed,
    /// A thread could not be made.
    #[error("the system gives no thread for zenoh: {0}")]
    Thread(std::io::Error),
}

/// Which end of it a session is. A router between them passes on what is for another region, and nothing within one: stages do not see each
/// other, and all hubs see all stages.
#[derive(Clone, Copy, Debug)]
pub(crate) enum End {
    Stage,
    Hub,
}

impl End {
    fn region(self) -> &'static str {
        match self {
            Self::Stage => "posed-stage",
            Self::Hub => "posed-hub",
        }
    }
}

/// Opens a session; blocks for a moment, and must not be called on a tokio thread.
pub(crate) fn open(settings: &Zenoh, end: End) -> Result<Session, LinkError> {
    let config = config(settings, end)?;
    let ends = settings.listen.join(", ");
    zenoh::open(config).wait().map_err(|error| LinkError::Open { ends, error })
}

/// Opens the session of a client of a router, in this time; blocks meanwhile. A router that goes is connected to again when it comes.
pub(crate) fn open_client(routers: &[String], within_ms: u32) -> zenoh::Result<Session> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", serde_json::to_string(routers)?),
        ("connect/timeout_ms", within_ms.to_string()),
        ("connect/exit_on_failure", "true".to_owned()),
        ("connect/retry", retry()),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("transport/link/rx/max_message_size", MESSAGE_BYTES.to_string()),
    ] {
        config.insert_json5(key, &value)?;
    }
    zenoh::open(config).wait()
}

fn retry() -> String {
    let retry = json!({"period_init_ms": RETRY_MS, "period_max_ms": RETRY_MS, "period_increase_factor": 1});
    retry.to_string()
}

fn config(settings: &Zenoh, end: End) -> zenoh::Result<Config> {
    let ends = |list: &[String]| serde_json::to_string(list);
    let open_ms = (OPEN_ROUND_TRIPS * settings.round_trip_ms).max(OPEN_MS) as u32;
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"peer\"".to_owned()),
        ("region_name", serde_json::to_string(end.region())?),
        ("listen/endpoints", ends(&settings.listen)?),
        ("connect/endpoints", ends(&settings.connect)?),
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        ("connect/retry", retry()),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("open/return_conditions/connect_scouted", "false".to_owned()),
        ("open/return_conditions/declares", "false".to_owned()),
        ("transport/unicast/open_timeout", open_ms.to_string()),
        ("transport/unicast/accept_timeout", ACCEPT_MS.to_string()),
        ("transport/link/tx/lease", LEASE_MS.to_string()),
        ("transport/link/tx/keep_alive", "4".to_owned()),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", BLOCKED_US.to_string()),
        ("transport/link/rx/max_message_size", MESSAGE_BYTES.to_string()),
    ] {
        config.insert_json5(key, &value)?;
    }
    let text = |text: &Option<String>| serde_json::to_string(text);
    if settings.user.is_some() {
        let password = settings.password.as_ref().map(Secret::reveal);
        config.insert_json5("transport/auth/usrpwd/user", &text(&settings.user)?)?;
        config.insert_json5("transport/auth/usrpwd/password", &serde_json::to_string(&password)?)?;
    }
    if let Some(users) = &settings.users {
        let users = serde_json::to_string(users)?;
        config.insert_json5("transport/auth/usrpwd/dictionary_file", &users)?;
    }
    if let Some(ZenohTls { authority, certificate, key }) = &settings.tls {
        let path = |path: &std::path::Path| serde_json::to_string(path);
        for (name, value) in [
            ("root_ca_certificate", path(authority)?),
            // Either end shows its own and looks at the other's.
            ("enable_mtls", "true".to_owned()),
            ("listen_certificate", path(certificate)?),
            ("listen_private_key", path(key)?),
            ("connect_certificate", path(certificate)?),
            ("connect_private_key", path(key)?),
        ] {
            config.insert_json5(&format!("transport/link/tls/{name}"), &value)?;
        }
    }
    Ok(config)
}

/// Runs what may wait for zenoh.
#[expect(clippy::disallowed_methods, reason = "who calls zenoh may wait")]
pub(super) fn thread<T: Send + 'static>(
    name: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, LinkError> {
    let spawned = std::thread::Builder::new().name(name.to_owned()).spawn(run);
    spawned.map_err(LinkError::Thread)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_message_larger_than_may_be_is_refused_and_those_after_it_come() {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let end = vec![format!("tcp/127.0.0.1:{port}")];
        let hub = open(&Zenoh { listen: end.clone(), ..Zenoh::default() }, End::Hub).unwrap();
        let (heard_in, heard) = crossbeam_channel::unbounded();
        let hear = move |sample: zenoh::sample::Sample| heard_in.send(sample.payload().len()).unwrap();
        let _subscriber = hub.declare_subscriber("posed/a").callback(hear).wait().unwrap();
        let stage = open(&Zenoh { connect: end, ..Zenoh::default() }, End::Stage).unwrap();
        let put = |bytes: usize| {
            let put = stage.put("posed/a", vec![0; bytes]);
            put.congestion_control(zenoh::qos::CongestionControl::Block).wait().unwrap();
        };
        // Until they know each other.
        while heard.recv_timeout(Duration::from_millis(5)).is_err() {
            put(1);
        }
        let next = || loop {
            match heard.recv_timeout(Duration::from_secs(10)) {
                Ok(1) => {}
                other => return other.ok(),
            }
        };
        let largest = MESSAGE_BYTES as usize;
        put(largest + 1);
        put(2);
        assert_eq!(next(), Some(2));
        put(largest - 1024);
        assert_eq!(next(), Some(largest - 1024));
    }

    /// Neither end listens: what is declared, said and asked passes through the router.
    #[test]
    fn tokens_messages_and_answers_pass_through_a_router() {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        // As docs/hub.md has it.
        let gateway = r#"{"south": [{"filters": [{"region_names": ["posed-hub"]}]},
            {"filters": [{"region_names": ["posed-stage"]}]}, {"filters": [{"modes": ["client"]}]}]}"#;
        let mut config = Config::default();
        for (key, value) in [
            ("mode", "\"router\"".to_owned()),
            ("listen/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
            ("gateway", gateway.to_owned()),
            ("scouting/multicast/enabled", "false".to_owned()),
        ] {
            config.insert_json5(key, &value).unwrap();
        }
        let router = zenoh::open(config).wait().unwrap();
        let settings = Zenoh { connect: vec![format!("tcp/127.0.0.1:{port}")], ..Zenoh::default() };
        let (stage, hub) = (open(&settings, End::Stage).unwrap(), open(&settings, End::Hub).unwrap());
        let (heard_in, heard) = crossbeam_channel::unbounded();
        let hears = |what: &'static str| {
            let heard_in = heard_in.clone();
            move |_: zenoh::sample::Sample| heard_in.send(what).unwrap()
        };
        let liveliness = stage.liveliness();
        let _wishes = liveliness
            .declare_subscriber("posed/a/posed-wish/**")
            .history(true)
            .callback(hears("wish"))
            .wait();
        let answer = |query: zenoh::query::Query| _ = query.reply(query.key_expr().clone(), "here").wait();
        let _answers = stage.declare_queryable("posed/a/clock").callback(answer).wait().unwrap();
        let _frames = hub.declare_subscriber("posed/a/feed/frames").callback(hears("frame")).wait().unwrap();
        let _wish = hub.liveliness().declare_token("posed/a/posed-wish/hub/{}").wait().unwrap();
        let next = || heard.recv_timeout(Duration::from_secs(20)).unwrap();
        assert_eq!(next(), "wish");
        stage.put("posed/a/feed/frames", "frame").wait().unwrap();
        assert_eq!(next(), "frame");
        let replies = hub.get("posed/a/clock").wait().unwrap();
        assert!(replies.recv_timeout(Duration::from_secs(20)).unwrap().unwrap().result().is_ok());
        router.close().wait().unwrap();
    }

    #[test]
    fn zenoh_knows_every_key_that_is_set() {
        let settings = Zenoh {
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            connect: vec!["tcp/hub.local:7447".to_owned()],
            user: Some("a".to_owned()),
            password: Some("b".to_owned().into()),
            users: Some("/etc/posed/users".into()),
            tls: Some(ZenohTls {
                authority: "/etc/posed/authority.pem".into(),
                certificate: "/etc/posed/hub.pem".into(),
                key: "/etc/posed/hub-key.pem".into(),
            }),
            ..Zenoh::default()
        };
        let config = config(&settings, End::Hub).unwrap();
        let emitted = config.to_string();
        for part in [
            "hub.local:7447",
            "\"lease\":2000",
            "\"/etc/posed/users\"",
            "\"mode\":\"peer\"",
            "hub-key.pem",
            "\"enable_mtls\":true",
        ] {
            assert!(emitted.contains(part), "{part} in {emitted}");
        }
    }
}
