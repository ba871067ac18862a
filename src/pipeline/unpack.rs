//! MessagePack read by the type that is asked for.
//!
//! What comes in: what `rmp_serde::to_vec_named` wrote of plain data. What goes out: the data. What it never does: read
//! a struct without the names of its fields.
//!
//! `rmp` reads the bytes; only the way to serde is of this file. `rmp_serde`'s own takes whatever comes, so every type
//! gets code for all that may: for the state of the pipeline that was a third of what the compiler had to do.

use rmp::decode::{read_array_len, read_bin_len, read_map_len, read_str_len};
use rmp_serde::decode::Error;
use serde::de::{
    DeserializeOwned, DeserializeSeed, Deserializer, EnumAccess, MapAccess, SeqAccess, Unexpected,
};
use serde::de::{Error as _, VariantAccess, Visitor};
use serde::{Deserialize, forward_to_deserialize_any};

/// Reads all of `bytes`.
///
/// # Errors
/// They are not what was written of a `T`.
pub(super) fn from_slice<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Error> {
    let mut unpack = Unpack { rest: bytes };
    let value = T::deserialize(&mut unpack)?;
    if unpack.rest.is_empty() { Ok(value) } else { Err(Error::LengthMismatch(unpack.rest.len() as u32)) }
}

struct Unpack<'a> {
    rest: &'a [u8],
}

const NIL: u8 = 0xc0;

impl Unpack<'_> {
    /// Small enough to leave to `rmp_serde`.
    fn scalar<'de, T: Deserialize<'de>>(&mut self) -> Result<T, Error> {
        T::deserialize(&mut rmp_serde::Deserializer::new(&mut self.rest))
    }

    fn take(&mut self, length: u32) -> Result<&[u8], Error> {
        let (taken, rest) = self.rest.split_at_checked(length as usize).ok_or_else(ended)?;
        self.rest = rest;
        Ok(taken)
    }

    fn text(&mut self) -> Result<&str, Error> {
        let length = read_str_len(&mut self.rest)?;
        str::from_utf8(self.take(length)?).map_err(Error::Utf8Error)
    }
}

fn ended() -> Error {
    Error::InvalidDataRead(std::io::ErrorKind::UnexpectedEof.into())
}

macro_rules! plain {
    ($($method:ident $visit:ident $read:ident)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
            visitor.$visit(self.$read()?)
        })*
    };
}

