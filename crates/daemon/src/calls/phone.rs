//! Calls `phone.*`: how phones come, and which have.

use serde_json::{Map, Value, json};

use super::super::find::proposal::free;
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
    let mut ids: Vec<String> =
        ids.into_iter().flatten().filter_map(|id| id.as_str().map(str::to_owned)).collect();
    // One that the file names already has lost its sensor only.
    let number = ids.iter().position(|known| known == id).map_or(ids.len() + 1, |at| at + 1);
    if number > ids.len() {
        ids.push(id.to_owned());
    }
    let device = there.and_then(|device| text_of(device, "name"));
    let (device, first) = match device {
        Some(name) => {
            let value = Some(Value::from(ids));
            let key = "devices".to_owned();
            (name.clone(), Change::Set { table: Table::Device, name, key, value })
        }
        None => {
            let name = free(DEVICE, &taken);
            let keys = table(json!({"name": name, "driver": DRIVER, "port": PORT, "devices": ids}));
            (name, Change::Add { table: Table::Device, keys })
        }
    };
    let name = free(&named(called), &taken);
    let keys = table(json!({"name": name, "device": device, "address": number}));
    vec![first, Change::Add { table: Table::Sensor, keys }]
}

fn table(keys: Value) -> Map<String, Value> {
    match keys {
        Value::Object(keys) => keys,
        _ => Map::new(),
    }
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
