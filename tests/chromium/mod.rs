//! Chromium with one page, driven over its DevTools websocket. Shared by the tests of the page and its bench.

#![allow(
    dead_code,
    missing_docs,
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "shared by a test and a bench, neither of which uses all of it"
)]

use std::cell::OnceCell;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(300);

/// What the browser says where an expression's page is left before it has a value.
const LEFT: &str = "Inspected target navigated or closed";

/// Four pictures a second: drawn by software, sixty take a processor for every browser.
const SLOW_SCREEN: &str = "const frame = requestAnimationFrame; self.requestAnimationFrame = (draw) => setTimeout(() => frame(draw), 240)";

/// Tests that drive browsers at the same time: more of them would take the processors from the daemons that they look at.
const AT_ONCE: usize = 3;
static DRIVING: (Mutex<usize>, Condvar) = (Mutex::new(0), Condvar::new());

thread_local! {
    /// That of the test whose thread this is, until it ends.
    static PLACE: OnceCell<Place> = const { OnceCell::new() };
}

/// A test's place among those.
struct Place;

impl Place {
    fn take() -> Self {
        let (driving, freed) = &DRIVING;
        let all_driven = |driving: &mut usize| *driving >= AT_ONCE;
        *freed.wait_while(driving.lock().unwrap(), all_driven).unwrap() += 1;
        Self
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let (driving, freed) = &DRIVING;
        *driving.lock().unwrap_or_else(PoisonError::into_inner) -= 1;
        freed.notify_one();
    }
}

/// Whether the page is to be driven; says so where it is not. A test asks before it starts anything, and waits here for its turn.
pub(crate) fn is_wanted() -> bool {
    let wanted = std::env::var_os("POSED_TEST_BROWSER").is_some();
    if wanted {
        PLACE.with(|place| _ = place.get_or_init(Place::take));
    } else {
        println!("skipped: set POSED_TEST_BROWSER to drive the page in Chromium");
    }
    wanted
}

/// How often a page is drawn.
#[derive(Clone, Copy)]
pub(crate) enum Screen {
    /// Four times a second, for tests: many browsers share the processors.
    Slow,
    /// As often as the browser can, for what is measured.
    Full,
}

/// A headless browser with one page, and all it has complained about.
pub(crate) struct Browser {
    child: Child,
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    session: Option<String>,
    next_id: u64,
    pub(crate) complaints: Vec<String>,
    _profile: tempfile::TempDir,
}

impl Browser {
    pub(crate) async fn open(url: &str) -> Self {
        Self::open_on(Screen::Slow, url, None).await
    }

    /// With a script that runs before those of the page; it may then talk to other addresses than the page's.
    pub(crate) async fn open_with(url: &str, script: &str) -> Self {
        Self::open_on(Screen::Slow, url, Some(script)).await
    }

    pub(crate) async fn open_on(screen: Screen, url: &str, script: Option<&str>) -> Self {
        let profile = tempfile::tempdir().unwrap();
        // In a test who looks waits, not what is looked at: daemons live in real time.
        let yields = match screen {
            Screen::Slow => "10",
            Screen::Full => "0",
        };
        let mut child = Command::new("nice")
            .args(["-n", yields, "chromium"])
            .args(["--headless=new", "--no-sandbox", "--disable-background-networking"])
            // The page by the processor, as without graphics hardware everywhere; WebGL by software, which takes several times as long for what is no WebGL.
            .args(["--disable-gpu", "--enable-unsafe-swiftshader"])
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
            .expect("the browser states where it listens");
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
        if let Screen::Slow = screen {
            browser.call("Page.addScriptToEvaluateOnNewDocument", json!({"source": SLOW_SCREEN})).await;
        }
        if let Some(script) = script {
            browser.call("Page.setBypassCSP", json!({"enabled": true})).await;
            browser.call("Page.addScriptToEvaluateOnNewDocument", json!({"source": script})).await;
        }
        browser.call("Page.navigate", json!({"url": url})).await;
        browser
    }

    /// Calls a method of the protocol; what the page complains about meanwhile is kept.
    pub(crate) async fn call(&mut self, method: &str, params: Value) -> Value {
        let answer = self.answer(method, params).await;
        assert!(answer["error"].is_null(), "{method}: {answer}");
        answer["result"].clone()
    }

    /// What it answers, be it a refusal.
    async fn answer(&mut self, method: &str, params: Value) -> Value {
        let id = self.send(method, params).await;
        loop {
            let message = self.receive().await;
            if message["id"] == id {
                return message;
            }
        }
    }

