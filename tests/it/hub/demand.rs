//! A hub follows a stage as far as somebody looks, and no further.

use serde_json::{Value, json};

use super::{client, free_port, hub, stages, zenoh_client};
use crate::daemon::process::{PATIENCE, Posed, frames, ok, two_devices, until};

/// Frames that a stage has written for hubs.
struct Written(tokio::sync::mpsc::UnboundedReceiver<usize>);

impl Written {
    /// Those since it was last asked, by their bytes.
    fn new_ones(&mut self) -> Vec<usize> {
        std::iter::from_fn(|| self.0.try_recv().ok()).collect()
    }
}

/// Seconds of stage time between the first and the last of these.
fn lasted_s(frames: &[Value]) -> f64 {
    let t_s = |frame: Option<&Value>| frame.unwrap()["t_s"].as_f64().unwrap();
    t_s(frames.last()) - t_s(frames.first())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stage_is_followed_only_while_somebody_looks_and_only_as_much_as_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let (port, direct) = (free_port(), free_port());
    let hub = hub(port, &[]);
    let more =
        format!("[zenoh]\nconnect = [\"tcp/127.0.0.1:{port}\"]\nlisten = [\"tcp/127.0.0.1:{direct}\"]\n");
    let file = two_devices(folder.path(), &more);
    let stage = Posed::start(["demo".as_ref(), "--stage".as_ref(), file.as_os_str()]);
    // A program that hears all that is written, and asks for nonsense.
    let stranger = zenoh_client(direct).await;
    let (written_in, written) = tokio::sync::mpsc::unbounded_channel();
    let mut written = Written(written);
    let _frames = stranger
        .declare_subscriber("posed/two/feed/frames")
        .callback(move |sample| _ = written_in.send(sample.payload().len()))
        .await
        .unwrap();
    let wishes =
        stranger.liveliness().declare_subscriber("posed/two/posed-wish/**").history(true).await.unwrap();
    let mut nonsense = Vec::new();
    for wish in
        [r#"{"topics":{"sensors":0}}"#, r#"{"topics":{"sensors":-5}}"#, "{{{{", "60", &"9".repeat(20_000)]
    {
        let token = format!("posed/two/posed-wish/stranger/{wish}");
        nonsense.push(stranger.liveliness().declare_token(token).await.unwrap());
    }
    let mut all = client(hub.address, "/ws").await;
    let frames_hz = |stage: &Value| stage["frames_hz"].as_f64().unwrap();
    stages(&mut all, "that it is well", |stage| frames_hz(stage) > 50.0 && stage["streaming"] == 2).await;
    assert_eq!(written.new_ones(), [0; 0], "nobody looks");

    // Little is asked for, and no more is written. Everything that lasts is there at once.
    let mut little = client(hub.address, "/two/ws").await;
    ok(&mut little, json!({"type": "subscribe", "topics": ["status"]})).await;
    assert_eq!(little.next().await["type"], "status");
    let sensor = name_of_one(&stage).await;
    ok(
        &mut little,
        json!({"type": "subscribe", "topics": ["sensors"], "fields": ["position_m"], "sensors": [sensor],
            "max_rate_hz": 20, "drop": "queue"}),
    )
    .await;
    let got = frames(&mut little, 20).await;
    let bytes = written.new_ones();
    assert!((19..=30).contains(&bytes.len()), "{} frames are written for 20", bytes.len());
    assert!(bytes.iter().all(|bytes| *bytes < 150), "{bytes:?}");
    let rate_hz = 19.0 / lasted_s(&got);
    assert!((15.0..=20.5).contains(&rate_hz), "{rate_hz} Hz");
    assert_eq!(got[0]["sensors"].as_array().unwrap().len(), 1);
    // Another one wants more, and both get what they have asked for.
    let mut much = client(hub.address, "/two/ws").await;
    ok(
        &mut much,
        json!({"type": "subscribe", "topics": ["sensors"], "fields": ["covariance"], "drop": "queue"}),
    )
    .await;
    let got = frames(&mut much, 50).await;
    assert!(49.0 / lasted_s(&got) > 60.0, "as many as there are");
    let whole = |frame: &Value| {
        frame["sensors"].as_array().unwrap().iter().all(|of| of["covariance"][0].as_f64() > Some(0.0))
    };
    assert!(got.iter().all(whole), "none is shown before it is there: {}", got[0]);
    let got = frames(&mut little, 20).await;
    assert!(got.iter().all(|frame| frame["sensors"][0]["covariance"].is_null()));
    assert!(written.new_ones().iter().any(|bytes| *bytes > 400));

    // All leave: a while later it ends, and who comes then gets nothing old.
    let newest_s = got.last().unwrap()["t_s"].as_f64().unwrap();
    drop((little, much));
    let is_hubs = |token: &str| !token.contains("/stranger/");
    let mut present = std::collections::BTreeSet::new();
    let until_none = async {
        loop {
            let sample = wishes.recv_async().await.unwrap();
            let token = sample.key_expr().as_str().to_owned();
            match sample.kind() {
                posed_mesh::zenoh::sample::SampleKind::Put => _ = present.insert(token),
                posed_mesh::zenoh::sample::SampleKind::Delete => _ = present.remove(&token),
            }
            if sample.kind() == posed_mesh::zenoh::sample::SampleKind::Delete
                && !present.iter().any(|token| is_hubs(token))
            {
                return;
            }
        }
    };
    tokio::time::timeout(PATIENCE, until_none).await.expect("nothing is wished for any more");
    stages(&mut all, "a second later", |_| true).await;
    written.new_ones();
    stages(&mut all, "still well", |stage| frames_hz(stage) > 50.0).await;
    assert_eq!(written.new_ones(), [0; 0], "nobody looks any more");
    // The websocket for all stages asks as well.
    ok(&mut all, json!({"type": "subscribe", "topics": ["sensors"], "stages": ["two"]})).await;
    let first = until(&mut all, "a frame", |message| message["type"] == "sensors").await;
    assert!(first["t_s"].as_f64().unwrap() > newest_s + 1.0, "none that is old");
    // A hub that is killed wants nothing, and its next one what is asked for there.
    hub.signal("KILL");
    drop(hub);
    let hub = self::hub(port, &[]);
    let mut again = client(hub.address, "/two/ws").await;
    ok(&mut again, json!({"type": "subscribe", "topics": ["truth", "sensors"]})).await;
    until(&mut again, "truth", |message| message["type"] == "truth").await;
    frames(&mut again, 5).await;
    assert_eq!(hub.end("INT").await.code(), Some(0));
    assert_eq!(stage.end("INT").await.code(), Some(0));
}

/// Name of a sensor of a stage.
async fn name_of_one(stage: &Posed) -> Value {
    let mut client = stage.subscriber(&["sensors"]).await;
    frames(&mut client, 1).await[0]["sensors"][0]["name"].clone()
}
