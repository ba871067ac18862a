//! Streams of Lab Streaming Layer: a thread that calls liblsl, behind a queue that never blocks.
//!
//! In: samples with stage times. Out: the same on liblsl's clock. Where the thread lags, samples are lost and counted; nobody waits.

mod library;

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};

use self::library::{Library, LibraryError, Outlet};
use super::clock::StageClock;
use posed_protocol::lsl::{Data, Sample, Stream};

/// Samples that wait for the thread.
const WAITING: usize = 1024;
/// How often the two clocks are compared.
const COMPARE_EVERY: Duration = Duration::from_secs(5);
/// Looks at both clocks per comparison; the quickest one counts.
const LOOKS: usize = 10;

/// Where samples go in; ends the streams when dropped.
#[derive(Debug)]
pub(super) struct Lsl {
    sender: Option<Sender<Sample>>,
    thread: Option<JoinHandle<()>>,
}

/// Why nothing is offered.
#[derive(Debug, thiserror::Error)]
pub(super) enum LslError {
    /// The library does not serve.
    #[error(transparent)]
    Library(#[from] LibraryError),
    /// The system has no thread for it.
    #[error("the system gives no thread for LSL: {0}")]
    Thread(#[from] std::io::Error),
}

impl Lsl {
    /// Loads the library and offers the streams.
    pub(super) fn start(
        settings: &posed_stage::Lsl,
        streams: &[Stream],
        clock: StageClock,
    ) -> Result<Self, LslError> {
        let library = Arc::new(Library::load(settings.library.as_deref())?);
        let outlets = streams.iter().map(|stream| library.offer(stream)).collect::<Result<Vec<_>, _>>()?;
        Ok(Self::with(move |receiver| run(&library, &outlets, &receiver, clock))?)
    }

    /// With what the thread does with the samples.
    fn with(run: impl FnOnce(Receiver<Sample>) + Send + 'static) -> std::io::Result<Self> {
        let (sender, receiver) = bounded(WAITING);
        #[expect(clippy::disallowed_methods, reason = "the daemon owns the thread that calls liblsl")]
        let thread = std::thread::Builder::new().name("lsl".to_owned()).spawn(move || run(receiver))?;
        Ok(Self { sender: Some(sender), thread: Some(thread) })
    }

    /// Whether its thread has ended by itself, and with it all streams.
    pub(super) fn is_broken(&self) -> bool {
        self.thread.as_ref().is_some_and(JoinHandle::is_finished)
    }

    /// Tells a sample; whether it is: not where the thread is behind.
    pub(super) fn report(&self, sample: Sample) -> bool {
        self.sender.as_ref().is_some_and(|sender| sender.try_send(sample).is_ok())
    }
}

impl Drop for Lsl {
    fn drop(&mut self) {
        self.sender = None;
        // The library's own threads must have ended before the process does.
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The thread: tells until nobody hands in any more.
fn run(library: &Library, outlets: &[Outlet], receiver: &Receiver<Sample>, clock: StageClock) {
    let mut offset_s = offset_s(library, clock);
    let mut compared = clock.now();
    loop {
        match receiver.recv_timeout(COMPARE_EVERY) {
            Ok(Sample { stream, t, data }) => {
                let t_s = t.as_nanos() as f64 * 1e-9 + offset_s;
                match (&data, outlets.get(stream)) {
                    (Data::Numbers(numbers), Some(outlet)) => outlet.numbers(numbers, t_s),
                    (Data::Text(text), Some(outlet)) => outlet.text(text, t_s),
                    (_, None) => {}
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let now = clock.now();
        if now.seconds_since(compared) >= COMPARE_EVERY.as_secs_f64() {
            offset_s = self::offset_s(library, clock);
            compared = now;
        }
    }
}

/// liblsl's clock minus the stage's, s. Both are the same oscillator on most systems; a look that was interrupted says less.
fn offset_s(library: &Library, clock: StageClock) -> f64 {
    let look = || {
        let before = clock.now();
        let theirs_s = library.clock_s();
        let width_s = clock.now().seconds_since(before);
        (width_s, theirs_s - before.as_nanos() as f64 * 1e-9 - 0.5 * width_s)
    };
    let looks = std::iter::repeat_with(look).take(LOOKS);
    looks.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, offset_s)| offset_s)
}

#[cfg(test)]
mod tests {
    use posed_drivers::Timestamp;

    use super::*;

    #[test]
    fn samples_beyond_those_that_may_wait_are_left_out_and_those_that_wait_are_told() {
        let (release, held) = bounded::<()>(0);
        let (pushed_in, pushed) = bounded(2 * WAITING);
        let lsl = Lsl::with(move |samples| {
            let _ = held.recv();
            samples.iter().for_each(|sample| pushed_in.send(sample.t).unwrap());
        });
        let lsl = lsl.unwrap();
        // Gone before it, so that a failure ends the thread too.
        let release = release;
        let t = |n: usize| Timestamp::from_nanos(n as i64);
        let report = |n| lsl.report(Sample { stream: 0, t: t(n), data: Data::Numbers(Vec::new()) });
        let taken: Vec<usize> = (0..WAITING + 50).filter(|n| report(*n)).collect();
        assert_eq!(taken, (0..WAITING).collect::<Vec<_>>());
        drop(release);
        // Once the library goes on, all that waited is there, and so is what comes.
        let next = |n: usize| assert_eq!(pushed.recv().unwrap(), t(n));
        (0..WAITING).for_each(next);
        assert!(report(9999));
        next(9999);
    }

    #[test]
    fn a_library_that_is_none_or_not_there_is_said_in_words() {
        let file = tempfile::NamedTempFile::new().unwrap();
        for (path, word) in
            [(file.path().to_owned(), "cannot load"), ("/no/such/liblsl.so".into(), "cannot load")]
        {
            let settings = posed_stage::Lsl { library: Some(path) };
            let sentence = Lsl::start(&settings, &[], StageClock::start()).unwrap_err().to_string();
            assert!(sentence.contains(word), "{sentence}");
        }
        // A library, but not this one: the C library itself.
        let settings = posed_stage::Lsl { library: Some("libc.so.6".into()) };
        let sentence = Lsl::start(&settings, &[], StageClock::start()).unwrap_err().to_string();
        assert!(sentence.contains("no liblsl"), "{sentence}");
    }
}