    /// Sends a request; returns its number, which the answer will have.
    async fn send(&mut self, method: &str, params: Value) -> u64 {
        self.next_id += 1;
        let mut request = json!({"id": self.next_id, "method": method, "params": params});
        if let Some(session) = &self.session {
            request["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(request.to_string())).await.unwrap();
        self.next_id
    }

    /// The next message of the browser; what the page complains about is kept.
    async fn receive(&mut self) -> Value {
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
            return message;
        }
    }

    /// Loads the page anew. The answer to the request comes while the old page still stands; what is done to that one is lost.
    pub(crate) async fn reload(&mut self) {
        let id = self.send("Page.reload", json!({})).await;
        let (mut answered, mut navigated) = (false, false);
        while !(answered && navigated) {
            let message = self.receive().await;
            answered |= message["id"] == id;
            navigated |= message["method"] == "Page.frameNavigated";
        }
    }

    /// The value of an expression on the page; null where the page is left meanwhile, as by a click on a link.
    pub(crate) async fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "returnByValue": true});
        let answer = self.answer("Runtime.evaluate", params).await;
        let error = &answer["error"];
        assert!(error.is_null() || error["message"] == LEFT, "{expression}: {answer}");
        answer["result"]["result"]["value"].clone()
    }

    /// The texts of one row of a table.
    pub(crate) async fn row(&mut self, table: &str, row: usize) -> Vec<String> {
        let cells = format!(
            "[...(document.getElementById('{table}').rows[{row}]?.cells ?? [])].map((c) => c.textContent)"
        );
        serde_json::from_value(self.value(&cells).await).unwrap()
    }

    /// Waits until an expression on the page is true.
    #[expect(clippy::disallowed_methods, reason = "a page cannot be waited for, only asked")]
    pub(crate) async fn until(&mut self, expression: &str) {
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

    /// Clicks what can be clicked, once it can.
    pub(crate) async fn click(&mut self, id: &str) {
        self.until(&format!(
            "document.getElementById('{id}') !== null && !document.getElementById('{id}').disabled"
        ))
        .await;
        self.value(&format!("document.getElementById('{id}').click()")).await;
    }

    /// Fills in a field or chooses from a list, as somebody does: `which` is a selector.
    pub(crate) async fn fill(&mut self, which: &str, value: &str) {
        self.until(&format!("document.querySelector(\"{which}\") !== null")).await;
        let fill = format!(
            "(() => {{ const field = document.querySelector(\"{which}\"); field.value = {value:?}; \
             for (const kind of ['input', 'change']) field.dispatchEvent(new Event(kind, {{ bubbles: true }})); }})()"
        );
        self.value(&fill).await;
    }

    /// Lets the page go on.
    #[expect(clippy::disallowed_methods, reason = "a page's time is the wall's")]
    pub(crate) async fn pause(&mut self, duration: Duration) {
        tokio::time::sleep(duration).await;
    }

    /// Puts the window away, or back.
    pub(crate) async fn hide(&mut self, hidden: bool) {
        let window = self.call("Browser.getWindowForTarget", json!({})).await;
        let state = if hidden { "minimized" } else { "normal" };
        let params = json!({"windowId": window["windowId"], "bounds": {"windowState": state}});
        self.call("Browser.setWindowBounds", params).await;
    }

    /// What the page's scripts hold, after a collection.
    pub(crate) async fn heap_bytes(&mut self) -> i64 {
        self.call("HeapProfiler.collectGarbage", json!({})).await;
        self.call("Runtime.getHeapUsage", json!({})).await["usedSize"].as_f64().unwrap() as i64
    }

    /// Memory of the largest process that draws pages.
    pub(crate) async fn renderer_bytes(&mut self) -> u64 {
        let session = self.session.take();
        let processes = self.call("SystemInfo.getProcessInfo", json!({})).await;
        self.session = session;
        let processes = processes["processInfo"].as_array().unwrap().clone();
        let renderers = processes.iter().filter(|process| process["type"] == "renderer");
        renderers.map(|process| resident_bytes(process["id"].as_u64().unwrap() as u32)).max().unwrap()
    }

    /// A picture for the documentation, where they are being made anew (`tests/pictures`) and a page of it shows this one.
    pub(crate) async fn picture(&mut self, name: &str) {
        self.picture_when(name, "true").await;
    }

    /// The same at a moment in which an expression on the page is true: a busy machine has others, too.
    pub(crate) async fn picture_when(&mut self, name: &str, expression: &str) {
        if std::env::var_os("POSED_BLESS").is_none() || !is_shown(name) {
            return;
        }
        // So that curves and trails have something to show.
        self.pause(Duration::from_secs(6)).await;
        // A picture takes its time, too: what it shows was so before and after.
        let shot = loop {
            self.until(expression).await;
            let shot = self.call("Page.captureScreenshot", json!({"format": "png"})).await;
            if self.value(expression).await == true {
                break shot;
            }
        };
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

/// Whether a page of the documentation shows this picture.
fn is_shown(name: &str) -> bool {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let pages = std::fs::read_dir(root.join("docs")).unwrap().map(|page| page.unwrap().path());
    let named = format!("pictures/{name}.png");
    pages
        .chain([root.join("README.md")])
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .any(|path| std::fs::read_to_string(path).unwrap().contains(&named))
}

/// Memory that a process holds.
pub(crate) fn resident_bytes(pid: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    1024 * line.trim().trim_end_matches(" kB").parse::<u64>().unwrap()
}

/// Bytes of a text in base64.
pub(crate) fn base64(text: &str) -> Vec<u8> {
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
