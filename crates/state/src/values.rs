//! The values that states are made of.

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::num::NonZero;
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{
    Const, DMatrix, DVector, Isometry3, Matrix, Quaternion, SMatrix, Translation3, Unit, UnitQuaternion,
};

use crate::layout::{join, name};
use crate::{Damaged, Plain, Reader, Writer};

macro_rules! integers {
    ($($kind:ident)*) => {$(
        impl Plain for $kind {
            const LAYOUT: u64 = name(stringify!($kind));

            fn save(&self, to: &mut Writer) {
                to.raw(&self.to_le_bytes());
            }

            fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
                from.bytes().map(Self::from_le_bytes)
            }
        }
    )*};
}

integers! { u8 i8 u16 i16 u32 i32 u64 i64 u128 i128 f32 f64 }

/// As 64 bits, on every machine.
impl Plain for usize {
    const LAYOUT: u64 = name("usize");

    fn save(&self, to: &mut Writer) {
        to.word(*self as u64);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Self::try_from(from.word()?).map_err(|_| Damaged::Word("index"))
    }
}

impl Plain for bool {
    const LAYOUT: u64 = name("bool");

    fn save(&self, to: &mut Writer) {
        to.byte(u8::from(*self));
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        match from.byte()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(Damaged::Word("yes or no")),
        }
    }
}

impl Plain for char {
    const LAYOUT: u64 = name("char");

    fn save(&self, to: &mut Writer) {
        u32::from(*self).save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Self::from_u32(u32::read(from)?).ok_or(Damaged::Word("character"))
    }
}

impl Plain for () {
    const LAYOUT: u64 = name("()");

    fn save(&self, _: &mut Writer) {}

    fn read(_: &mut Reader<'_>) -> Result<Self, Damaged> {
        Ok(())
    }
}

impl Plain for String {
    const LAYOUT: u64 = name("String");

    fn save(&self, to: &mut Writer) {
        to.length(self.len());
        to.raw(self.as_bytes());
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let length = from.length()?;
        let text = str::from_utf8(from.raw(length)?).map_err(|_| Damaged::Word("text"))?;
        Ok(text.to_owned())
    }
}

impl Plain for Arc<str> {
    const LAYOUT: u64 = String::LAYOUT;

    fn save(&self, to: &mut Writer) {
        to.length(self.len());
        to.raw(self.as_bytes());
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        String::read(from).map(Self::from)
    }
}

impl Plain for Duration {
    const LAYOUT: u64 = name("Duration");

    fn save(&self, to: &mut Writer) {
        self.as_secs().save(to);
        self.subsec_nanos().save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let (seconds, nanos) = (u64::read(from)?, u32::read(from)?);
        if nanos < 1_000_000_000 { Ok(Self::new(seconds, nanos)) } else { Err(Damaged::Word("duration")) }
    }
}

impl Plain for IpAddr {
    const LAYOUT: u64 = name("IpAddr");

    fn save(&self, to: &mut Writer) {
        match self {
            Self::V4(address) => {
                to.byte(4);
                to.raw(&address.octets());
            }
            Self::V6(address) => {
                to.byte(6);
                to.raw(&address.octets());
            }
        }
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        match from.byte()? {
            4 => Ok(Self::V4(Ipv4Addr::from(from.bytes::<4>()?))),
            6 => Ok(Self::V6(Ipv6Addr::from(from.bytes::<16>()?))),
            _ => Err(Damaged::Word("address")),
        }
    }
}

/// Without flow and scope of IPv6.
impl Plain for SocketAddr {
    const LAYOUT: u64 = name("SocketAddr");

    fn save(&self, to: &mut Writer) {
        self.ip().save(to);
        self.port().save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Ok(Self::new(IpAddr::read(from)?, u16::read(from)?))
    }
}

impl Plain for NonZero<u32> {
    const LAYOUT: u64 = name("NonZero<u32>");

    fn save(&self, to: &mut Writer) {
        self.get().save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Self::new(u32::read(from)?).ok_or(Damaged::Word("number but zero"))
    }
}

impl<T: Plain> Plain for Option<T> {
    const LAYOUT: u64 = join(name("Option"), T::LAYOUT);

    fn save(&self, to: &mut Writer) {
        to.byte(u8::from(self.is_some()));
        if let Some(value) = self {
            value.save(to);
        }
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Ok(if bool::read(from)? { Some(T::read(from)?) } else { None })
    }
}

impl<T: Plain, E: Plain> Plain for Result<T, E> {
    const LAYOUT: u64 = join(join(name("Result"), T::LAYOUT), E::LAYOUT);

    fn save(&self, to: &mut Writer) {
        to.byte(u8::from(self.is_ok()));
        match self {
            Ok(value) => value.save(to),
            Err(error) => error.save(to),
        }
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Ok(if bool::read(from)? { Ok(T::read(from)?) } else { Err(E::read(from)?) })
    }
}

impl<T: Plain> Plain for Box<T> {
    const LAYOUT: u64 = T::LAYOUT;

    fn save(&self, to: &mut Writer) {
        T::save(self, to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        T::read(from).map(Self::new)
    }
}

impl<T: Plain + Copy> Plain for Cell<T> {
    const LAYOUT: u64 = T::LAYOUT;

