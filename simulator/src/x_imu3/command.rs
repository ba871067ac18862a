//! What each command does.

use std::collections::BTreeMap;
use std::time::Duration;

use posed_drivers::Timestamp;
use posed_drivers::x_imu3::wire::{self, MUX};
use serde_json::{Map, Value, json};

use super::{ANSWER, Member, XImu3};
use crate::chassis::{Chassis, Unit};

/// From the last write until the settings act by themselves.
const SETTLE: Duration = Duration::from_secs(2);

/// Settings of a new unit, by plain key.
pub(super) fn defaults() -> BTreeMap<String, Value> {
    [
        ("binarymodeenabled", json!(true)),
        ("ahrsmessagetype", json!(0)),
        ("ahrsaxesconvention", json!(0)),
        ("ahrsignoremagnetometer", json!(false)),
        ("axesalignment", json!(0)),
        ("inertialmessageratedivisor", json!(8)),
        ("magnetometermessageratedivisor", json!(1)),
        ("ahrsmessageratedivisor", json!(8)),
        ("highgaccelerometermessageratedivisor", json!(64)),
        ("temperaturemessageratedivisor", json!(5)),
        ("serialbaudrate", json!(115_200)),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into()
}

/// What was written comes into force.
pub(super) fn apply(member: &mut Member) {
    member.written_at = None;
    let before = member.number("inertialmessageratedivisor");
    member.settings.append(&mut member.written);
    if member.number("inertialmessageratedivisor") != before {
        member.pending.clear();
    }
}

impl XImu3 {
    /// A line of the host, without its LF.
    pub(super) fn command(&mut self, chassis: &mut Chassis, t: Timestamp, line: &[u8]) {
        let mut rest = line;
        let mut address = 0u16;
        let mut to_all = false;
        while let [MUX, channel, inner @ ..] = rest {
            to_all |= *channel == MUX;
            address = address << 8 | u16::from(*channel);
            rest = inner;
        }
        let Ok(object) = serde_json::from_slice::<Map<String, Value>>(rest) else { return };
        let Some((key, value)) = object.into_iter().next() else { return };
        for k in 0..self.members.len() {
            if (to_all || self.members[k].address == address) && !self.is_quiet(chassis, k, t) {
                let answer = self.obey(chassis, t, k, &wire::plain_key(&key), &value);
                let bytes = wire::command(self.members[k].address, &key, &answer);
                self.answers.push_back((t + ANSWER, bytes));
            }
        }
    }

    fn obey(&mut self, chassis: &mut Chassis, t: Timestamp, k: usize, key: &str, value: &Value) -> Value {
        let time_us = self.time_us(chassis, t);
        let interface = if self.is_on_network { "UDP" } else { "Serial" };
        let member = &mut self.members[k];
        match key {
            "ping" => {
                let name = format!("x-IMU3 {}", member.address);
                json!({ "interface": interface, "name": name, "sn": member.serial })
            }
            "serialnumber" => json!(member.serial),
            "firmwareversion" => json!("v1.3.0"),
            "time" => json!(time_us),
            "apply" => {
                apply(member);
                self.wrong_until = None;
                Value::Null
            }
            "save" | "strobe" | "initialise" | "note" | "heading" => value.clone(),
            "reset" => {
                // All units of a link share its power here.
                let at = t + ANSWER;
                chassis.power_cycle(at);
                self.reset(chassis, at);
                Value::Null
            }
            _ => {
                let Some(in_force) = member.settings.get(key) else {
                    return json!({ "error": "Unknown command" });
                };
                if value.is_null() {
                    return in_force.clone();
                }
                if value.is_boolean() != in_force.is_boolean() {
                    return json!({ "error": "Invalid value" });
                }
                member.written.insert(key.to_owned(), value.clone());
                member.written_at = Some(t + SETTLE);
                value.clone()
            }
        }
    }
}
