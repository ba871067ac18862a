//! How the main views look, beside pictures that are kept: nobody takes a panel away, or a colour, unseen.
//!
//! Pictures are compared as cells of eight pixels, so that letters of another font rasteriser are the same, and each cell with the
//! cells around it, so that a pixel's shift is none (`tests/looks/compare.js`). What tells a time, a rate or a size on a disk is
//! hidden (`tests/looks/hide.css`). `POSED_BLESS=1` keeps what the page looks like now in `tests/looks/`; look at it before it is
//! committed.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_recording::{Header, Scribe, Snapshot};
use serde_json::{Value, json};

use super::{PAINTED, done};
use crate::chromium::{self, Browser, base64};
use crate::daemon::process::{Posed, ok};
use crate::daemon::setup::run;

/// Cells that may differ, of all.
const SAME: f64 = 0.0025;
/// Looks at a page that does not look as it should yet.
const LOOKS: u32 = 10;
/// When the take begins, s: all devices stream.
const BEGUN_S: f64 = 8.0;
const LENGTH_S: f64 = 10.0;
const SCREEN: [u32; 2] = [1200, 800];
const PHONE: [u32; 2] = [390, 844];

/// A file beside the kept pictures.
fn beside(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/looks").join(name)
}

/// A take of the demo in simulated time: the same at every run.
fn take(path: &Path) {
    let (stage, mut rig) = posed_rig::demo();
    rig.run_until(BEGUN_S);
    rig.forget();
    let publisher = posed_protocol::Publisher::new(&stage, posed_protocol::Fields::all());
    let header = Header {
        begun: Timestamp::from_secs_f64(BEGUN_S),
        models: rig.pipeline.models().clone(),
        snapshot: Some(Snapshot {
            pipeline: rig.pipeline.snapshot(),
            publisher: rmp_serde::to_vec(&publisher.state()).unwrap(),
        }),
        ..Header::new(&stage, posed_rig::DEMO, 1_700_000_000_000_000_000)
    };
    let mut scribe = Scribe::new(File::create(path).unwrap(), header).unwrap();
    rig.run_until(BEGUN_S + LENGTH_S);
    rig.log.iter().for_each(|entry| _ = scribe.entry(entry).unwrap());
    scribe.finish("the end").unwrap();
}

/// The page as it looks now, as PNG in base64.
async fn shot(browser: &mut Browser) -> String {
    // The pointer is nowhere, and nothing has the focus.
    browser.value("document.activeElement?.blur()").await;
    // The picture and the curves take their size from what was there before.
    browser.pause(Duration::from_millis(1500)).await;
    let shot = browser.call("Page.captureScreenshot", json!({"format": "png"})).await;
    shot["data"].as_str().unwrap().to_owned()
}

/// Makes a page stand still: its size, its time zone, its language and light, and nothing that tells a time.
async fn settle(browser: &mut Browser, [width, height]: [u32; 2], theme: &str) {
    let size = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600});
    browser.call("Emulation.setDeviceMetricsOverride", size).await;
    browser.call("Emulation.setTimezoneOverride", json!({"timezoneId": "UTC"})).await;
    let features = json!([{"name": "prefers-reduced-motion", "value": "reduce"}, {"name": "prefers-color-scheme", "value": theme}]);
    browser.call("Emulation.setEmulatedMedia", json!({"features": features})).await;
    style(browser, "hides", &std::fs::read_to_string(beside("hide.css")).unwrap()).await;
}

/// Rules of the page by this name from now on.
async fn style(browser: &mut Browser, name: &str, rules: &str) {
    // Adopted, not added: the page's security policy allows no other styles.
    let adopt = format!(
        "window.sheets ??= {{}}; sheets['{name}'] ??= new CSSStyleSheet(); sheets['{name}'].replaceSync({rules:?}); \
         document.adoptedStyleSheets = Object.values(sheets)"
    );
    browser.value(&adopt).await;
}

/// Pictures that were taken, compared with those that are kept.
struct Looks {
    browser: Browser,
    wrong: Vec<String>,
}

impl Looks {
    async fn open() -> Self {
        let mut browser = Browser::open("about:blank").await;
        let script = std::fs::read_to_string(beside("compare.js")).unwrap();
        browser.value(&script).await;
        Self { browser, wrong: Vec::new() }
    }

    async fn run(&mut self, call: &str) -> Value {
        let params = json!({"expression": call, "returnByValue": true, "awaitPromise": true});
        self.browser.call("Runtime.evaluate", params).await["result"]["value"].clone()
    }

    /// The share of cells in which a picture differs from the one that is kept.
    async fn differs(&mut self, name: &str, shot: &str) -> f64 {
        use std::fmt::Write;
        let kept = std::fs::read(beside(&format!("{name}.png"))).unwrap_or_default();
        let hex = kept.iter().fold(String::new(), |mut hex, byte| {
            write!(hex, "{byte:02x}").unwrap();
            hex
        });
        self.run(&format!("differs('{shot}', '{hex}')")).await.as_f64().unwrap()
    }

