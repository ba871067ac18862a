//! Calls `phone.*`: how phones come, and which have.

use serde_json::json;

use super::super::find::proposal::{Joined, Newcomer, free, join, list};
use super::super::server::phones::{Connected, Phones};
use super::{Calls, Refusal};
use posed_protocol::{Answer, Phone};
use posed_stage::edit::{Change, Table};

/// The driver of devices that speak the open format, and their port on the daemon's own websocket.
const DRIVER: &str = "open-imu";
const PORT: &str = "websocket";
/// What such a device is called in a stage file that has none.
const DEVICE: &str = "phones";

impl Calls {
    fn phones(&self) -> Result<&Phones, Refusal> {
        self.phones.as_ref().ok_or_else(|| Refusal::new("live", "phones come to a live stage"))
    }

    pub(super) fn invite_phone(&self) -> Result<Option<Answer>, Refusal> {
        let invitation = self.phones()?.invite().map_err(Refusal::failed)?;
        Ok(Some(Answer::Invitation(invitation)))
    }

    pub(super) fn blink_phone(&self, id: &str) -> Result<Option<Answer>, Refusal> {
        let shown = self.phones()?.gate().blink(id);
        if shown { Ok(None) } else { Err(Refusal::new("not_connected", format!("`{id}` is not connected"))) }
    }

    pub(super) fn list_phones(&self) -> Result<Option<Answer>, Refusal> {
        let phones = self.phones()?;
        let placing = phones.placing();
        let connected = phones.gate().connected();
        let keys: toml::Table = toml::from_str(&self.file.read()?).unwrap_or_default();
        let list = connected.into_iter().map(|Connected { peer, hello, orientation_wxyz }| {
            let sensor = placing.sensor(&hello.id).map(str::to_owned);
            let adds = if sensor.is_some() { Vec::new() } else { additions(&keys, &hello.id, &hello.name) };
            Phone {
                phone_id: hello.id,
                phone_name: hello.name,
                peer: peer.to_string(),
                orientation_wxyz,
                sensor,
                adds,
            }
        });
        Ok(Some(Answer::Phones(posed_protocol::Phones { phones: list.collect() })))
    }
}

/// The changes of a stage file that make a device one of its sensors.
fn additions(keys: &toml::Table, id: &str, called: &str) -> Vec<Change> {
    let tables =
        |key: &str| keys.get(key).and_then(toml::Value::as_array).map(Vec::as_slice).unwrap_or_default();
    let text_of =
        |table: &toml::Value, key: &str| table.get(key).and_then(toml::Value::as_str).map(str::to_owned);
    let taken: Vec<String> =
        tables("device").iter().chain(tables("sensor")).filter_map(|table| text_of(table, "name")).collect();
    let there = tables("device").iter().find(|device| text_of(device, "port").as_deref() == Some(PORT));
    let ids = there.and_then(|device| device.get("devices")).and_then(toml::Value::as_array);
    let ids: Vec<String> =
        ids.into_iter().flatten().filter_map(|id| id.as_str().map(str::to_owned)).collect();
    let device = there.and_then(|device| text_of(device, "name"));
    let name = device.clone().unwrap_or_else(|| free(DEVICE, &taken));
    let newcomer = Newcomer { id: id.to_owned(), sensor: 0, called: named(called) };
    let Joined { listed, sensors, .. } = join(&name, &ids, [newcomer], taken);
    let first = match device {
        Some(name) => list(&name, listed),
        None => {
            let keys = [
                ("name", json!(name)),
                ("driver", json!(DRIVER)),
                ("port", json!(PORT)),
                ("devices", json!(listed)),
            ];
            let keys = keys.map(|(key, value)| (key.to_owned(), value)).into_iter().collect();
            Change::Add { table: Table::Device, keys }
        }
    };
    std::iter::once(first).chain(sensors).collect()
}

/// What a sensor is called whose device is called so.
fn named(called: &str) -> String {
    let name: String = called.chars().filter(|letter| !letter.is_control()).take(64).collect();
    match name.trim() {
        "" => "phone".to_owned(),
        name => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use posed_stage::Stage;
    use posed_stage::edit::edit;

    use super::*;

    fn additions(text: &str, id: &str, called: &str) -> Vec<Change> {
        super::additions(&toml::from_str(text).unwrap(), id, called)
    }

    #[test]
    fn one_phone_after_the_other_becomes_a_sensor() {
        let mut text = "name = \"Stage\"\n".to_owned();
        for (id, called) in [("p-1", "Left"), ("p-2", "Left"), ("p-3", "")] {
            text = edit(&text, &additions(&text, id, called)).unwrap();
        }
        let stage = Stage::parse(&text).unwrap();
        assert_eq!((stage.devices.len(), stage.devices[0].name.as_str()), (1, "phones"));
        let sensors: Vec<(&str, u16)> = stage.sensors.iter().map(|s| (s.name.as_str(), s.address)).collect();
        assert_eq!(sensors, [("Left", 1), ("Left-2", 2), ("phone", 3)]);
        // One whose sensor somebody has removed keeps its number.
        let removed =
            edit(&text, &[Change::Remove { table: Table::Sensor, name: "Left-2".to_owned() }]).unwrap();
        let again = edit(&removed, &additions(&removed, "p-2", "Thigh")).unwrap();
        let stage = Stage::parse(&again).unwrap();
        assert!(stage.sensors.iter().any(|sensor| (sensor.name.as_str(), sensor.address) == ("Thigh", 2)));
    }
}
