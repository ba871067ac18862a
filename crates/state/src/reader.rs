//! The one reader.

use thiserror::Error;

use crate::writer::sum;

/// Why bytes are no such state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Damaged {
    /// They end early.
    #[error("it ends in the middle")]
    Ends,
    /// Bytes are left.
    #[error("{0} bytes are left over")]
    Left(usize),
    /// A byte or text that no such value has.
    #[error("it holds what is no {0}")]
    Word(&'static str),
    /// A byte is another one.
    #[error("it was changed since it was written")]
    Changed,
    /// It was written by another version, with other fields.
    #[error("another version of the program wrote it")]
    OtherLayout,
    /// There are more or fewer parts than here.
    #[error("it belongs to a stage with other parts")]
    OtherParts,
}

/// Takes plain data from bytes, in the order in which [`Writer`](crate::Writer) appended it. It reserves no memory by a length
/// that the bytes only claim.
#[derive(Debug)]
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Over bytes, from their beginning.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// Over all bytes but their sum at the end.
    ///
    /// # Errors
    /// [`Damaged::Changed`] where it is the sum of others, [`Damaged::Ends`] where there is none.
    pub(crate) fn unsealed(bytes: &'a [u8]) -> Result<Self, Damaged> {
        let (rest, sealed) = bytes.split_last_chunk().ok_or(Damaged::Ends)?;
        if sum(rest) == u64::from_le_bytes(*sealed) { Ok(Self { rest }) } else { Err(Damaged::Changed) }
    }

    /// The next `length` bytes, not copied.
    ///
    /// # Errors
    /// [`Damaged::Ends`] where there are fewer; nothing is taken then.
    pub fn raw(&mut self, length: usize) -> Result<&'a [u8], Damaged> {
        let (taken, rest) = self.rest.split_at_checked(length).ok_or(Damaged::Ends)?;
        self.rest = rest;
        Ok(taken)
    }

    /// The next `N` bytes, as an array.
    ///
    /// # Errors
    /// [`Damaged::Ends`] where there are fewer; nothing is taken then.
    pub fn bytes<const N: usize>(&mut self) -> Result<[u8; N], Damaged> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or(Damaged::Ends)?;
        self.rest = rest;
        Ok(*taken)
    }

    /// The next byte.
    ///
    /// # Errors
    /// [`Damaged::Ends`] where there is none.
    pub fn byte(&mut self) -> Result<u8, Damaged> {
        self.bytes::<1>().map(|[byte]| byte)
    }

    /// The next 64 bits, little-endian.
    ///
    /// # Errors
    /// [`Damaged::Ends`] where there are fewer.
    pub fn word(&mut self) -> Result<u64, Damaged> {
        self.bytes().map(u64::from_le_bytes)
    }

    /// A number of items, 32 bits, each of at least a byte: never more than there are bytes left.
    ///
    /// # Errors
    /// [`Damaged::Ends`] where fewer bytes than items are left.
    pub fn length(&mut self) -> Result<usize, Damaged> {
        let length = u32::from_le_bytes(self.bytes()?) as usize;
        if length <= self.rest.len() { Ok(length) } else { Err(Damaged::Ends) }
    }

    /// A number of items that must be `own`, for what is read in place.
    ///
    /// # Errors
    /// [`Damaged::OtherParts`] where it is another number, [`Damaged::Ends`] where there is none.
    pub fn same_length(&mut self, own: usize) -> Result<(), Damaged> {
        let length = u32::from_le_bytes(self.bytes()?) as usize;
        if length == own { Ok(()) } else { Err(Damaged::OtherParts) }
    }

    /// Fills `values` with the bits of as many numbers; NaN keeps its bits.
    ///
    /// # Errors
    /// [`Damaged::Ends`] where there are fewer; `values` stay as they are then.
    pub fn floats(&mut self, values: &mut [f64]) -> Result<(), Damaged> {
        let bytes = self.raw(8 * values.len())?;
        for (value, bits) in values.iter_mut().zip(bytes.as_chunks().0) {
            *value = f64::from_bits(u64::from_le_bytes(*bits));
        }
        Ok(())
    }

    /// Checks that nothing is left.
    ///
    /// # Errors
    /// [`Damaged::Left`] with the number of bytes that are.
    pub fn end(&self) -> Result<(), Damaged> {
        if self.rest.is_empty() { Ok(()) } else { Err(Damaged::Left(self.rest.len())) }
    }
}
