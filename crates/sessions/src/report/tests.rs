//! Reports say what the repetitions say, in both languages, and hold nothing that is loaded.

use jiff::tz::TimeZone;

use super::*;
use crate::session::EndedBy;
use crate::testing::{lesson, rejected, repetition};
use crate::{NewSession, Session, Store};

fn reader(language: Language) -> Reader {
    Reader { language, time_zone: TimeZone::UTC }
}

/// A course of weeks in which an elbow goes 4 degrees farther each time.
fn weeks(weeks: u32, person: &str) -> Vec<Session> {
    let mut store = Store::in_memory().unwrap();
    let curl = lesson("curl", 2, 80.0);
    for week in 0..weeks {
        let epoch_utc_ns = 1_700_000_000_000_000_000 + i64::from(week) * 7 * 86_400 * 1_000_000_000;
        let new =
            NewSession { person, stage: "clinic", subject: "default", epoch_utc_ns, ..Default::default() };
        let session = store.begin(&new).unwrap();
        let range_deg = 60.0 + 4.0 * f64::from(week);
        for number in 1..=5 {
            store.add(session, &repetition(&curl, number, 5.0 * f64::from(number), range_deg)).unwrap();
        }
        store.add(session, &rejected(&curl, 60.0)).unwrap();
        store.end(session, 75.0, EndedBy::Request).unwrap();
    }
    store.course(person).unwrap()
}

#[test]
fn a_session_says_counts_scores_ranges_and_the_sentence_in_both_languages() {
    let session = &weeks(1, "P-1")[0];
    let english = super::session(session, &reader(Language::English));
    for part in [
        "<title>P-1, 2023-11-14 22:13</title>",
        "5 repetitions counted (planned 10), 1 not counted",
        // Set 1: counted, not counted, score, amplitude, tempo, smoothness, symmetry, duration.
        "<tr><td>1</td><td>5</td><td>1</td><td>83</td><td>60</td><td>100</td><td>96</td><td>–</td><td>2.1</td></tr>",
        "<tr><td>right elbow, flexion</td><td>60</td><td>77</td><td>5</td><td>65</td></tr>",
        "right elbow bent 20 degrees less than shown at the top” (1 ×)",
    ] {
        assert!(english.contains(part), "{part} is not in {english}");
    }
    assert_eq!(english.matches("class=\"own\"").count(), 10);
    let german = super::session(session, &reader(Language::German));
    for part in [
        "5 Wiederholungen gezählt (geplant 10), 1 nicht gezählt",
        "14.11.2023 22:13",
        "<td>2,1</td>",
        "rechter Ellenbogen, Beugung",
    ] {
        assert!(german.contains(part), "{part} is not in {german}");
    }
}

#[test]
fn a_course_says_the_first_the_last_and_the_trend() {
    let sessions = weeks(6, "P-1");
    let report = course("P-1", &sessions, &reader(Language::English));
    let row = "<tr><td>right elbow, flexion (°)</td><td>60</td><td>80</td><td>77</td><td>4.0</td></tr>";
    assert!(report.contains(row), "{report}");
    assert!(report.contains("6 sessions · 2023-11-14 – 2023-12-19"), "{report}");
    assert!(course("P-1", &[], &reader(Language::German)).contains("Es gibt noch keine Sitzung."));
}

#[test]
fn a_name_is_no_tag_and_nothing_is_loaded() {
    let sessions = weeks(3, "<script>alert(1)</script>");
    for language in [Language::English, Language::German] {
        for text in [
            super::session(&sessions[0], &reader(language)),
            course(&sessions[0].summary.person, &sessions, &reader(language)),
        ] {
            assert!(!text.contains("<script") && text.contains("&lt;script&gt;"));
            assert!(
                !["http:", "https:", "src=", "url(", "href="].iter().any(|outside| text.contains(outside)),
                "{text}"
            );
        }
    }
}
