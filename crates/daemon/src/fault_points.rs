//! Places where tests make a running daemon go wrong; nothing at all without the feature `fault-points`, which no package has.
//!
//! In: `POSED_FAULTS` of the environment, like `distributor=panic@200,recorder=hang:20000@3`: at a place, what happens, and at which
//! time that it is passed, from 1. `panic` panics, `hang:MS` keeps the thread for so long, `fail` is an error of a full disk.
//! A place after which nothing is said does what it always does.

use std::io;

/// Passes a place.
///
/// # Errors
/// A test has asked for it.
///
/// # Panics
/// Likewise.
#[cfg(feature = "fault-points")]
pub(crate) fn pass(place: &str) -> io::Result<()> {
    asked::at(place)
}

/// Passes a place.
#[cfg(not(feature = "fault-points"))]
pub(crate) fn pass(_place: &str) -> io::Result<()> {
    Ok(())
}

#[cfg(feature = "fault-points")]
mod asked {
    use std::io;
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::time::Duration;

    enum Action {
        Panic,
        Hang(Duration),
        Fail,
    }

    struct Fault {
        place: String,
        action: Action,
        at: u64,
        passed: AtomicU64,
    }

    fn parse(text: &str) -> Option<Fault> {
        let (place, rest) = text.split_once('=')?;
        let (action, at) = rest.split_once('@')?;
        let action = match action.split_once(':') {
            Some(("hang", ms)) => Action::Hang(Duration::from_millis(ms.parse().ok()?)),
            None if action == "panic" => Action::Panic,
            None if action == "fail" => Action::Fail,
            _ => return None,
        };
        Some(Fault { place: place.to_owned(), action, at: at.parse().ok()?, passed: AtomicU64::new(0) })
    }

    pub(super) fn at(place: &str) -> io::Result<()> {
        static FAULTS: OnceLock<Vec<Fault>> = OnceLock::new();
        let faults = FAULTS.get_or_init(|| {
            let text = std::env::var("POSED_FAULTS").unwrap_or_default();
            let faults = text.split(',').filter(|fault| !fault.is_empty());
            faults.map(|fault| parse(fault).unwrap_or_else(|| panic!("POSED_FAULTS: {fault:?}"))).collect()
        });
        for fault in faults.iter().filter(|fault| fault.place == place) {
            if fault.passed.fetch_add(1, Ordering::Relaxed) + 1 == fault.at {
                match &fault.action {
                    Action::Panic => panic!("a test asked for a panic at {place}"),
                    #[expect(clippy::disallowed_methods, reason = "it stands for what hangs")]
                    Action::Hang(duration) => std::thread::sleep(*duration),
                    Action::Fail => return Err(io::Error::from(io::ErrorKind::StorageFull)),
                }
            }
        }
        Ok(())
    }
}