    /// Holds the page against a kept picture, or keeps it.
    async fn look(&mut self, page: &mut Browser, name: &str) {
        let mut seen = shot(page).await;
        if std::env::var_os("POSED_BLESS").is_some() {
            let small = self.run(&format!("reduced('{seen}')")).await;
            return std::fs::write(beside(&format!("{name}.png")), base64(small.as_str().unwrap())).unwrap();
        }
        let mut differs = self.differs(name, &seen).await;
        // A busy machine takes its time to draw all of a page.
        for _ in 0..LOOKS {
            if differs <= SAME {
                return;
            }
            seen = shot(page).await;
            differs = self.differs(name, &seen).await;
        }
        if differs > SAME {
            // For who wants to see it.
            let file = std::env::temp_dir().join(format!("posed-looks-{name}.png"));
            std::fs::write(&file, base64(&seen)).unwrap();
            self.wrong.push(format!(
                "{name}: {:.1} % of it look otherwise, see {}",
                100.0 * differs,
                file.display()
            ));
        }
    }
}

/// What somebody could break without noticing.
const BREAKS: [(&str, &str); 6] = [
    ("the rail is gone", "#watch aside { display: none !important }"),
    ("the picture is empty", "#watch canvas { visibility: hidden !important }"),
    ("surfaces have another colour", ":root { --surface: #1f2937 !important }"),
    ("what is good is blue", ":root { --good: #4040ff !important }"),
    ("the head is higher", "header { padding-block: 12px !important }"),
    ("the bar is gone", "footer { visibility: hidden !important }"),
];

/// Letters as another rasteriser has them: heavier.
const HEAVIER: &str = "* { -webkit-text-stroke: .25px }";

#[tokio::test(flavor = "multi_thread")]
async fn the_main_views_look_as_their_kept_pictures() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("curls.mcap");
    take(&path);
    let mut looks = Looks::open().await;
    let posed = Posed::start(["replay", path.to_str().unwrap()]);
    // At once: before a busy machine has opened the page it would be over.
    ok(&mut posed.client().await, json!({"type": "replay.speed", "speed": 0})).await;
    let mut browser = Browser::open(&format!("http://{}/#watch", posed.address)).await;
    browser.until("document.getElementById('timeline')?.ariaValueMax > 9").await;
    settle(&mut browser, SCREEN, "dark").await;
    browser.until("document.getElementById('link').textContent === 'paused'").await;
    // To the middle, by keys: the beginning, and five tenths of all of it.
    browser.value("document.getElementById('timeline').focus()").await;
    browser.call("Input.dispatchKeyEvent", json!({"type": "keyDown", "key": "Home"})).await;
    for _ in 0..5 {
        let tenth = json!({"type": "keyDown", "key": "ArrowRight", "modifiers": 8});
        browser.call("Input.dispatchKeyEvent", tenth).await;
    }
    browser.until("Math.abs(document.getElementById('timeline').ariaValueNow - 5) < 0.2").await;
    browser.until("/replay.seek/.test(document.getElementById('jobs').textContent)").await;
    browser.until(PAINTED).await;
    browser.pause(Duration::from_secs(3)).await;

    looks.look(&mut browser, "watch-dark").await;
    if std::env::var_os("POSED_BLESS").is_none() {
        for (what, rules) in BREAKS {
            style(&mut browser, "breaks", rules).await;
            let broken = shot(&mut browser).await;
            let differs = looks.differs("watch-dark", &broken).await;
            assert!(differs > SAME, "{what}, and nobody sees it: {differs}");
        }
        style(&mut browser, "breaks", HEAVIER).await;
        let heavier = shot(&mut browser).await;
        let differs = looks.differs("watch-dark", &heavier).await;
        assert!(differs <= SAME, "letters that are a little heavier are no other look: {differs}");
        style(&mut browser, "breaks", "").await;
    }
    for (view, theme) in [("watch", "light"), ("takes", "dark"), ("check", "light"), ("calibrate", "dark")] {
        browser.click(&format!("tab-{view}")).await;
        settle(&mut browser, SCREEN, theme).await;
        looks.look(&mut browser, &format!("{view}-{theme}")).await;
    }
    browser.click("tab-watch").await;
    settle(&mut browser, PHONE, "dark").await;
    looks.look(&mut browser, "phone-dark").await;
    settle(&mut browser, SCREEN, "dark").await;
    browser.value("location.hash = 'wall'").await;
    browser.until(&PAINTED.replace("#watch", "#wall")).await;
    looks.look(&mut browser, "wall-dark").await;
    done(browser, posed).await;

    // A stage that is being set up, with a device that nobody has plugged in.
    let stage = folder.path().join("stage.toml");
    let text = "name = \"s\"\n[body]\nheight_m = 1.7\n[[device]]\nname = \"a\"\ndriver = \"x-imu3\"\nport = \"/dev/none\"\n\
        [[sensor]]\nname = \"torso\"\ndevice = \"a\"\naddress = 0\n";
    std::fs::write(&stage, text).unwrap();
    let posed = run(&stage, folder.path());
    let mut browser = Browser::open(&format!("http://{}/#setup", posed.address)).await;
    browser.until("document.getElementById('setup-name')?.value === 's'").await;
    for (step, theme) in [("place", "light"), ("calibrate", "dark")] {
        browser.click(&format!("step-{step}")).await;
        settle(&mut browser, SCREEN, theme).await;
        looks.look(&mut browser, &format!("setup-{step}-{theme}")).await;
    }
    done(browser, posed).await;
    assert_eq!(looks.wrong, Vec::<String>::new(), "POSED_BLESS=1 keeps the new look");
}
