//! A phone as a sensor, in two browsers: the operator's, and one with emulated sensors.

use serde_json::{Value, json};

use super::{LIVE, console, done};
use crate::chromium::{self, Browser};
use crate::daemon::phones::Emulated;
use crate::daemon::process::Posed;
use crate::daemon::setup::run;

/// How a phone is held and moved, as a browser is to say it.
#[derive(Clone, Copy)]
struct Held {
    acceleration_m_s2: [f64; 3],
    gyro_rad_s: [f64; 3],
    /// alpha, beta, gamma of `deviceorientation`.
    orientation_deg: [f64; 3],
}

const FLAT: Held =
    Held { acceleration_m_s2: [0.0, 0.0, 9.8], gyro_rad_s: [0.0; 3], orientation_deg: [0.0; 3] };
const UPRIGHT: Held = Held { acceleration_m_s2: [0.0, 9.8, 0.0], orientation_deg: [0.0, 90.0, 0.0], ..FLAT };
/// On its way between the two.
const RAISING: Held = Held {
    acceleration_m_s2: [0.0, 6.9, 6.9],
    gyro_rad_s: [1.5, 0.0, 0.0],
    orientation_deg: [0.0, 45.0, 0.0],
};
const LOWERING: Held = Held { gyro_rad_s: [-1.5, 0.0, 0.0], ..RAISING };
const TURNING: Held = Held { gyro_rad_s: [0.0, 0.0, 1.5], orientation_deg: [45.0, 0.0, 0.0], ..FLAT };
const TURNED: Held = Held { orientation_deg: [90.0, 0.0, 0.0], ..FLAT };

async fn hold(phone: &mut Browser, held: Held) {
    let xyz = |[x, y, z]: [f64; 3]| json!({"xyz": {"x": x, "y": y, "z": z}});
    let readings = [
        ("accelerometer", held.acceleration_m_s2),
        ("linear-acceleration", [0.0; 3]),
        ("gyroscope", held.gyro_rad_s),
    ];
    for (kind, reading) in readings {
        let reading = json!({"type": kind, "reading": xyz(reading)});
        phone.call("Emulation.setSensorOverrideReadings", reading).await;
    }
    let [alpha, beta, gamma] = held.orientation_deg;
    let angles = json!({"alpha": alpha, "beta": beta, "gamma": gamma});
    phone.call("DeviceOrientation.setDeviceOrientationOverride", angles).await;
}

/// A phone with sensors and a narrow screen, which goes on at the warning of a certificate.
async fn phone() -> Browser {
    let mut phone = Browser::open("about:blank").await;
    phone.call("Security.setIgnoreCertificateErrors", json!({"ignore": true})).await;
    let screen = json!({"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": true});
    phone.call("Emulation.setDeviceMetricsOverride", screen).await;
    for kind in ["accelerometer", "linear-acceleration", "gyroscope"] {
        let metadata = json!({"available": true, "minimumFrequency": 1, "maximumFrequency": 60});
        let enabled = json!({"enabled": true, "type": kind, "metadata": metadata});
        phone.call("Emulation.setSensorOverrideEnabled", enabled).await;
    }
    hold(&mut phone, FLAT).await;
    phone
}

async fn go(phone: &mut Browser, address: &str) {
    // What differs behind # alone would not be loaded anew.
    for url in ["about:blank", address] {
        phone.call("Page.navigate", json!({"url": url})).await;
    }
    phone.until("document.getElementById('phone-start') !== null").await;
}

fn says(id: &str, words: &str) -> String {
    format!("document.getElementById('{id}')?.textContent.includes('{words}') ?? false")
}

/// An empty stage file in a folder, and the daemon on it, whose phones come to this computer alone.
fn empty(folder: &std::path::Path) -> Posed {
    let stage = folder.join("stage.toml");
    std::fs::write(&stage, "name = \"hall\"\n[server]\nphones = \"127.0.0.1:0\"\n").unwrap();
    run(&stage, folder)
}

/// The operator's page with a QR code, and the address in it.
async fn invited(posed: &Posed) -> (Browser, String) {
    let mut operator = Browser::open(&format!("http://{}/#setup", posed.address)).await;
    operator.until(LIVE_OR_EMPTY).await;
    operator.click("phone-add").await;
    operator.until("document.querySelector('#phone-qr path') !== null").await;
    let page = operator.value("document.querySelector('.how .address').textContent").await;
    (operator, page.as_str().unwrap().to_owned())
}

const LIVE_OR_EMPTY: &str = "document.getElementById('phone-add') !== null";

