//! Thousands of connections at once.

use std::net::TcpStream;

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use super::process::{Posed, all_ok, frames, two_devices, until};

/// What this process keeps for everything else, other tests included.
const OTHERS: u64 = 500;

#[tokio::test(flavor = "multi_thread")]
async fn thousands_of_connections_are_refused_and_tracking_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut client = posed.subscriber(&["status", "sensors"]).await;
    until(&mut client, "all sensors", all_ok).await;

    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).unwrap();
    let many = maximum.unwrap_or(u64::MAX).saturating_sub(OTHERS).min(10_000) as usize;
    let address = posed.address;
    let open = move || (0..many).map_while(|_| TcpStream::connect(address).ok()).collect::<Vec<_>>();
    let connections = tokio::task::spawn_blocking(open).await.unwrap();
    assert!(connections.len() > 300, "only {} connections could be opened", connections.len());

    let status = until(&mut client, "a word about the connections", |message| {
        message["problems"].as_array().is_some_and(|all| all.iter().any(|one| one["code"] == "connections"))
    })
    .await;
    assert!(status["problems"][0]["message"].as_str().unwrap().contains("refused"), "{status}");
    frames(&mut client, 100).await;
    drop(connections);
    // Places are free again as soon as the daemon has seen the ends.
    until(&mut client, "nothing to say", |message| {
        message["problems"].as_array().is_some_and(|problems| problems.is_empty())
    })
    .await;
    let health = posed.get("/health").await;
    assert!(health.starts_with("HTTP/1.1 200"), "{health}");
    assert_eq!(posed.end("INT").await.code(), Some(0));
}
