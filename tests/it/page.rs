//! The page in a real browser, driven over its DevTools websocket.
//!
//! Runs where `POSED_TEST_BROWSER` is set, and fails there without Chromium. With `POSED_BLESS` it also takes the
//! picture in `docs/pictures/`.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use crate::daemon::process::{PATIENCE, Posed, two_devices};

/// A headless browser with one page, and all it has complained about.
struct Browser {
    child: Child,
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    session: Option<String>,
    next_id: u64,
    complaints: Vec<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    async fn open(url: &str) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut child = Command::new("chromium")
            .args(["--headless=new", "--no-sandbox", "--disable-background-networking"])
            // WebGL by software.
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"])
            .args(["--no-first-run", "--disable-dev-shm-usage", "--remote-debugging-port=0"])
            .args(["--window-size=1200,800", "--hide-scrollbars"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("POSED_TEST_BROWSER is set, so chromium must be installed");
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = lines
            .find_map(|line| line.unwrap().strip_prefix("DevTools listening on ").map(str::to_owned))
            .expect("the browser says where it listens");
        // What it says later must go somewhere.
        tokio::task::spawn_blocking(move || lines.for_each(drop));
        let (socket, _) = connect_async(address).await.unwrap();
        let mut browser =
            Self { child, socket, session: None, next_id: 0, complaints: Vec::new(), _profile: profile };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"})).await;
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = browser.call("Target.attachToTarget", attach).await;
        browser.session = session["sessionId"].as_str().map(str::to_owned);
        for domain in ["Runtime.enable", "Log.enable", "Page.enable"] {
            browser.call(domain, json!({})).await;
        }
        browser.call("Page.navigate", json!({"url": url})).await;
        browser
    }

    /// Calls a method of the protocol; what the page complains about meanwhile is kept.
    async fn call(&mut self, method: &str, params: Value) -> Value {
        self.next_id += 1;
        let mut request = json!({"id": self.next_id, "method": method, "params": params});
        if let Some(session) = &self.session {
            request["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(request.to_string())).await.unwrap();
        loop {
            let received = tokio::time::timeout(PATIENCE, self.socket.next()).await;
            let Message::Text(text) = received.expect("the browser answers").unwrap().unwrap() else {
                continue;
            };
            let message: Value = serde_json::from_str(&text).unwrap();
            match message["method"].as_str() {
                Some("Runtime.exceptionThrown") => self.complaints.push(message["params"].to_string()),
                // Refused by the content security policy, missing files and the like.
                Some("Log.entryAdded") if message["params"]["entry"]["level"] == "error" => {
                    self.complaints.push(message["params"]["entry"].to_string());
                }
                Some("Runtime.consoleAPICalled")
                    if ["error", "assert"].contains(&message["params"]["type"].as_str().unwrap()) =>
                {
                    self.complaints.push(message["params"].to_string());
                }
                _ => {}
            }
            if message["id"] == self.next_id {
                assert!(message["error"].is_null(), "{method}: {message}");
                return message["result"].clone();
            }
        }
    }

    /// The value of an expression on the page.
    async fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true});
        self.call("Runtime.evaluate", params).await["result"]["value"].clone()
    }

    /// The texts of one row of a table.
    async fn row(&mut self, table: &str, row: usize) -> Vec<String> {
        let cells = format!(
            "[...(document.getElementById('{table}').rows[{row}]?.cells ?? [])].map((c) => c.textContent)"
        );
        serde_json::from_value(self.value(&cells).await).unwrap()
    }