#[tokio::test(flavor = "multi_thread")]
async fn a_phone_becomes_a_sensor_from_nothing_and_comes_back_when_its_screen_was_dark() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let posed = empty(folder.path());
    let (mut operator, page) = invited(&posed).await;
    let mut phone = phone().await;
    go(&mut phone, &page).await;
    // The token is in no history, and nothing to press is too small for a finger.
    assert_eq!(phone.value("location.href.includes('k=')").await, false);
    let small = "[...document.querySelectorAll('button, select, input, summary')].filter((each) => each.offsetHeight > 0 \
        && (each.offsetHeight < 44 || each.offsetWidth < 44)).map(({ id }) => id).join()";
    assert_eq!(phone.value(small).await, "");
    phone.fill("#phone-name", "left thigh").await;
    phone.click("phone-start").await;
    phone.until(&says("phone-state", "sees this phone")).await;
    // The operator sees how it is held before anything of it is in the stage file.
    let held = "document.querySelector('#phone-list [data-orientation]')?.dataset.orientation";
    operator.until(&format!("{held} === '1.000 0.000 0.000 0.000'")).await;
    hold(&mut phone, UPRIGHT).await;
    operator.until(&format!("{held} === '0.707 0.707 0.000 0.000'")).await;
    operator.fill(".phone-segment", "thigh_l").await;
    operator.value("document.querySelector('#phone-list form button').click()").await;
    // One press: the stage begins with it, and the phone is back without anybody touching it.
    operator.until(&says("phone-list", "is the sensor left thigh")).await;
    phone.until(&says("phone-state", "It is tracked")).await;
    phone.until(&says("phone-figures", "left thigh")).await;
    phone.until("/[4-7][0-9] Hz/.test(document.getElementById('phone-figures')?.textContent)").await;
    let stage = posed_stage::Stage::load(&folder.path().join("stage.toml")).unwrap();
    assert_eq!((stage.sensors[0].name.as_str(), stage.sensors[0].sits_on()), ("left thigh", "thigh_l"));
    // Its orientation is on the operator's page as that of any sensor.
    operator.click("tab-check").await;
    operator.until(LIVE).await;
    operator.until("document.getElementById('sensors').rows[0]?.cells[0].textContent === 'left thigh'").await;
    operator
        .until("!isNaN(parseFloat(document.getElementById('sensors').rows[0].cells[7].textContent))")
        .await;
    // A dark screen stops it; with the light it is there again, as the same.
    let id = phone.value("localStorage.getItem('posed.phone.id')").await;
    phone.hide(true).await;
    phone.until("document.hidden").await;
    let rate = "parseFloat(document.getElementById('sensors').rows[0].cells[2].textContent)";
    operator.until(&format!("!({rate} > 0)")).await;
    phone.hide(false).await;
    phone.until(&says("phone-state", "It is tracked")).await;
    operator.until(&format!("{rate} > 30")).await;
    assert_eq!(phone.value("localStorage.getItem('posed.phone.id')").await, id);
    assert_eq!(phone.complaints, Vec::<String>::new());
    done(operator, posed).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wrong_sign_is_found_by_the_guided_test_and_a_wrong_token_is_refused() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let posed = empty(folder.path());
    let (mut operator, page) = invited(&posed).await;
    // Nothing that anybody meets has a barrier, in either language, light or dark.
    console::prepare_for_axe(&mut operator).await;
    assert_eq!(console::barriers(&mut operator).await, Vec::<String>::new());
    let mut phone = phone().await;
    let wrong = page.split_once("k=").unwrap().0.to_owned() + "k=another-token-of-nobody";
    go(&mut phone, &wrong).await;
    phone.click("phone-start").await;
    phone.until(&says("phone-state", "no longer valid")).await;
    phone.complaints.clear();
    // As some browsers have it: acceleration with the other sign.
    let inverted = |held: Held| Held { acceleration_m_s2: held.acceleration_m_s2.map(|part| -part), ..held };
    go(&mut phone, &page).await;
    // Not before: a page that is loaded anew begins with what the one before began with.
    hold(&mut phone, inverted(FLAT)).await;
    phone.click("phone-start").await;
    phone.click("phone-guide").await;
    for (step, on_the_way, then) in
        [("Stand it up", RAISING, UPRIGHT), ("flat again", LOWERING, FLAT), ("Turn it left", TURNING, TURNED)]
    {
        phone.until(&says("phone-step", step)).await;
        hold(&mut phone, inverted(on_the_way)).await;
        phone.pause(std::time::Duration::from_secs(1)).await;
        hold(&mut phone, inverted(then)).await;
    }
    phone.until(&says("phone-verdict", "was wrong. It is corrected")).await;
    let kept: Value =
        serde_json::from_str(phone.value("localStorage.getItem('posed.phone.axes')").await.as_str().unwrap())
            .unwrap();
    assert_eq!(kept["acceleration"], json!([[-1, 0, 0], [0, -1, 0], [0, 0, -1]]));
    assert_eq!(kept["gyro"], json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]));
    console::prepare_for_axe(&mut phone).await;
    for language in ["en", "de"] {
        phone.fill("#phone-language", language).await;
        for theme in ["light", "dark"] {
            phone.value(&format!("document.documentElement.dataset.theme = '{theme}'")).await;
            assert_eq!(console::barriers(&mut phone).await, Vec::<String>::new(), "{language}, {theme}");
        }
    }
    // Another device of the same network shows on the operator's page, too.
    let mut other = Emulated::connect(posed.address, "", "esp-7f3a").await.unwrap();
    other.greet().await;
    operator.until("document.querySelector('[data-phone=\"esp-7f3a\"]') !== null").await;
    done(operator, posed).await;
}
