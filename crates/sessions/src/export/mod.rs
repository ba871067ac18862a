//! Sessions for other programs.
//!
//! What comes in: sessions. What goes out: JSON (all there is), CSV (one line per repetition), FHIR R4 (one `Observation` per exercise
//! and session). What it never does: leave out a unit.

mod fhir;
mod table;

pub use fhir::bundle as fhir;
pub use table::csv;

use crate::Session;

/// All there is, as one JSON array.
///
/// # Errors
/// A number is not finite.
pub fn json(sessions: &[Session]) -> Result<String, serde_json::Error> {
    let mut text = serde_json::to_string_pretty(sessions)?;
    text.push('\n');
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::EndedBy;
    use crate::testing::{lesson, rejected, repetition};
    use crate::{NewSession, Store};

    fn sessions() -> Vec<Session> {
        let mut store = Store::in_memory().unwrap();
        let curl = lesson("biceps curl", 1, 80.0);
        for person in ["A", "B"] {
            let session = store.begin(&NewSession { person, ..NewSession::default() }).unwrap();
            store.add(session, &repetition(&curl, 1, 5.0, 70.0)).unwrap();
            store.add(session, &rejected(&curl, 9.0)).unwrap();
            if person == "A" {
                store.end(session, 20.4, EndedBy::Request).unwrap();
            }
        }
        [1, 2].map(|session| store.session(session).unwrap()).to_vec()
    }

    #[test]
    fn a_table_has_a_line_per_repetition_and_empty_cells_for_what_is_absent() {
        let text = csv(&sessions()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 5);
        assert!(
            lines[0].ends_with(
                "elbow_r_flexion_least_deg,elbow_r_flexion_greatest_deg,elbow_r_flexion_range_deg"
            )
        );
        let first = "1,A,1970-01-01T00:00:00Z,1,biceps curl,10,,1,5,7.1,7.4,2.1,,81,70,100,95.5,,,,5,75,70";
        assert_eq!(lines[1], first);
        assert_eq!(
            lines[2],
            "1,A,1970-01-01T00:00:00Z,1,biceps curl,10,,,9,11.1,11.4,2.1,too_small,,,,,,,,5,25,20"
        );
    }

    #[test]
    fn a_bundle_names_each_person_once_and_each_figure_with_its_unit() {
        let bundle = fhir(&sessions());
        let entries = bundle["entry"].as_array().unwrap();
        assert_eq!((bundle["type"].as_str(), entries.len()), (Some("collection"), 4));
        let mut urls: Vec<&str> = entries.iter().map(|entry| entry["fullUrl"].as_str().unwrap()).collect();
        urls.sort_unstable();
        urls.dedup();
        assert_eq!(urls.len(), 4, "every address is one entry's own");
        let [first, second] = [&entries[2]["resource"], &entries[3]["resource"]];
        assert_eq!(
            (first["status"].as_str(), second["status"].as_str()),
            (Some("final"), Some("preliminary"))
        );
        assert_eq!(first["subject"]["reference"], entries[0]["fullUrl"]);
        assert_eq!(first["effectivePeriod"]["end"], "1970-01-01T00:00:20Z");
        let components = first["component"].as_array().unwrap();
        let of = |code: &str| {
            let component =
                components.iter().find(|component| component["code"]["coding"][0]["code"] == code);
            let quantity = &component.unwrap()["valueQuantity"];
            (quantity["value"].as_f64().unwrap(), quantity["code"].as_str().unwrap())
        };
        assert_eq!((of("repetitions"), of("range-elbow-r-flexion")), ((1.0, "1"), (70.0, "deg")));
        assert_eq!((of("score"), of("duration")), ((81.0, "{score}"), (2.1, "s")));
        assert!(fhir(&[]).get("entry").is_none(), "an empty list is none in FHIR");
    }

    #[test]
    fn all_there_is_can_be_read_again_as_json() {
        let value: serde_json::Value = serde_json::from_str(&json(&sessions()).unwrap()).unwrap();
        let repetition = &value[0]["training"][0]["repetitions"][0];
        assert_eq!(
            (repetition["score"]["total"].as_f64(), repetition["number"].as_u64()),
            (Some(81.0), Some(1))
        );
        assert_eq!(repetition["joints"][0]["course_deg"].as_array().unwrap().len(), crate::POINTS);
        assert_eq!(value[0]["training"][0]["lesson"]["exercise"], "biceps curl");
    }
}
