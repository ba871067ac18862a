//! Receivers on USB that send reports: `/dev/hidrawN` of Linux as a stream of bytes, each report in an envelope.
//!
//! What comes in: a path, or the tree in which the system lists such devices. What goes out: a stream whose every read gives one report, as that of
//! [`RECEIVER`] ([`crate::datagram`]), and which receivers there are. Nothing is written to them.

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use rustix::fs::OFlags;
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::datagram::Datagram;
use crate::slimevr::hid::{RECEIVER, REPORT};

/// Vendor and product of SlimeVR receivers, and of trackers at a cable; third-party receivers have any of 16 products.
const RECEIVERS: [(u32, std::ops::RangeInclusive<u32>); 3] =
    [(0x1209, 0x7690..=0x7690), (0x1209, 0x7692..=0x7692), (0x4E76, 0xD2D0..=0xD2DF)];

/// Whether a port of this path is opened here.
pub fn is_one(port: &str) -> bool {
    let name = Path::new(port).file_name().and_then(|name| name.to_str());
    port.starts_with('/') && name.is_some_and(|name| name.starts_with("hidraw"))
}

/// Paths of the receivers that are plugged in, sorted; empty where the system lists none. Nothing is opened.
pub fn receivers() -> Vec<String> {
    receivers_below(Path::new("/sys/class/hidraw"))
}

fn receivers_below(class: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(class).into_iter().flatten().flatten() {
        let event = std::fs::read_to_string(entry.path().join("device/uevent")).unwrap_or_default();
        if event.lines().any(is_receiver) {
            found.push(format!("/dev/{}", entry.file_name().to_string_lossy()));
        }
    }
    found.sort();
    found
}

/// A line like `HID_ID=0003:00001209:00007690`: bus, vendor, product.
fn is_receiver(line: &str) -> bool {
    let number = |text: Option<&str>| text.and_then(|text| u32::from_str_radix(text, 16).ok());
    let Some(id) = line.strip_prefix("HID_ID=") else { return false };
    let mut parts = id.split(':').skip(1);
    let (vendor, product) = (number(parts.next()), number(parts.next()));
    RECEIVERS
        .iter()
        .any(|(of, products)| vendor == Some(*of) && product.is_some_and(|id| products.contains(&id)))
}

/// A receiver that is open.
#[derive(Debug)]
pub struct HidStream {
    file: AsyncFd<File>,
    /// What the next reads give: an envelope, or the rest of one.
    pending: Vec<u8>,
}

impl HidStream {
    /// Opens a receiver; needs a Tokio runtime.
    #[expect(
        deprecated,
        reason = "the new constructor is unsafe since a type may lie about its descriptor; File does not"
    )]
    pub(super) fn open(port: &str) -> io::Result<Self> {
        let flags = OFlags::NONBLOCK.bits().cast_signed();
        let file = OpenOptions::new().read(true).custom_flags(flags).open(port)?;
        Ok(Self { file: AsyncFd::new(file)?, pending: Vec::new() })
    }
}

impl AsyncRead for HidStream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        while this.pending.is_empty() {
            let mut ready = ready!(this.file.poll_read_ready(cx))?;
            let mut report = [0; REPORT];
            match ready.try_io(|file| file.get_ref().read(&mut report)) {
                // Unplugged.
                Ok(Ok(0)) => return Poll::Ready(Ok(())),
                Ok(Ok(len)) => {
                    Datagram { peer: RECEIVER, data: &report[..len] }.encode_into(&mut this.pending);
                }
                Ok(Err(error)) => return Poll::Ready(Err(error)),
                Err(_would_block) => {}
            }
        }
        let fits = this.pending.len().min(buf.remaining());
        buf.put_slice(&this.pending[..fits]);
        this.pending.drain(..fits);
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for HidStream {
    fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn receivers_are_known_by_vendor_and_product() {
        assert!(is_receiver("HID_ID=0003:00001209:00007690") && is_receiver("HID_ID=0003:00004E76:0000D2DA"));
        for other in [
            "HID_ID=0003:00001209:00007691",
            "HID_ID=0003:0000046D:00007690",
            "HID_NAME=1209:7690",
            "HID_ID=",
        ] {
            assert!(!is_receiver(other), "{other}");
        }
        assert!(is_one("/dev/hidraw3") && !is_one("/dev/ttyUSB0") && !is_one("hidraw3"));
        let folder = std::env::temp_dir().join(format!("posed-hidraw-{}", std::process::id()));
        for (name, id) in [("hidraw1", "00001209:00007690"), ("hidraw0", "0000046D:0000C52B")] {
            std::fs::create_dir_all(folder.join(name).join("device")).unwrap();
            let event = format!("DRIVER=hid-generic\nHID_ID=0003:{id}\n");
            std::fs::write(folder.join(name).join("device/uevent"), event).unwrap();
        }
        assert_eq!(receivers_below(&folder), ["/dev/hidraw1"]);
        std::fs::remove_dir_all(folder).unwrap();
    }

    #[tokio::test]
    async fn each_report_is_read_in_an_envelope_and_the_end_is_seen() {
        use tokio::io::AsyncReadExt;
        let folder = std::env::temp_dir().join(format!("posed-hidraw-file-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("hidraw0");
        // What the system calls a pipe can be watched as a receiver can.
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        let mut writer = OpenOptions::new().read(true).write(true).open(&path).unwrap();
        let mut stream = HidStream::open(path.to_str().unwrap()).unwrap();
        std::io::Write::write_all(&mut writer, &[7; 2 * REPORT]).unwrap();
        for _ in 0..2 {
            let mut envelope = vec![0; 9 + REPORT];
            stream.read_exact(&mut envelope).await.unwrap();
            let found = crate::datagram::datagrams(&envelope).next().unwrap().unwrap();
            assert_eq!((found.peer, found.data), (RECEIVER, &[7; REPORT][..]));
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