impl<'de> Deserializer<'de> for &mut Unpack<'_> {
    type Error = Error;

    plain! {
        deserialize_bool visit_bool scalar
        deserialize_i8 visit_i8 scalar
        deserialize_i16 visit_i16 scalar
        deserialize_i32 visit_i32 scalar
        deserialize_i64 visit_i64 scalar
        deserialize_u8 visit_u8 scalar
        deserialize_u16 visit_u16 scalar
        deserialize_u32 visit_u32 scalar
        deserialize_u64 visit_u64 scalar
        deserialize_f32 visit_f32 scalar
        deserialize_f64 visit_f64 scalar
        deserialize_char visit_char scalar
        deserialize_str visit_str text
        deserialize_string visit_str text
        deserialize_identifier visit_str text
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let length = read_bin_len(&mut self.rest)?;
        visitor.visit_bytes(self.take(length)?)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_bytes(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        if let [NIL, rest @ ..] = self.rest {
            self.rest = rest;
            return visitor.visit_none();
        }
        visitor.visit_some(self)
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(self, _: &str, visitor: V) -> Result<V::Value, Error> {
        match read_array_len(&mut self.rest)? {
            0 => visitor.visit_unit(),
            length => Err(Error::LengthMismatch(length)),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(self, _: &str, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let left = read_array_len(&mut self.rest)?;
        Items { unpack: self, left }.all(|items| visitor.visit_seq(items))
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &str,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        let left = read_map_len(&mut self.rest)?;
        Items { unpack: self, left }.all(|items| visitor.visit_map(items))
    }

    fn deserialize_struct<V: Visitor<'de>>(self, _: &str, _: &[&str], visitor: V) -> Result<V::Value, Error> {
        self.deserialize_map(visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(self, _: &str, _: &[&str], visitor: V) -> Result<V::Value, Error> {
        // A name alone, or a map from the name to what it holds.
        let holds = !matches!(self.rest, [0xa0..=0xbf | 0xd9..=0xdb, ..]);
        if holds && read_map_len(&mut self.rest)? != 1 {
            return Err(Error::invalid_type(Unexpected::Map, &"one variant"));
        }
        visitor.visit_enum(Variant { unpack: self, holds })
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Error> {
        rmp_serde::Deserializer::new(&mut self.rest).deserialize_any(visitor)
    }

    forward_to_deserialize_any! { i128 u128 unit ignored_any }

    fn is_human_readable(&self) -> bool {
        false
    }
}

/// What is left of an array or a map.
struct Items<'a, 'b> {
    unpack: &'a mut Unpack<'b>,
    left: u32,
}

impl Items<'_, '_> {
    /// What `visit` makes of them; it must take them all.
    fn all<T>(mut self, visit: impl FnOnce(&mut Self) -> Result<T, Error>) -> Result<T, Error> {
        let value = visit(&mut self)?;
        if self.left == 0 { Ok(value) } else { Err(Error::LengthMismatch(self.left)) }
    }

    fn next(&mut self) -> bool {
        let more = self.left > 0;
        self.left -= u32::from(more);
        more
    }

    /// A length of the file's own words is not to be trusted with memory.
    fn hint(&self) -> usize {
        (self.left as usize).min(self.unpack.rest.len())
    }
}

impl<'de> SeqAccess<'de> for &mut Items<'_, '_> {
    type Error = Error;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Error> {
        if self.next() { seed.deserialize(&mut *self.unpack).map(Some) } else { Ok(None) }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.hint())
    }
}

impl<'de> MapAccess<'de> for &mut Items<'_, '_> {
    type Error = Error;

    fn next_key_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Error> {
        if self.next() { seed.deserialize(&mut *self.unpack).map(Some) } else { Ok(None) }
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, Error> {
        seed.deserialize(&mut *self.unpack)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.hint())
    }
}

struct Variant<'a, 'b> {
    unpack: &'a mut Unpack<'b>,
    holds: bool,
}

impl<'de> EnumAccess<'de> for Variant<'_, '_> {
    type Error = Error;
    type Variant = Self;

    fn variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<(T::Value, Self), Error> {
        let variant = seed.deserialize(&mut *self.unpack)?;
        Ok((variant, self))
    }
}

impl<'de> VariantAccess<'de> for Variant<'_, '_> {
    type Error = Error;

    fn unit_variant(self) -> Result<(), Error> {
        if self.holds {
            Err(Error::invalid_type(Unexpected::NewtypeVariant, &"a name alone"))
        } else {
            Ok(())
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, Error> {
        if self.holds { seed.deserialize(self.unpack) } else { Err(nothing_held()) }
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, Error> {
        if self.holds { self.unpack.deserialize_seq(visitor) } else { Err(nothing_held()) }
    }

    fn struct_variant<V: Visitor<'de>>(self, _: &[&str], visitor: V) -> Result<V::Value, Error> {
        if self.holds { self.unpack.deserialize_map(visitor) } else { Err(nothing_held()) }
    }
}

fn nothing_held() -> Error {
    Error::invalid_type(Unexpected::UnitVariant, &"a variant with what it holds")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;
    use serde::Serialize;

    use super::*;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct All {
        numbers: (u8, i16, u32, i64, f32, Option<f64>, bool, char),
        text: String,
        #[serde(with = "crate::input::serde_bytes_compat")]
        bytes: Vec<u8>,
        inner: Option<Box<All>>,
        kinds: Vec<Kind>,
        tagged: Option<Tagged>,
        map: BTreeMap<String, [i8; 2]>,
        unit: Unit,
        newtype: Newtype,
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    enum Kind {
        Alone,
        One(u64),
        Two(i32, Option<String>),
        Named { deep: Vec<Vec<i8>>, nothing: () },
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(tag = "kind")]
    enum Tagged {
        A { value: f64 },
        B,
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct Unit;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct Newtype(i32);

    fn all(seed: (i64, f64, String, Vec<u8>), inner: Option<Box<All>>) -> All {
        let (whole, part, text, bytes) = seed;
        All {
            numbers: (
                whole as u8,
                whole as i16,
                whole as u32,
                whole,
                part as f32,
                Some(part),
                whole > 0,
                'ß',
            ),
            kinds: vec![
                Kind::Alone,
                Kind::One(whole as u64),
                Kind::Two(whole as i32, (whole % 2 == 0).then(|| text.clone())),
                Kind::Named { deep: vec![vec![whole as i8; bytes.len() % 20], Vec::new()], nothing: () },
            ],
            tagged: [None, Some(Tagged::A { value: part }), Some(Tagged::B)][whole.rem_euclid(3) as usize]
                .clone(),
            map: (0..bytes.len() % 40).map(|k| (format!("{text}{k}"), [k as i8, -1])).collect(),
            unit: Unit,
            newtype: Newtype(whole as i32),
            text,
            bytes,
            inner,
        }
    }

    fn seeds() -> impl Strategy<Value = (i64, f64, String, Vec<u8>)> {
        (any::<i64>(), -1e9..1e9, ".{0,40}", prop::collection::vec(any::<u8>(), 0..300))
    }

    proptest! {
        /// What was written comes back; anything else is an error or other data, and never a panic.
        #[test]
        fn what_was_written_is_read(a in seeds(), b in seeds(), at in any::<prop::sample::Index>(), to in any::<u8>()) {
            let all = all(a, Some(Box::new(all(b, None))));
            let mut bytes = rmp_serde::to_vec_named(&all).unwrap();
            prop_assert_eq!(&from_slice::<All>(&bytes).unwrap(), &all);
            let at = at.index(bytes.len());
            prop_assert!(from_slice::<All>(&bytes[..at]).is_err());
            bytes[at] = to;
            let _ = from_slice::<All>(&bytes);
        }
    }

    #[test]
    fn what_is_no_number_stays_none() {
        let bytes = rmp_serde::to_vec_named(&(f64::NAN, f64::NEG_INFINITY)).unwrap();
        let (nan, infinite): (f64, f64) = from_slice(&bytes).unwrap();
        assert!(nan.is_nan() && infinite == f64::NEG_INFINITY);
        assert!(from_slice::<(f64, f64)>(&[bytes, vec![NIL]].concat()).is_err());
    }
}