    fn save(&self, to: &mut Writer) {
        self.get().save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        T::read(from).map(Self::new)
    }
}

fn save_all<'a, T: Plain + 'a>(items: impl ExactSizeIterator<Item = &'a T>, to: &mut Writer) {
    to.length(items.len());
    items.for_each(|item| item.save(to));
}

macro_rules! lists {
    ($($kind:ty, [$($bound:tt)*];)*) => {$(
        impl<T: Plain $($bound)*> Plain for $kind {
            const LAYOUT: u64 = join(name("list"), T::LAYOUT);

            fn save(&self, to: &mut Writer) {
                save_all(self.iter(), to);
            }

            fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
                let length = from.length()?;
                (0..length).map(|_| T::read(from)).collect()
            }
        }
    )*};
}

lists! {
    Vec<T>, [];
    VecDeque<T>, [];
    Arc<[T]>, [];
    Box<[T]>, [];
    BTreeSet<T>, [+ Ord];
}

impl<K: Plain + Ord, V: Plain> Plain for BTreeMap<K, V> {
    const LAYOUT: u64 = join(join(name("map"), K::LAYOUT), V::LAYOUT);

    fn save(&self, to: &mut Writer) {
        to.length(self.len());
        for (key, value) in self {
            key.save(to);
            value.save(to);
        }
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let length = from.length()?;
        (0..length).map(|_| Ok((K::read(from)?, V::read(from)?))).collect()
    }
}

impl<T: Plain, const N: usize> Plain for [T; N] {
    const LAYOUT: u64 = join(join(name("array"), N as u64), T::LAYOUT);

    fn save(&self, to: &mut Writer) {
        self.iter().for_each(|item| item.save(to));
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let items: Vec<T> = (0..N).map(|_| T::read(from)).collect::<Result<_, _>>()?;
        items.try_into().map_err(|_| Damaged::Ends)
    }
}

macro_rules! tuples {
    ($(($($kind:ident $at:tt)*))*) => {$(
        impl<$($kind: Plain),*> Plain for ($($kind,)*) {
            const LAYOUT: u64 = {
                let layout = name("tuple");
                $(let layout = join(layout, $kind::LAYOUT);)*
                layout
            };

            fn save(&self, to: &mut Writer) {
                $(self.$at.save(to);)*
            }

            fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
                Ok(($($kind::read(from)?,)*))
            }
        }
    )*};
}

tuples! {
    (A 0)
    (A 0 B 1)
    (A 0 B 1 C 2)
    (A 0 B 1 C 2 D 3)
}

impl<T: Plain> Plain for Range<T> {
    const LAYOUT: u64 = join(name("range"), T::LAYOUT);

    fn save(&self, to: &mut Writer) {
        self.start.save(to);
        self.end.save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Ok(T::read(from)?..T::read(from)?)
    }
}

impl<T: Plain> Plain for RangeInclusive<T> {
    const LAYOUT: u64 = join(name("range with its end"), T::LAYOUT);

    fn save(&self, to: &mut Writer) {
        self.start().save(to);
        self.end().save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Ok(T::read(from)?..=T::read(from)?)
    }
}

impl<const R: usize, const C: usize> Plain for SMatrix<f64, R, C> {
    const LAYOUT: u64 = join(join(name("matrix"), R as u64), C as u64);

    fn save(&self, to: &mut Writer) {
        to.floats(self.as_slice());
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let mut matrix: Matrix<f64, Const<R>, Const<C>, _> = Self::zeros();
        from.floats(matrix.as_mut_slice())?;
        Ok(matrix)
    }
}

impl Plain for DMatrix<f64> {
    const LAYOUT: u64 = name("matrix");

    fn save(&self, to: &mut Writer) {
        self.nrows().save(to);
        self.ncols().save(to);
        to.floats(self.as_slice());
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let (rows, columns) = (usize::read(from)?, usize::read(from)?);
        let bytes = rows.checked_mul(columns).and_then(|size| size.checked_mul(8)).ok_or(Damaged::Ends)?;
        let bytes = from.raw(bytes)?;
        let mut matrix = Self::zeros(rows, columns);
        Reader::new(bytes).floats(matrix.as_mut_slice())?;
        Ok(matrix)
    }
}

impl Plain for DVector<f64> {
    const LAYOUT: u64 = name("vector");

    fn save(&self, to: &mut Writer) {
        to.length(self.len());
        to.floats(self.as_slice());
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let length = from.length()?;
        let mut vector = Self::zeros(length);
        from.floats(vector.as_mut_slice())?;
        Ok(vector)
    }
}

/// The bits as they are: a unit quaternion is not made one again.
impl Plain for UnitQuaternion<f64> {
    const LAYOUT: u64 = name("unit quaternion");

    fn save(&self, to: &mut Writer) {
        to.floats(self.coords.as_slice());
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        Ok(Unit::new_unchecked(Quaternion::from(SMatrix::<f64, 4, 1>::read(from)?)))
    }
}

impl<const R: usize> Plain for Unit<SMatrix<f64, R, 1>> {
    const LAYOUT: u64 = join(name("direction"), R as u64);

    fn save(&self, to: &mut Writer) {
        to.floats(self.as_slice());
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        SMatrix::read(from).map(Self::new_unchecked)
    }
}

impl Plain for Isometry3<f64> {
    const LAYOUT: u64 = name("rigid motion");

    fn save(&self, to: &mut Writer) {
        self.translation.vector.save(to);
        self.rotation.save(to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, Damaged> {
        let translation = Translation3::from(SMatrix::<f64, 3, 1>::read(from)?);
        Ok(Self::from_parts(translation, UnitQuaternion::read(from)?))
    }
}
