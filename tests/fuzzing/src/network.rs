//! Files of segmentation networks.

use posed_motion::segments::Model;
use posed_stage::input::Input;

use crate::log::put_in;
use crate::stand::STANDS;

/// A network that is accepted is written and read again as it is, and a stage tracks on with it.
///
/// # Panics
/// That does not hold.
pub(crate) fn network(data: &[u8]) {
    let Ok(model) = Model::from_bytes(data) else { return };
    let bytes = model.to_bytes().expect("what was read can be written");
    let again = Model::from_bytes(&bytes).expect("what was written can be read");
    assert!(again.to_bytes().expect("and written") == bytes, "a network changed");
    put_in(&STANDS[0], [Input::SegmentationNetwork(data.to_vec())]);
}
