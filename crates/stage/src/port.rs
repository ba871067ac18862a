//! The forms that `port` may have in a stage file.

use std::path::PathBuf;
use std::str::FromStr;

/// Where a device is to be found: the key `port` of a `[[device]]`, read with `parse()`. Whether a driver's device can be there:
/// [`crate::Driver::check_port`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortAddress {
    /// The daemon looks for the device on all serial ports.
    Auto,
    /// A serial port or pseudo-terminal by its absolute path, such as `/dev/ttyUSB0`, or a receiver ([`Self::is_receiver`]). Nobody has looked whether it is there.
    Serial(PathBuf),
    /// A serial server, or a device with a socket of its own: `tcp://HOST:PORT`.
    Tcp {
        /// Host name or address, without the brackets of an IPv6 address.
        host: String,
        /// TCP port, from 1.
        port: u16,
    },
    /// A device that speaks UDP: `udp://HOST:PORT`.
    Udp {
        /// Host name or address, without the brackets of an IPv6 address.
        host: String,
        /// UDP port, from 1.
        port: u16,
    },
    /// A unit with a USB port of its own: `usb://VENDOR:PRODUCT` in hexadecimal, and `/BUS-PORTS` behind it where two of a kind are plugged in.
    Usb,
    /// The daemon's own websocket `/imu`, to which devices connect: `websocket`.
    Websocket,
}

/// Why a text is no [`PortAddress`]; its sentence is for the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortAddressError {
    /// The text is empty.
    #[error("the port is empty")]
    Empty,
    /// A URL of another kind.
    #[error("only tcp://, udp:// and usb:// are known")]
    Scheme,
    /// No two hexadecimal numbers behind `usb://`.
    #[error("a unit on USB is named by its two numbers, as `lsusb` writes them")]
    Usb,
    /// No host, or one with white space or `/` in it.
    #[error("the host is missing")]
    Host,
    /// No port number, or none from 1 to 65535.
    #[error("the port number is missing or not from 1 to 65535")]
    Number,
    /// Neither `auto` nor `websocket` nor a URL nor an absolute path.
    #[error("a serial port is given by its path, which begins with /")]
    Relative,
}

impl PortAddress {
    /// Whether it is the path of a receiver on USB, such as `/dev/hidraw0`.
    pub fn is_receiver(&self) -> bool {
        let Self::Serial(path) = self else { return false };
        path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with("hidraw"))
    }
}

impl FromStr for PortAddress {
    type Err = PortAddressError;

    fn from_str(text: &str) -> Result<Self, PortAddressError> {
        if text.is_empty() {
            Err(PortAddressError::Empty)
        } else if text == "auto" {
            Ok(Self::Auto)
        } else if text == "websocket" {
            Ok(Self::Websocket)
        } else if let Some(rest) = text.strip_prefix("tcp://") {
            host_and_port(rest).map(|(host, port)| Self::Tcp { host, port })
        } else if let Some(rest) = text.strip_prefix("udp://") {
            host_and_port(rest).map(|(host, port)| Self::Udp { host, port })
        } else if let Some(rest) = text.strip_prefix("usb://") {
            let id = rest.split_once('/').map_or(rest, |(id, _)| id);
            let number = |text: &str| text.len() == 4 && u16::from_str_radix(text, 16).is_ok();
            let named = id.split_once(':').is_some_and(|(vendor, product)| number(vendor) && number(product));
            if named { Ok(Self::Usb) } else { Err(PortAddressError::Usb) }
        } else if text.contains("://") {
            Err(PortAddressError::Scheme)
        } else if text.starts_with('/') && !text.contains('\0') {
            Ok(Self::Serial(PathBuf::from(text)))
        } else {
            Err(PortAddressError::Relative)
        }
    }
}

fn host_and_port(text: &str) -> Result<(String, u16), PortAddressError> {
    let (host, port) = text.rsplit_once(':').ok_or(PortAddressError::Number)?;
    let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    if host.is_empty() || host.chars().any(|c| c.is_whitespace() || c == '/') {
        return Err(PortAddressError::Host);
    }
    match port.parse() {
        Ok(0) | Err(_) => Err(PortAddressError::Number),
        Ok(port) => Ok((host.to_owned(), port)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_form_is_read_and_its_mistakes_are_named() {
        use PortAddressError as E;
        let tcp = |host: &str, port| PortAddress::Tcp { host: host.into(), port };
        let cases = [
            ("auto", Ok(PortAddress::Auto)),
            ("websocket", Ok(PortAddress::Websocket)),
            ("/dev/ttyUSB0", Ok(PortAddress::Serial("/dev/ttyUSB0".into()))),
            ("tcp://moxa:4001", Ok(tcp("moxa", 4001))),
            ("tcp://[fe80::1]:4001", Ok(tcp("fe80::1", 4001))),
            ("udp://10.0.0.7:6000", Ok(PortAddress::Udp { host: "10.0.0.7".into(), port: 6000 })),
            ("usb://0f44:ff20", Ok(PortAddress::Usb)),
            ("usb://0f44:ff20/1-2.3", Ok(PortAddress::Usb)),
            ("usb://liberty", Err(E::Usb)),
            ("", Err(E::Empty)),
            ("ttyUSB0", Err(E::Relative)),
            ("http://moxa:80", Err(E::Scheme)),
            ("tcp://moxa", Err(E::Number)),
            ("tcp://moxa:0", Err(E::Number)),
            ("tcp://moxa:70000", Err(E::Number)),
            ("tcp://:4001", Err(E::Host)),
        ];
        for (text, expected) in cases {
            assert_eq!(text.parse::<PortAddress>(), expected, "{text}");
        }
    }
}
