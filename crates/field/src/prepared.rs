//! A map in use: shared, swapped as a whole, and made fast once.

use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::corrector::Corrector;
use super::map::FieldMap;

/// A map and its fast form. Clones share the map, and the fast form whichever of them makes it; files and logs hold the map alone,
/// and the fast form follows from it.
#[derive(Clone, Debug)]
pub struct Prepared {
    map: Arc<FieldMap>,
    corrector: Arc<OnceLock<Corrector>>,
}

impl Prepared {
    /// A map whose fast form is not made yet.
    pub fn new(map: FieldMap) -> Self {
        Self { map: Arc::new(map), corrector: Arc::default() }
    }

    /// The map as it was given.
    pub fn map(&self) -> &FieldMap {
        &self.map
    }

    /// The fast form. The first call makes it, which takes a good part of a second: call it on a thread that has time
    /// before the map goes to one that has none.
    pub fn corrector(&self) -> &Corrector {
        self.corrector.get_or_init(|| self.map.corrector())
    }
}

impl PartialEq for Prepared {
    fn eq(&self, other: &Self) -> bool {
        self.map == other.map
    }
}

impl Serialize for Prepared {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.map.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Prepared {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        FieldMap::deserialize(deserializer).map(Self::new)
    }
}
