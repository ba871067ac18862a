//! Models and requests as clients, files and logs bring them.

use serde::Deserialize;

use posed_field::{FieldMap, Prepared};
use posed_fusion::intrinsics::Intrinsics;
use posed_motion::exercise::Exercise;
use posed_motion::fault_map::FaultMap;
use posed_stage::input::{Input, Model, Request};

use crate::log::put_in;
use crate::stand::STANDS;

/// Most inputs that are tried one after the other.
const MOST: usize = 8;

/// What a client asks for.
#[derive(Deserialize)]
#[serde(untagged)]
enum Wish {
    Model(Model),
    Request(Request),
}

/// JSON: a model, a list of models and requests, or a file of one. Else MessagePack: a list of inputs, as in a log. What a
/// pipeline takes, it writes and reads again, and tracks on with it.
///
/// # Panics
/// That does not hold.
pub(crate) fn model(data: &[u8]) {
    let inputs = read(data);
    inputs.iter().for_each(prepare);
    for stand in &*STANDS {
        for input in &inputs {
            survives_being_written(input);
        }
        put_in(stand, inputs.iter().cloned());
    }
}

fn read(data: &[u8]) -> Vec<Input> {
    let wish = |wish| match wish {
        Wish::Model(model) => Input::Model(model),
        Wish::Request(request) => Input::Request(request),
    };
    match data.first() {
        Some(b'[') => {
            let wishes = serde_json::from_slice::<Vec<Wish>>(data).unwrap_or_default();
            wishes.into_iter().take(MOST).map(wish).collect()
        }
        Some(b'{') => match serde_json::from_slice::<Wish>(data) {
            Ok(one) => vec![wish(one)],
            Err(_) => file(data).into_iter().map(Input::Model).collect(),
        },
        _ => {
            let mut inputs = posed_protocol::unpack::<Vec<Input>>(data).unwrap_or_default();
            inputs.truncate(MOST);
            inputs
        }
    }
}

/// A model out of its own file.
fn file(text: &[u8]) -> Option<Model> {
    if let Ok(map) = FieldMap::from_json(text) {
        return Some(Model::Field { version: 1, map: Some(Prepared::new(map)) });
    }
    if let Ok(intrinsics) = Intrinsics::from_json(text) {
        return Some(Model::Imu { unit: "1".to_owned(), intrinsics: Box::new(intrinsics) });
    }
    if let Ok(exercise) = Exercise::from_json(std::str::from_utf8(text).ok()?) {
        return Some(Model::Exercise { exercise: Box::new(exercise) });
    }
    let fault_map = serde_json::from_slice::<FaultMap>(text).ok()?;
    Some(Model::Faults { fault_map: Box::new(fault_map) })
}

/// As whoever loads a map: the thread that tracks has no time for it.
fn prepare(input: &Input) {
    if let Input::Model(model) = input
        && let Model::Field { map: Some(map), .. } = model
        && model.check().is_ok()
    {
        map.corrector();
    }
}

/// What may be used comes out of a recording as it went in.
fn survives_being_written(input: &Input) {
    let Input::Model(model) = input else { return };
    if model.check().is_err() {
        return;
    }
    let bytes = rmp_serde::to_vec_named(model).expect("plain data");
    let again: Model = rmp_serde::from_slice(&bytes).expect("what was written");
    // By its bytes: a NaN beside the numbers that are checked is not equal to itself.
    assert!(rmp_serde::to_vec_named(&again).expect("plain data") == bytes, "a model changed");
}
