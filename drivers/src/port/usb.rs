//! Units with a USB port of their own, without a serial line behind it: two bulk endpoints that carry the bytes of the serial port.
//!
//! In: a port such as `usb://0f44:ff20`, vendor and product as `lsusb` writes them, and `/BUS-PORTS` behind it where two of a kind are
//! plugged in. Out: a stream of bytes. Numbers and endpoints are those of published drivers; nobody has
//! tried it on a real unit.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use nusb::io::{EndpointRead, EndpointWrite};
use nusb::transfer::{Bulk, In, Out};
use nusb::{DeviceInfo, Error, ErrorKind};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

/// Polhemus' vendor number.
const POLHEMUS: u16 = 0x0F44;
/// Its units as they are once they have their firmware: product, and where bytes go out and in.
const UNITS: [(u16, u8, u8); 3] = [(0xFF20, 0x04, 0x88), (0xEF20, 0x04, 0x88), (0xEF12, 0x02, 0x82)];
/// The same units before somebody has loaded their firmware into them.
const WITHOUT_FIRMWARE: [u16; 3] = [0xFF21, 0xEF21, 0xEF11];
/// How much is asked for at a time: a frame of a few stations. A unit sends less where it has less.
const TRANSFER_BYTES: usize = 512;
/// Reads that wait at the same time, so that the unit never does.
const TRANSFERS: usize = 4;

/// A unit that is plugged in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsbUnit {
    /// Its port, as a stage file has it.
    pub port: String,
    /// Nothing can be read from it before somebody has loaded its firmware, which makes another number of it.
    pub needs_firmware: bool,
}

/// Units that are plugged in, sorted by where; empty where the system lists none. Nothing is opened.
pub async fn usb_units() -> Vec<UsbUnit> {
    let of_polhemus = |device: &DeviceInfo| device.vendor_id() == POLHEMUS;
    let all = nusb::list_devices().await.into_iter().flatten();
    let mut found: Vec<DeviceInfo> = all.filter(of_polhemus).collect();
    found.sort_by_key(place);
    let units = found.iter().filter_map(|device| {
        let product = device.product_id();
        let needs_firmware = WITHOUT_FIRMWARE.contains(&product);
        (needs_firmware || endpoints(POLHEMUS, product).is_some()).then(|| {
            let is_alone = found.iter().filter(|other| other.product_id() == product).count() == 1;
            let at = if is_alone { String::new() } else { format!("/{}", place(device)) };
            UsbUnit { port: format!("usb://{POLHEMUS:04x}:{product:04x}{at}"), needs_firmware }
        })
    });
    units.collect()
}

/// Endpoints out and in of a unit that is known.
fn endpoints(vendor: u16, product: u16) -> Option<(u8, u8)> {
    let unit = UNITS.iter().find(|(id, ..)| vendor == POLHEMUS && *id == product)?;
    Some((unit.1, unit.2))
}

/// Where a unit is plugged in, as the kernel names it: `1-2.3` is port 3 of the hub at port 2 of bus 1.
fn place(device: &DeviceInfo) -> String {
    let ports: Vec<String> = device.port_chain().iter().map(u8::to_string).collect();
    format!("{}-{}", device.bus_id().trim_start_matches('0'), ports.join("."))
}

/// A unit that is open; nobody else has its interface.
pub struct UsbStream {
    read: EndpointRead<Bulk>,
    write: EndpointWrite<Bulk>,
}

impl std::fmt::Debug for UsbStream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("UsbStream").finish_non_exhaustive()
    }
}

impl UsbStream {
    /// Opens the unit behind `usb://`; needs a Tokio runtime.
    pub(super) async fn open(address: &str) -> io::Result<Self> {
        let (id, at) = address.split_once('/').map_or((address, None), |(id, at)| (id, Some(at)));
        let number = |text: &str| u16::from_str_radix(text, 16).ok();
        let (vendor, product) = id
            .split_once(':')
            .and_then(|(vendor, product)| Some((number(vendor)?, number(product)?)))
            .ok_or_else(|| io::Error::other("it is no usb://VENDOR:PRODUCT"))?;
        let (out, input) = endpoints(vendor, product).ok_or_else(|| {
            io::Error::other(if vendor == POLHEMUS && WITHOUT_FIRMWARE.contains(&product) {
                "the unit waits for its firmware, which the maker's udev rule loads; its number is another one then"
            } else {
                "no unit with this number is known; `posed doctor` shows those that are plugged in"
            })
        })?;
        let meant = |device: &DeviceInfo| {
            (device.vendor_id(), device.product_id()) == (vendor, product)
                && at.is_none_or(|at| place(device) == at)
        };
        let mut all = nusb::list_devices().await.map_err(in_io)?;
        let unit = all.find(meant).ok_or(io::ErrorKind::NotFound)?;
        let interface =
            unit.open().await.map_err(in_io)?.detach_and_claim_interface(0).await.map_err(in_io)?;
        let read = interface.endpoint::<Bulk, In>(input).map_err(in_io)?.reader(TRANSFER_BYTES);
        let write = interface.endpoint::<Bulk, Out>(out).map_err(in_io)?.writer(TRANSFER_BYTES);
        Ok(Self { read: read.with_num_transfers(TRANSFERS), write })
    }
}

/// The same with the kinds that serial ports fail with.
fn in_io(error: Error) -> io::Error {
    let kind = match error.kind() {
        ErrorKind::NotFound | ErrorKind::Disconnected => io::ErrorKind::NotFound,
        ErrorKind::PermissionDenied => io::ErrorKind::PermissionDenied,
        ErrorKind::Busy => io::ErrorKind::ResourceBusy,
        _ => io::ErrorKind::Other,
    };
    io::Error::new(kind, error)
}

impl AsyncRead for UsbStream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().read).poll_read(cx, buf)
    }
}

impl AsyncWrite for UsbStream {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let write = &mut self.get_mut().write;
        let written = Pin::new(&mut *write).poll_write(cx, bytes);
        // Nobody flushes a port: what is written is to go, its end shown by a packet that is not full.
        if matches!(written, Poll::Ready(Ok(_))) {
            write.submit_end();
        }
        written
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().write).poll_flush(cx)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().write).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_with_firmware_have_endpoints_and_no_other_device_has() {
        assert_eq!(endpoints(POLHEMUS, 0xFF20), Some((0x04, 0x88)));
        assert_eq!(endpoints(POLHEMUS, 0xEF12), Some((0x02, 0x82)));
        assert!(WITHOUT_FIRMWARE.iter().all(|id| endpoints(POLHEMUS, *id).is_none()));
        assert_eq!(endpoints(0x1209, 0xFF20), None);
    }

    #[tokio::test]
    async fn what_is_not_there_is_said_in_words() {
        let refused = async |address: &str| UsbStream::open(address).await.map(drop).unwrap_err();
        assert!(refused("0f44:ff21").await.to_string().contains("waits for its firmware"));
        assert!(refused("1209:7690").await.to_string().contains("no unit with this number"));
        assert!(refused("liberty").await.to_string().contains("usb://VENDOR:PRODUCT"));
        // Where the system lists no devices at all, that is what it says.
        let away = refused("0f44:ff20/9-9").await;
        assert!(usb_units().await.is_empty() && !away.to_string().is_empty(), "{away}");
    }
}
