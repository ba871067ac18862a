//! A device's end of a pseudo-terminal.
//!
//! The host opens the link like a serial port. The simulator keeps the other end open too, so that the
//! host may come and go, and reads from the terminal's settings which rate the host has set.

use std::fs;
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use rustix::pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};
use tokio::io::unix::AsyncFd;

use crate::port::{Port, watched};

/// Both ends of a pseudo-terminal.
struct Ends {
    ours: AsyncFd<OwnedFd>,
    theirs: OwnedFd,
}

/// A port on a pseudo-terminal with a link to it that stays the same; the link goes when this is dropped.
pub(crate) struct Pty {
    link: PathBuf,
    /// Absent while unplugged.
    ends: Option<Ends>,
}

impl Pty {
    /// Opens a pseudo-terminal and puts a link to it at `link`; an old link there is replaced, a file is not.
    pub(crate) fn open(link: &Path) -> io::Result<Self> {
        let mut pty = Self { link: link.to_owned(), ends: None };
        pty.replug()?;
        Ok(pty)
    }
}

impl Port for Pty {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let Some(ends) = &self.ends else { return std::future::pending().await };
        loop {
            let mut guard = ends.ours.readable().await?;
            match guard.try_io(|fd| rustix::io::read(fd.get_ref(), &mut *buffer).map_err(io::Error::from)) {
                Ok(read) => return read,
                Err(_would_block) => continue,
            }
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Some(ends) = &self.ends else { return Ok(()) };
        match rustix::io::write(ends.ours.get_ref(), bytes) {
            Ok(_) => Ok(()),
            Err(rustix::io::Errno::AGAIN) => {
                // Nobody has read for 16 KiB. A serial port that nobody reads keeps nothing either: what is
                // old goes, so that whoever opens it next finds no stale records.
                tcflush(&ends.theirs, QueueSelector::IFlush)?;
                Ok(())
            }
            Err(error) => Err(error.into()),
        }
    }

    fn baud(&self) -> Option<u32> {
        let ends = self.ends.as_ref()?;
        tcgetattr(&ends.theirs).ok().map(|settings| settings.output_speed())
    }

    fn unplug(&mut self) {
        self.ends = None;
        remove_link(&self.link);
    }

    fn replug(&mut self) -> io::Result<()> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let ours = openpt(flags)?;
        grantpt(&ours)?;
        unlockpt(&ours)?;
        let path = ptsname(&ours, Vec::new())?;
        let theirs = ioctl_tiocgptpeer(&ours, flags)?;
        let mut settings = tcgetattr(&theirs)?;
        settings.make_raw();
        tcsetattr(&theirs, OptionalActions::Now, &settings)?;
        rustix::io::ioctl_fionbio(&ours, true)?;
        let path = path.into_string().map_err(io::Error::other)?;
        place_link(Path::new(&path), &self.link)?;
        self.ends = Some(Ends { ours: watched(ours)?, theirs });
        Ok(())
    }
}

/// A pseudo-terminal in raw mode that only speaks: what the host sends is thrown away, its line rate does not matter.
pub struct Speaker(Pty);

impl Speaker {
    /// Opens a pseudo-terminal and puts a link to it at `link`; the link goes when this is dropped. An old link there is
    /// replaced.
    ///
    /// # Errors
    /// Something that is no link is at `link`, or the operating system refuses the link or the pseudo-terminal.
    ///
    /// # Panics
    /// Outside a tokio runtime with IO.
    pub fn open(link: &Path) -> io::Result<Self> {
        Pty::open(link).map(Self)
    }

    /// Says these bytes at once, at no line rate; what nobody has read for 16 KiB is lost, as on a serial line.
    ///
    /// # Errors
    /// The operating system refuses to write to the pseudo-terminal.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if let Some(ends) = &self.0.ends {
            // Unread, the host's commands would fill its side of the line and block it.
            let mut unwanted = [0; 256];
            while rustix::io::read(ends.ours.get_ref(), &mut unwanted).is_ok_and(|n| n > 0) {}
        }
        Port::write(&mut self.0, bytes)
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        if self.ends.is_some() {
            remove_link(&self.link);
        }
    }
}

/// Makes or replaces a link, in one step.
fn place_link(target: &Path, link: &Path) -> io::Result<()> {
    if fs::symlink_metadata(link).is_ok_and(|found| !found.is_symlink()) {
        let message = format!("{} is in the way: it is no link", link.display());
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, message));
    }
    let mut fresh = link.as_os_str().to_owned();
    fresh.push(".new");
    // One may be left of a run that was killed.
    match fs::remove_file(&fresh) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    std::os::unix::fs::symlink(target, &fresh)?;
    fs::rename(&fresh, link)
}