    /// Waits until an expression on the page is true.
    #[expect(clippy::disallowed_methods, reason = "a page cannot be waited for, only asked")]
    async fn until(&mut self, expression: &str) {
        let looked = async {
            while self.value(expression).await != true {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        };
        if tokio::time::timeout(PATIENCE, looked).await.is_err() {
            let text = self.value("document.body.innerText").await;
            panic!("{expression} never came; the page says: {text}");
        }
    }

    async fn click(&mut self, id: &str) {
        self.value(&format!("document.getElementById('{id}').click()")).await;
    }

    /// A picture for the documentation, where they are being made anew.
    async fn picture(&mut self, name: &str) {
        if std::env::var_os("POSED_BLESS").is_none() {
            return;
        }
        // So that curves and trails have something to show.
        browser_pause().await;
        let shot = self.call("Page.captureScreenshot", json!({"format": "png"})).await;
        let bytes = base64(shot["data"].as_str().unwrap());
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/pictures");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(format!("{name}.png")), bytes).unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[expect(clippy::disallowed_methods, reason = "a picture wants a few seconds of stream behind it")]
async fn browser_pause() {
    tokio::time::sleep(Duration::from_secs(6)).await;
}

/// Bytes of a text in base64.
fn base64(text: &str) -> Vec<u8> {
    let digit = |c: u8| match c {
        b'A'..=b'Z' => u32::from(c - b'A'),
        b'a'..=b'z' => u32::from(c - b'a') + 26,
        b'0'..=b'9' => u32::from(c - b'0') + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u8> = text.bytes().filter(|&c| c != b'=').collect();
    let mut bytes = Vec::with_capacity(digits.len() * 3 / 4);
    for group in digits.chunks(4) {
        let bits = group.iter().fold(0, |bits, &c| bits << 6 | digit(c)) << (6 * (4 - group.len()));
        bytes.extend_from_slice(&bits.to_be_bytes()[1..group.len()]);
    }
    bytes
}

#[test]
fn base64_is_read() {
    assert_eq!(base64("cG9zZWQ="), b"posed");
    assert_eq!(base64("+/8A"), [0xFB, 0xFF, 0x00]);
}

const DATA_OLD: &str = "document.body.classList.contains('stale') \
    && document.getElementById('link').textContent.includes('no frame for')";
const LIVE: &str =
    "document.getElementById('link').textContent === 'live' && !document.body.classList.contains('stale')";

/// The 3-D picture is more than one colour.
const PAINTED: &str = "(() => { const from = document.querySelector('#stage-view canvas'); \
    const to = document.createElement('canvas'); [to.width, to.height] = [64, 64]; \
    const draw = to.getContext('2d'); draw.drawImage(from, 0, 0, 64, 64); \
    return new Set(new Uint32Array(draw.getImageData(0, 0, 64, 64).data.buffer)).size > 8; })()";

#[tokio::test(flavor = "multi_thread")]
async fn the_page_lives_says_when_data_are_old_and_lives_again() {
    if std::env::var_os("POSED_TEST_BROWSER").is_none() {
        println!("skipped: set POSED_TEST_BROWSER to drive the page in Chromium");
        return;
    }
    let posed = Posed::start(["demo"]);
    let mut browser = Browser::open(&format!("http://{}/#health", posed.address)).await;
    browser.until(LIVE).await;
    // Three magnetic sensors, ten IMUs; positions change.
    let before = browser.row("sensors", 2).await;
    assert_eq!((before[0].as_str(), before.len()), ("wand", 12));
    browser
        .until(&format!(
            "document.getElementById('sensors').rows[2].cells[2].textContent !== '{}'",
            before[2]
        ))
        .await;
    // Rate and losses are numbers once the first second of stream is over.
    browser
        .until("!isNaN(parseFloat(document.getElementById('devices').rows[0].cells[4].textContent))")
        .await;
    let device = browser.row("devices", 0).await;
    assert!(device[4].parse::<f64>().unwrap() > 50.0, "{device:?}");
    for row in 0..3 {
        let sensor = browser.row("sensors", row).await;
        let lost = sensor[11].trim_end_matches(" ~");
        assert!(lost.parse::<u64>().is_ok() && sensor[2].parse::<f64>().is_ok(), "{sensor:?}");
    }
    browser.click("tab-stage-view").await;
    browser.until("document.getElementById('summary').textContent === '13 of 13 are good'").await;
    browser
        .until("document.getElementById('body-summary').textContent === 'body: 10 of 10 segments measured'")
        .await;
    browser.until(PAINTED).await;
    browser.picture("stage").await;
    // The therapist's picture, and the angles behind it.
    browser.click("tab-trainer").await;
    browser.until(&PAINTED.replace("#stage-view", "#avatar")).await;
    browser.picture("trainer").await;
    browser.click("tab-analysis").await;
    browser.until("document.getElementById('joint-choice').options.length === 9").await;
    browser.until("document.querySelectorAll('.joint canvas').length === 1").await;
    browser.click("tab-stage-view").await;
    posed.signal("STOP");
    browser.until(DATA_OLD).await;
    posed.signal("CONT");
    browser.until(LIVE).await;
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn every_view_shows_numbers_and_a_recording_is_made_and_replayed_in_the_browser() {
    if std::env::var_os("POSED_TEST_BROWSER").is_none() {
        println!("skipped: set POSED_TEST_BROWSER to drive the page in Chromium");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/", posed.address)).await;
    browser.until(LIVE).await;
    browser.click("tab-health").await;
    browser.until("document.getElementById('latency').rows.length >= 1").await;
    browser.picture("health").await;
    browser.click("tab-runs").await;
    browser.value("document.getElementById('record-name').value = 'take'").await;
    browser.click("record-start").await;
    browser.until("document.getElementById('recording').textContent.startsWith('recording take.mcap')").await;
    browser.click("tab-analysis").await;
    browser.until("document.querySelectorAll('.curve canvas').length === 3").await;
    browser.until("document.getElementById('sensor-choice').options.length === 2").await;
    browser.picture("analysis").await;
    browser.click("tab-runs").await;
    browser.click("record-stop").await;
    browser.until("document.getElementById('jobs').textContent.includes('take.mcap is complete')").await;
    browser.picture("runs").await;
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(posed.end("INT").await.code(), Some(0));

    let recording = folder.path().join("recordings/take.mcap");
    let replay = Posed::start(["replay", recording.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#replay", replay.address)).await;
    browser.until("document.getElementById('recordings').textContent.includes('take.mcap')").await;
    browser.until("!document.getElementById('scrub').parentElement.parentElement.hidden").await;
    // To the beginning by hand, after it has ended by itself.
    let speed = |words: &str| {
        format!(
            "[...document.querySelectorAll('#replay button')].find((b) => b.textContent === '{words}').click()"
        )
    };
    browser.value(&speed("as fast as it goes")).await;
    browser.until("document.getElementById('link').textContent === 'the recording ends here'").await;
    let seek = "const scrub = document.getElementById('scrub'); scrub.value = scrub.min; \
        scrub.dispatchEvent(new Event('change'));";
    browser.value(&speed("1 ×")).await;
    browser.value(seek).await;
    browser.until("document.getElementById('link').textContent === 'live'").await;
    browser.picture("replay").await;
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(replay.end("INT").await.code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_field_is_calibrated_in_the_browser_and_the_stage_shows_what_the_map_does() {
    if std::env::var_os("POSED_TEST_BROWSER").is_none() {
        println!("skipped: set POSED_TEST_BROWSER to drive the page in Chromium");
        return;
    }
    // Maps are kept beside the stage file.
    let folder = tempfile::tempdir().unwrap();
    let stage = folder.path().join("pole.toml");
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/config/field-pole.toml"), &stage).unwrap();
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#runs", posed.address)).await;
    browser.until(LIVE).await;
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    browser.until(&format!("{}.startsWith('Poses are the tracker')", text("field-map"))).await;
    let sensors = browser.value("document.getElementById('field-sensors').value").await;
    assert_eq!(sensors, "pole-1, pole-2, pole-3, pole-4, pole-5");
    browser.value("document.getElementById('field-spacing').value = '0.15'").await;
    browser.click("field-start").await;
    // It says what to do until there is enough.
    browser.until("!document.getElementById('field-run').hidden").await;
    browser.until("document.getElementById('field-hint').className.includes('care')").await;
    browser.until("document.getElementById('field-cells').value > 0.5").await;
    browser.until("document.getElementById('field-hint').className.includes('good')").await;
    assert_eq!(browser.value("document.getElementById('field-directions').value").await, 1.0);
    browser.picture("calibration").await;
    browser.click("field-finish").await;
    browser.until("!document.getElementById('field-outcome').hidden").await;
    assert_eq!(browser.value("document.getElementById('field-verdict').className").await, "good");
    let figure = async |browser: &mut Browser, row: usize| {
        let cells = browser.row("field-figures", row).await;
        cells[1].parse::<f64>().unwrap_or_else(|_| panic!("{cells:?}"))
    };
    let before_mm = figure(&mut browser, 0).await;
    let held_out_mm = figure(&mut browser, 2).await;
    assert!(before_mm > 1.0 && held_out_mm < 0.5 * before_mm, "{before_mm} {held_out_mm}");
    browser.click("field-accept").await;
    browser.until(&format!("{}.startsWith('Map 1 is in use')", text("field-map"))).await;
    browser.until("document.getElementById('field-accept').disabled").await;
    browser.click("tab-stage-view").await;
    browser.until(&format!("{}.includes('corrected by the map')", text("summary"))).await;
    browser.until(&format!("/^arrows [0-9]+ times/.test({})", text("field-arrows"))).await;
    browser.until(PAINTED).await;
    browser.picture("field").await;
    browser.click("tab-runs").await;
    browser.click("field-rollback").await;
    browser.until(&format!("{}.startsWith('Poses are the tracker')", text("field-map"))).await;
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_of_faults_is_learnt_and_a_cell_named_in_the_browser() {
    if std::env::var_os("POSED_TEST_BROWSER").is_none() {
        println!("skipped: set POSED_TEST_BROWSER to drive the page in Chromium");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = two_devices(folder.path(), "");
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#health", posed.address)).await;
    browser.until(LIVE).await;
    // Three seconds are enough to learn from.
    browser.until("parseFloat(document.getElementById('frame').textContent.split(' ')[2]) > 4.5").await;
    browser.click("tab-analysis").await;
    browser.until("document.getElementById('fault-map').parentElement.hidden").await;
    browser.click("faults-train").await;
    browser.until("document.getElementById('fault-map').children.length === 441").await;
    browser.until("document.querySelectorAll('#fault-map .winner').length === 1").await;
    let label = browser.row("fault-labels", 1).await;
    assert_eq!((label[0].as_str(), label.len()), ("of two", 5));
    browser.value("document.getElementById('fault-map').children[0].click()").await;
    browser.value("document.getElementById('cell-class').value = 'anomalous'").await;
    browser.click("name-cell").await;
    browser.until("document.getElementById('fault-map').children[0].classList.contains('anomalous')").await;
    browser.picture("faults").await;
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(posed.end("INT").await.code(), Some(0));
}

/// Ten IMUs of a chain on somebody who holds the two poses in turn, and nobody knows how they sit.
fn posing(folder: &Path) -> std::path::PathBuf {
    let mut text = String::from(
        "name = \"posing\"\n[body]\nheight_m = 1.7\n[[device]]\nname = \"chain\"\ndriver = \"xbus\"\nport = \"auto\"\n\
         baud = 921600\n[simulation]\n[[simulation.body]]\nname = \"person\"\n[simulation.body.motion]\nkind = \"person\"\n\
         activity = \"poses\"\nheight_m = 1.7\n[[simulation.device]]\nname = \"chain\"\nboot_ms = 0.0\n",
    );
    for (index, segment) in posed::stage::SEGMENTS.iter().enumerate() {
        let turn = 0.4 * index as f64;
        let (sin, cos) = turn.sin_cos();
        text += &format!(
            "[[sensor]]\nname = \"{segment}\"\ndevice = \"chain\"\naddress = {}\n[[simulation.sensor]]\nname = \"{segment}\"\n\
             body = \"person\"\nsegment = \"{segment}\"\nmount_quat_wxyz = [{cos}, {}, 0.0, {}]\n",
            index + 1,
            0.6 * sin,
            0.8 * sin,
        );
    }
    let path = folder.join("posing.toml");
    std::fs::write(&path, text).unwrap();
    path
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_is_calibrated_in_the_browser_and_then_stands() {
    if std::env::var_os("POSED_TEST_BROWSER").is_none() {
        println!("skipped: set POSED_TEST_BROWSER to drive the page in Chromium");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let stage = posing(folder.path());
    let posed = Posed::start(["demo", "--stage", stage.to_str().unwrap()]);
    let mut browser = Browser::open(&format!("http://{}/#runs", posed.address)).await;
    browser.until("document.getElementById('problems').textContent.includes('calibrate the body')").await;
    browser.value("document.getElementById('calibrate-how').value = 'quick'").await;
    browser.click("calibrate").await;
    browser
        .until("document.getElementById('prompt').textContent.startsWith('2 of 2: Raise both arms')")
        .await;
    browser.until("document.getElementById('prompt').textContent.includes('mounting is known')").await;
    browser.until("document.getElementById('mounting').rows.length === 10").await;
    browser.picture("calibration").await;
    browser.click("tab-stage-view").await;
    browser
        .until("document.getElementById('body-summary').textContent.startsWith('body: 10 of 10 segments measured')")
        .await;
    browser.until("document.getElementById('problems').hidden").await;
    assert_eq!(browser.complaints, Vec::<String>::new());
    drop(browser);
    assert_eq!(posed.end("INT").await.code(), Some(0));
}
