//! A report as a picture: what a therapist sees in a browser, and on paper.

use std::path::Path;
use std::sync::Arc;

use jiff::tz::TimeZone;
use posed_motion::exercise::Language;
use posed_sessions::{
    EndedBy, JointCourse, LessonJoint, NewSession, POINTS, Repetition, Score, Store, TaughtLesson, report,
};
use serde_json::json;

use crate::chromium::{self, Browser};

const TAUGHT_DEG: f64 = 100.0;
/// How far the patient goes.
const DONE_DEG: f64 = 60.0;
const DAY_NS: i64 = 86_400_000_000_000;

fn course_deg(way_deg: f64) -> Vec<f64> {
    let lift = |at: usize| 0.5 - 0.5 * libm::cos(std::f64::consts::TAU * at as f64 / (POINTS - 1) as f64);
    (0..POINTS).map(|at| way_deg * lift(at)).collect()
}

/// Four sessions of ten squats each.
fn four_sessions() -> Store {
    let mut store = Store::in_memory().unwrap();
    let names = ["knee_l_flexion_deg", "knee_r_flexion_deg"];
    let joints =
        names.map(|name| LessonJoint { name: name.to_owned(), demonstration_deg: course_deg(TAUGHT_DEG) });
    let lesson = Arc::new(TaughtLesson {
        exercise: "squat".to_owned(),
        revision: 1,
        duration_s: 3.0,
        joints: joints.to_vec(),
    });
    for session in 0..4 {
        let new = NewSession {
            person: "P-17",
            stage: "clinic",
            subject: "default",
            epoch_utc_ns: 1_700_000_000_000_000_000 + session * 3 * DAY_NS,
            ..NewSession::default()
        };
        let id = store.begin(&new).unwrap();
        for number in 1..=10 {
            let t_s = 4.0 * f64::from(number);
            let joint = |(joint, name): (u32, &str)| JointCourse {
                joint,
                name: name.to_owned(),
                least_deg: 0.0,
                greatest_deg: DONE_DEG,
                course_deg: course_deg(DONE_DEG),
            };
            let score =
                Score { total: 80.0, amplitude: 60.0, tempo: 100.0, smoothness: 100.0, symmetry: None };
            let repetition = Repetition {
                subject: "default".to_owned(),
                lesson: Arc::clone(&lesson),
                begins_set: number == 1,
                planned: Some(10),
                number: Some(number),
                t_start_s: t_s,
                t_end_s: t_s + 3.0,
                t_decided_s: t_s + 3.5,
                reason: None,
                score: Some(score),
                sentence: None,
                sentence_de: None,
                joints: (0..).zip(names).map(joint).collect(),
            };
            store.add(id, &repetition).unwrap();
        }
        store.end(id, 50.0, EndedBy::Plan).unwrap();
    }
    store
}