fn remove_link(link: &Path) {
    if let Err(error) = fs::remove_file(link) {
        tracing::warn!(link = %link.display(), %error, "the link to a virtual port could not be removed");
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::{Arc, Mutex};

    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;
    use crate::faults::Fault;
    use crate::host::{Clock, Host, Watcher};
    use crate::scenario::DeviceScenario;
    use crate::stage::{Event, Output, VirtualStage};
    use crate::testing::{scenario, stage};

    /// Opens a port as a driver does, at this rate.
    async fn open(path: &str, baud: u32) -> io::Result<tokio::fs::File> {
        let file = tokio::fs::OpenOptions::new().read(true).write(true).open(path).await?;
        let mut settings = tcgetattr(&file)?;
        settings.set_speed(baud)?;
        tcsetattr(&file, OptionalActions::Now, &settings)?;
        Ok(file)
    }

    fn host(device: DeviceScenario, name: &str, watcher: Watcher) -> (Host, PathBuf) {
        let folder = std::env::temp_dir().join(format!("posed-simulator-{}-{name}", std::process::id()));
        let stage = VirtualStage::new(&stage(&[0], 115_200), &scenario(device), Path::new(".")).unwrap();
        (Host::open(stage, &folder, Clock::start(), watcher).unwrap(), folder)
    }

    #[tokio::test]
    async fn a_port_answers_at_its_rate_and_vanishes_at_the_end() {
        let quick = DeviceScenario { boot_ms: 0.0, ..DeviceScenario::default() };
        let (reported, mut cycles) = tokio::sync::mpsc::unbounded_channel();
        let watcher = move |event: &Event| {
            if matches!(event.output, Output::Truth(_)) {
                reported.send(()).unwrap();
            }
        };
        let (host, folder) = host(quick, "rate", Arc::new(watcher));
        let port = host.devices()[0].port.clone();
        assert_eq!(host.devices()[0].driver, "flock-of-birds");
        // At the wrong rate no question is understood, at the right one the next one is.
        let mut file = open(&port, 9600).await.unwrap();
        file.write_all(b"O\x0F").await.unwrap();
        file.flush().await.unwrap();
        for _ in 0..cycles.len() + 20 {
            cycles.recv().await.unwrap(); // The device's task has had its time.
        }
        let mut settings = tcgetattr(&file).unwrap();
        settings.set_speed(115_200).unwrap();
        tcsetattr(&file, OptionalActions::Now, &settings).unwrap();
        file.write_all(b"O\x01").await.unwrap();
        file.flush().await.unwrap();
        let mut answer = [0; 2];
        file.read_exact(&mut answer).await.unwrap();
        assert_eq!(answer, [3, 67]);
        host.stop().await.unwrap();
        assert!(!Path::new(&port).exists());
        fs::remove_dir(folder).unwrap();
    }

    #[tokio::test]
    async fn an_unplugged_port_is_gone_and_returns_under_its_name() {
        let unplug = Fault::Unplug { at_s: 0.1, duration_s: Some(0.1), power: false };
        let device = DeviceScenario { boot_ms: 0.0, faults: vec![unplug], ..DeviceScenario::default() };
        let (reported, mut hear) = tokio::sync::mpsc::unbounded_channel();
        let link = Arc::new(Mutex::new(String::new()));
        let look = Arc::clone(&link);
        let watcher: Watcher = Arc::new(move |event: &Event| {
            if matches!(event.output, Output::Unplugged | Output::Replugged) {
                let exists = Path::new(&*look.lock().unwrap()).exists();
                reported.send((event.output == Output::Replugged, exists)).unwrap();
            }
        });
        let (host, folder) = host(device, "unplug", watcher);
        let port = host.devices()[0].port.clone();
        link.lock().unwrap().clone_from(&port);
        assert_eq!(hear.recv().await, Some((false, false)));
        assert_eq!(hear.recv().await, Some((true, true)));
        let mut file = open(&port, 115_200).await.unwrap();
        file.write_all(b"O\x01").await.unwrap();
        file.flush().await.unwrap();
        let mut answer = [0; 2];
        file.read_exact(&mut answer).await.unwrap();
        assert_eq!(answer, [3, 67]);
        host.stop().await.unwrap();
        fs::remove_dir(folder).unwrap();
    }

    #[test]
    fn a_file_in_the_way_is_not_replaced() {
        let file = std::env::temp_dir().join(format!("posed-simulator-{}-file", std::process::id()));
        fs::write(&file, "precious").unwrap();
        let error = place_link(Path::new("/dev/null"), &file).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read_to_string(&file).unwrap(), "precious");
        fs::remove_file(file).unwrap();
    }
}
