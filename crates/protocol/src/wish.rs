//! What somebody wants of a stage's states: which topics, how often, which fields of which sensors.
//!
//! Events are not here: nobody may miss one, and they are few.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{Field, Fields, Topic, View};
use posed_stage::input::SensorIndex;

/// Sensors that are named one by one; who wants more gets all.
const NAMED: usize = 64;
/// Most messages per second that a wish may ask for: more than any device sends.
const MOST_HZ: f64 = 1e4;

/// Some of what there is of a frame.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Selection {
    /// What of each sensor.
    pub fields: Fields,
    /// Indices of the sensors, ascending; `None` is all.
    pub sensors: Option<Box<[SensorIndex]>>,
}

impl Selection {
    /// All there is.
    pub fn whole() -> Self {
        Self { fields: Fields::all(), sensors: None }
    }

    /// Nothing but names and states, of no sensor.
    pub fn nothing() -> Self {
        Self { fields: Fields::of(&[]), sensors: Some(Box::default()) }
    }

    /// Whether everything that the view shows is in it.
    pub fn covers(&self, view: &View) -> bool {
        let sensors = match (&self.sensors, &view.sensors) {
            (None, _) => true,
            (Some(_), None) => false,
            (Some(held), Some(shown)) => shown.iter().all(|sensor| held.binary_search(sensor).is_ok()),
        };
        sensors && self.fields.holds(view.fields)
    }

    /// Takes in what the view shows too.
    pub fn add(&mut self, fields: Fields, sensors: Option<&[SensorIndex]>) {
        self.fields = self.fields.with(fields);
        self.sensors = match (self.sensors.take(), sensors) {
            (Some(held), Some(more)) => {
                let mut all = [&held, more].concat();
                all.sort_unstable();
                all.dedup();
                Some(all.into_boxed_slice()).filter(|all| all.len() <= NAMED)
            }
            _ => None,
        };
    }

    /// Whether a sensor is in it.
    pub fn has_sensor(&self, sensor: SensorIndex) -> bool {
        self.sensors.as_ref().is_none_or(|chosen| chosen.binary_search(&sensor).is_ok())
    }
}

/// Which states are wanted: the union of what several want, each topic at the highest of their rates.
#[derive(Clone, Debug, PartialEq)]
pub struct Wish {
    /// Topics, and messages per second at most; `None`: all of them.
    topics: BTreeMap<Topic, Option<f64>>,
    /// Of `sensors`.
    selection: Selection,
}

/// As it is written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    topics: BTreeMap<Topic, Option<f64>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    fields: Vec<Field>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sensors: Option<Vec<SensorIndex>>,
}

impl Default for Wish {
    fn default() -> Self {
        Self { topics: BTreeMap::new(), selection: Selection::nothing() }
    }
}

impl Wish {
    /// Nothing is wanted.
    pub fn is_empty(&self) -> bool {
        self.topics.is_empty()
    }

    /// Whether states of the topic are wanted.
    pub fn has(&self, topic: Topic) -> bool {
        self.topics.contains_key(&topic)
    }

    /// Messages per second of a topic that is wanted; `None`: all of them.
    pub fn max_rate_hz(&self, topic: Topic) -> Option<f64> {
        self.topics.get(&topic).copied().flatten()
    }

    /// What is wanted of one topic only.
    #[must_use]
    pub fn of_topic(mut self, topic: Topic) -> Self {
        self.topics.retain(|other, _| *other == topic);
        if topic != Topic::Sensors {
            self.selection = Selection::nothing();
        }
        self
    }

    /// What is wanted of `sensors`.
    pub fn selection(&self) -> &Selection {
        &self.selection
    }

    /// Wants a topic too. Of events nothing is noted.
    pub fn add(&mut self, topic: Topic, max_rate_hz: Option<f64>) {
        if topic.is_event() {
            return;
        }
        let rate = self.topics.entry(topic).or_insert(max_rate_hz);
        *rate = match (*rate, max_rate_hz) {
            (Some(one), Some(other)) => Some(one.max(other)),
            _ => None,
        };
    }

    /// Wants so much of `sensors` too.
    pub fn select(&mut self, fields: Fields, sensors: Option<&[SensorIndex]>) {
        self.selection.add(fields, sensors);
    }