/// Opens a report and looks at it: `window.rows` has, for each drawing, the heights of the rows with the colour of what was taught, and of
/// what was done: least and greatest, in pixels from the drawing's upper end.
async fn look_at(browser: &mut Browser, path: &Path) -> Vec<[[f64; 2]; 2]> {
    browser.call("Page.navigate", json!({"url": format!("file://{}", path.display())})).await;
    browser.until("document.readyState === 'complete' && document.querySelector('svg') !== null").await;
    // Nothing is cut off.
    browser.until("document.documentElement.scrollWidth <= document.documentElement.clientWidth").await;
    let whole = json!({"format": "png", "captureBeyondViewport": true, "clip": {
        "x": 0, "y": 0, "scale": 1,
        "width": browser.value("document.documentElement.scrollWidth").await,
        "height": browser.value("document.documentElement.scrollHeight").await,
    }});
    let shot = browser.call("Page.captureScreenshot", whole).await;
    let look = format!(
        "(() => {{
            const picture = new Image();
            picture.onload = () => {{
                const canvas = document.createElement('canvas');
                [canvas.width, canvas.height] = [picture.width, picture.height];
                const draw = canvas.getContext('2d');
                draw.drawImage(picture, 0, 0);
                const rows = (svg, [r, g, b]) => {{
                    const box = svg.getBoundingClientRect();
                    const [x, y] = [Math.round(box.x + scrollX), Math.round(box.y + scrollY)];
                    const [width, height] = [Math.round(box.width), Math.round(box.height)];
                    const data = draw.getImageData(x, y, width, height).data;
                    const seen = [];
                    for (let row = 0; row < height; row++) {{
                        for (let column = 0; column < width; column++) {{
                            const at = 4 * (row * width + column);
                            const off = Math.abs(data[at] - r) + Math.abs(data[at + 1] - g) + Math.abs(data[at + 2] - b);
                            if (off < 60) {{ seen.push(row); break; }}
                        }}
                    }}
                    return seen.length === 0 ? [-1, -1] : [seen[0], seen[seen.length - 1]];
                }};
                window.rows = [...document.querySelectorAll('svg')].map((svg) =>
                    [rows(svg, [0xb4, 0x53, 0x09]), rows(svg, [0x0b, 0x6b, 0xcb])]);
            }};
            picture.src = 'data:image/png;base64,{}';
        }})()",
        shot["data"].as_str().unwrap()
    );
    browser.value(&look).await;
    browser.until("window.rows !== undefined").await;
    serde_json::from_value(browser.value("window.rows").await).unwrap()
}

/// Pages of a printed report, and whether each is of A4.
async fn print(browser: &mut Browser) -> (usize, bool) {
    let params = json!({"preferCSSPageSize": true, "printBackground": true});
    let printed = browser.call("Page.printToPDF", params).await;
    let bytes = chromium::base64(printed["data"].as_str().unwrap());
    let text = String::from_utf8_lossy(&bytes);
    let boxes: Vec<&str> =
        text.split("/MediaBox [").skip(1).filter_map(|rest| rest.split(']').next()).collect();
    let is_a4 = |media: &&str| {
        let edges: Vec<f64> = media.split_whitespace().filter_map(|edge| edge.parse().ok()).collect();
        matches!(edges[..], [_, _, width, height] if (width - 595.3).abs() < 2.0 && (height - 841.9).abs() < 2.0)
    };
    (boxes.len(), boxes.iter().all(is_a4))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_report_shows_what_was_done_below_what_was_taught_and_prints_on_a4() {
    if !chromium::is_wanted() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let store = four_sessions();
    let sessions = store.course("P-17").unwrap();
    let mut browser = Browser::open("about:blank").await;
    for language in [Language::English, Language::German] {
        let reader = report::Reader { language, time_zone: TimeZone::UTC };
        let path = folder.path().join("session.html");
        std::fs::write(&path, report::session(&sessions[0], &reader)).unwrap();
        let drawings = look_at(&mut browser, &path).await;
        assert_eq!(drawings.len(), 2, "a drawing for each knee");
        for [taught, done] in drawings {
            // Both begin and end at the same angle, the lower end, and go as far as their numbers say.
            assert!(taught[0] >= 0.0 && done[0] > taught[0] + 10.0, "{taught:?}, {done:?}");
            let share = (done[1] - done[0]) / (taught[1] - taught[0]);
            assert!((share - DONE_DEG / TAUGHT_DEG).abs() < 0.1, "{taught:?}, {done:?}");
        }
        assert_eq!(print(&mut browser).await, (1, true));
        if language == Language::English {
            browser.picture("report").await;
        }
        let path = folder.path().join("weeks.html");
        std::fs::write(&path, report::course("P-17", &sessions, &reader)).unwrap();
        let drawings = look_at(&mut browser, &path).await;
        assert!(drawings.len() > 2 && drawings.iter().all(|[_, done]| done[0] >= 0.0), "{drawings:?}");
        let (pages, is_a4) = print(&mut browser).await;
        assert!((1..=3).contains(&pages) && is_a4, "{pages}");
    }
    assert_eq!(browser.complaints, Vec::<String>::new());
}
