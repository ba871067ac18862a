//! The only file of this package that opens a port.