    /// Wants what another wants too.
    pub fn join(&mut self, other: &Self) {
        other.topics.iter().for_each(|(topic, rate)| self.add(*topic, *rate));
        self.select(other.selection.fields, other.selection.sensors.as_deref());
    }

    /// As one line of JSON.
    pub fn to_json(&self) -> String {
        let Self { topics, selection: Selection { fields, sensors } } = self;
        let written = Written {
            topics: topics.clone(),
            fields: fields.list(),
            sensors: sensors.as_ref().map(|all| all.to_vec()),
        };
        // Its keys are words and its numbers finite: JSON cannot refuse it.
        serde_json::to_string(&written).unwrap_or_default()
    }

    /// Reads what [`Self::to_json`] wrote; `None` of anything else, and of a rate that is none.
    pub fn from_json(text: &str) -> Option<Self> {
        let Written { topics, fields, sensors } = serde_json::from_str(text).ok()?;
        let is_rate = |rate: &Option<f64>| rate.is_none_or(|rate| rate > 0.0 && rate <= MOST_HZ);
        if !topics.values().all(is_rate) {
            return None;
        }
        let mut wish = Self::default();
        topics.into_iter().for_each(|(topic, rate)| wish.add(topic, rate));
        wish.select(Fields::of(&fields), sensors.as_deref());
        Some(wish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Encoding;

    fn view(fields: &[Field], sensors: Option<&[SensorIndex]>) -> View {
        View { encoding: Encoding::Json, fields: Fields::of(fields), sensors: sensors.map(Into::into) }
    }

    #[test]
    fn a_wish_is_what_all_want_and_reads_as_it_is_written() {
        let mut wish = Wish::default();
        assert!(wish.is_empty());
        wish.add(Topic::Sensors, Some(20.0));
        wish.add(Topic::Sensors, Some(60.0));
        wish.add(Topic::Faults, None);
        wish.select(Fields::of(&[Field::PositionM]), Some(&[4, 1]));
        let mut other = Wish::default();
        other.add(Topic::Body, None);
        other.add(Topic::Sensors, Some(30.0));
        other.select(Fields::of(&[Field::Measured]), Some(&[2]));
        wish.join(&other);
        assert_eq!((wish.max_rate_hz(Topic::Sensors), wish.has(Topic::Faults)), (Some(60.0), false));
        let all = [Field::PositionM, Field::Measured];
        assert!(wish.selection().covers(&view(&all, Some(&[1, 2, 4]))));
        assert!(!wish.selection().covers(&view(&all, Some(&[1, 3]))), "a sensor that nobody wants");
        assert!(!wish.selection().covers(&view(&all, None)));
        assert!(!wish.selection().covers(&view(&[Field::Covariance], Some(&[1]))));
        let json = wish.to_json();
        assert_eq!(
            json,
            r#"{"topics":{"sensors":60.0,"body":null},"fields":["name","state","position_m","measured"],"sensors":[1,2,4]}"#
        );
        assert_eq!(Wish::from_json(&json), Some(wish.clone()));
        wish.add(Topic::Sensors, None);
        assert_eq!(wish.max_rate_hz(Topic::Sensors), None, "somebody wants all of them");
        wish.select(Fields::all(), None);
        assert_eq!(wish.selection(), &Selection::whole());
        assert_eq!(Wish::from_json(&wish.to_json()), Some(wish));
    }

    #[test]
    fn what_is_no_wish_is_refused_and_long_lists_ask_for_all() {
        for text in [
            "",
            "{",
            "[]",
            "null",
            r#"{"topics":{"sensors":0.0}}"#,
            r#"{"topics":{"sensors":-1.0}}"#,
            r#"{"topics":{"sensors":1e300}}"#,
            r#"{"topics":{"everything":1.0}}"#,
            r#"{"topics":{},"more":1}"#,
            r#"{"topics":{"sensors":1.0},"fields":["secret"]}"#,
            r#"{"topics":{"sensors":1.0},"sensors":[70000]}"#,
        ] {
            assert_eq!(Wish::from_json(text), None, "{text}");
        }
        let many: Vec<SensorIndex> = (0..2000).collect();
        let text = serde_json::json!({"topics": {"sensors": 1.0}, "sensors": many}).to_string();
        assert_eq!(Wish::from_json(&text).unwrap().selection().sensors, None);
    }
}
