//! The source of time code: a program's samples, a FIFO of them, or a MIDI port.
//!
//! What comes in: bytes. What goes out: the frames of time code in them, each an entry of the input log with the time of its read. What
//! it never does: block, give up, or hold anything else up. A source that is away is opened again, and the status says so.

use std::io;
use std::os::fd::OwnedFd;
use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use futures_util::FutureExt;
use posed_drivers::Timestamp;
use posed_protocol::Problem;
use posed_stage::input::{Entry, Input};
use posed_stage::{Timecode, TimecodeSignal};
use posed_timecode::{Reading, ltc, mtc};
use rustix::fs::{Mode, OFlags};
use tokio::net::unix::pipe;
use tokio::sync::watch;

use super::clock::StageClock;
use super::fault_points;
use super::fusion::FusionInbox;
use super::ports::ended;

/// How soon a source that is away is tried again: an attempt may start a program.
const RETRY: Duration = Duration::from_secs(1);
/// Longest pause of a source that lives, and longest time without a frame in what it sends.
const SILENCE: Duration = Duration::from_secs(3);
/// A tenth of a second of sound with many channels; more than a pipe holds.
const READ_BYTES: usize = 1 << 17;
/// Share of full scale below which sound is silence: -60 dB.
const LEAST_LEVEL: f32 = 1e-3;

/// Why no time code is read; each says what to do.
#[derive(Debug, thiserror::Error)]
enum Trouble {
    #[error("there is no program")]
    NoProgram,
    #[error(
        "`{name}` does not start ({error}): install it (arecord is in the package alsa-utils), or name another program as timecode.command"
    )]
    NotStarted { name: String, error: io::Error },
    #[error("{} does not open ({error}); check timecode.path and who may read it", path.display())]
    NotOpened { path: PathBuf, error: io::Error },
    #[error(
        "{} is a file, whose sound was not heard now: name a FIFO or a device; `posed timecode` reads files", .0.display())]
    IsFile(PathBuf),
    #[error(
        "`{line}` sends no more ({how}): run it by hand to see why; timecode.command names another program"
    )]
    ProgramEnded { line: String, how: String },
    #[error("nobody writes to {} ({how}): start what does", path.display())]
    NobodyWrites { path: PathBuf, how: String },
    #[error("bytes come faster than time passes: it is no live source; `posed timecode` reads files")]
    TooFast,
    #[error("what reads it had a fault of its own; please report this")]
    Fault,
    #[error("the MIDI port is open, and nothing comes: start the generator, or name another port")]
    MidiIsSilent,
    #[error("no samples come: start what sends them")]
    NoSamples,
    #[error("MIDI comes, and no time code in it: have the generator send quarter frames (MTC)")]
    MidiWithoutCode,
    #[error(
        "sound comes, and no time code in it: check channel {channel}, sample_rate_hz and the level (LTC is not speech)"
    )]
    SoundWithoutCode { channel: u16 },
    #[error("there is only silence: start the generator, check the cable and the input")]
    OnlySilence,
}

/// What is wrong with the source; clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct TimecodeProblem(Arc<Mutex<Option<Problem>>>);

impl TimecodeProblem {
    pub(crate) fn get(&self) -> Option<Problem> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set(&self, trouble: Option<&Trouble>) {
        let problem = trouble
            .map(|trouble| Problem::new("timecode", format!("time code: {trouble}")).with("reason", trouble));
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if *kept != problem {
            match &problem {
                Some(problem) => tracing::warn!("{}", problem.message),
                None => tracing::info!("time code is read"),
            }
            *kept = problem;
        }
    }
}

/// The source of a stage's time code.
pub(super) struct TimecodeSource {
    settings: Timecode,
    clock: StageClock,
    inbox: FusionInbox,
    problem: TimecodeProblem,
    /// How often it was opened.
    stream: u32,
}

/// What is open: the bytes, and the program that sends them.
struct Open {
    bytes: pipe::Receiver,
    _program: Option<Program>,
}

/// Ends with its owner.
struct Program(Option<Child>);

impl Drop for Program {
    fn drop(&mut self) {
        let Some(mut child) = self.0.take() else { return };
        let _ = child.kill();
        // One that hangs in a driver must not keep the daemon: it is waited for elsewhere.
        tokio::task::spawn_blocking(move || child.wait());
    }
}

impl TimecodeSource {
    pub(super) fn new(settings: Timecode, clock: StageClock, inbox: FusionInbox) -> Self {
        Self { settings, clock, inbox, problem: TimecodeProblem::default(), stream: 0 }
    }

    /// What is wrong with it, from now on.
    pub(super) fn problem(&self) -> TimecodeProblem {
        self.problem.clone()
    }

    /// Keeps the source open until shutdown. Where that panics it begins again.
    #[expect(clippy::disallowed_methods, reason = "the daemon retries on its own clock")]
    pub(super) async fn keep_open(mut self, mut down: watch::Receiver<bool>) {
        loop {
            let served = AssertUnwindSafe(self.open_and_read()).catch_unwind();
            let trouble = tokio::select! {
                () = ended(&mut down) => return,
                served = served => served.unwrap_or(Trouble::Fault),
            };
            self.problem.set(Some(&trouble));
            tokio::select! {
                () = ended(&mut down) => return,
                () = tokio::time::sleep(RETRY) => {}
            }
        }
    }

    /// Reads until the source is gone, and returns why.
    async fn open_and_read(&mut self) -> Trouble {
        let open = match self.open() {
            Ok(open) => open,
            Err(trouble) => return trouble,
        };
        self.stream = self.stream.wrapping_add(1);
        let mut decoder = Decoder::new(&self.settings, self.stream);
        let (mut heard, mut pace) = (Heard::default(), Pace::new(&self.settings));
        let mut buffer = vec![0; READ_BYTES];
        loop {
            let read = tokio::time::timeout(SILENCE, read(&open.bytes, &mut buffer)).await;
            let t = self.clock.now();
            match read {
                Ok(Ok(0)) => return self.gone(None),
                Ok(Ok(length)) => {
                    if !pace.allows(t, length) {
                        return Trouble::TooFast;
                    }
                    let _ = fault_points::pass("timecode");
                    let entries = &self.inbox;
                    let mut frames = 0;
                    let level = decoder.push(t, &buffer[..length], |reading| {
                        frames += 1;
                        entries.enter(Entry { t, input: Input::Timecode(reading) });
                    });
                    heard.read(t, frames, level);
                }
                Ok(Err(error)) => return self.gone(Some(&error)),
                Err(_) => heard.nothing(),
            }
            self.problem.set(heard.trouble(t, &self.settings).as_ref());
        }
    }

    fn open(&self) -> Result<Open, Trouble> {
        if let Some(program) = self.settings.program() {
            return start(&program);
        }
        let path = self.path();
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOCTTY;
        let opened = rustix::fs::open(&path, flags, Mode::empty());
        let opened =
            opened.map_err(|error| Trouble::NotOpened { path: path.clone(), error: error.into() })?;
        // A file's bytes come without a time.
        let bytes = pipe::Receiver::from_owned_fd_unchecked(opened).map_err(|_| Trouble::IsFile(path))?;
        Ok(Open { bytes, _program: None })
    }

    /// Where the bytes come from, where no program sends them.
    fn path(&self) -> PathBuf {
        self.settings.path.clone().unwrap_or_default()
    }

    /// Why no more comes.
    fn gone(&self, error: Option<&io::Error>) -> Trouble {
        let how = error.map_or_else(|| "it has ended".to_owned(), ToString::to_string);
        match self.settings.program() {
            Some(program) => Trouble::ProgramEnded { line: program.join(" "), how },
            None => Trouble::NobodyWrites { path: self.path(), how },
        }
    }
}

/// Starts a program whose standard output is read.
fn start(program: &[String]) -> Result<Open, Trouble> {
    let Some((name, arguments)) = program.split_first() else { return Err(Trouble::NoProgram) };
    let does_not = |error: io::Error| Trouble::NotStarted { name: name.clone(), error };
    let mut command = Command::new(name);
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = command.spawn().map_err(does_not)?;
    let output = child.stdout.take();
    let program = Program(Some(child));
    let output = OwnedFd::from(output.ok_or_else(|| does_not(io::Error::other("it has no output")))?);
    let flags = rustix::fs::fcntl_getfl(&output).map_err(|error| does_not(error.into()))?;
    rustix::fs::fcntl_setfl(&output, flags | OFlags::NONBLOCK).map_err(|error| does_not(error.into()))?;
    let bytes = pipe::Receiver::from_owned_fd_unchecked(output).map_err(does_not)?;
    Ok(Open { bytes, _program: Some(program) })
}

async fn read(from: &pipe::Receiver, buffer: &mut [u8]) -> io::Result<usize> {
    loop {
        from.readable().await?;
        match from.try_read(buffer) {
            // Woken for nothing.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            read => return read,
        }
    }
}

/// Bytes to frames of time code.
enum Decoder {
    Ltc {
        decoder: Box<ltc::Decoder>,
        channels: usize,
        channel: usize,
        stream: u32,
        rest: Vec<u8>,
        samples: Vec<f32>,
    },
    Mtc {
        decoder: mtc::Decoder,
        stream: u32,
    },
}

impl Decoder {
    fn new(settings: &Timecode, stream: u32) -> Self {
        match settings.signal {
            TimecodeSignal::Mtc => Self::Mtc { decoder: mtc::Decoder::default(), stream },
            TimecodeSignal::Ltc => Self::Ltc {
                decoder: Box::new(ltc::Decoder::new(f64::from(settings.sample_rate_hz))),
                channels: usize::from(settings.channels.max(1)),
                channel: usize::from(settings.channel.max(1) - 1),
                stream,
                rest: Vec::new(),
                samples: Vec::new(),
            },
        }
    }

    /// Takes the bytes of one read; returns how loud they were, of 1, where they are sound.
    fn push(&mut self, t: Timestamp, bytes: &[u8], frame: impl FnMut(Reading)) -> Option<f32> {
        match self {
            Self::Mtc { decoder, stream } => {
                decoder.push(t, bytes, *stream, frame);
                None
            }
            Self::Ltc { decoder, channels, channel, stream, rest, samples } => {
                // A read may end within a sample.
                rest.extend_from_slice(bytes);
                let each = 2 * *channels;
                let whole = rest.len() / each * each;
                samples.clear();
                samples.extend(rest[..whole].chunks_exact(each).map(|all| {
                    let at = (2 * *channel).min(each - 2);
                    f32::from(i16::from_le_bytes([all[at], all[at + 1]])) / 32768.0
                }));
                rest.drain(..whole);
                decoder.push(samples, *stream, frame);
                Some(samples.iter().fold(0.0, |loudest: f32, sample| loudest.max(sample.abs())))
            }
        }
    }
}

/// Whether bytes come no faster than a live source sends them: what does would take a whole processor, and says no time.
struct Pace {
    most_bytes: usize,
    since: Timestamp,
    bytes: usize,
}

impl Pace {
    fn new(settings: &Timecode) -> Self {
        let most_bytes = match settings.signal {
            // A USB port carries more than the 3125 of a MIDI cable.
            TimecodeSignal::Mtc => 100_000,
            TimecodeSignal::Ltc => {
                8 * settings.sample_rate_hz as usize * usize::from(settings.channels.max(1))
            }
        };
        // And what has waited in a full pipe.
        Self { most_bytes: most_bytes + READ_BYTES, since: Timestamp::ZERO, bytes: 0 }
    }

    fn allows(&mut self, t: Timestamp, bytes: usize) -> bool {
        if t.seconds_since(self.since) > 1.0 {
            (self.since, self.bytes) = (t, 0);
        }
        self.bytes += bytes;
        self.bytes <= self.most_bytes
    }
}

/// What has come of the source lately.
#[derive(Default)]
struct Heard {
    /// When it was opened, when its last frame came, and when it was loud last.
    since: Option<Timestamp>,
    frame: Option<Timestamp>,
    loud: Option<Timestamp>,
    /// Nothing has come for long.
    is_silent: bool,
}

impl Heard {
    fn read(&mut self, t: Timestamp, frames: u32, level: Option<f32>) {
        self.is_silent = false;
        self.since.get_or_insert(t);
        if frames > 0 {
            self.frame = Some(t);
        }
        if level.is_none_or(|level| level > LEAST_LEVEL) {
            self.loud = Some(t);
        }
    }

    fn nothing(&mut self) {
        self.is_silent = true;
    }

    /// What an operator should know.
    fn trouble(&self, t: Timestamp, settings: &Timecode) -> Option<Trouble> {
        let lately = |last: Option<Timestamp>| last.is_some_and(|last| last + SILENCE > t);
        let is_midi = settings.signal == TimecodeSignal::Mtc;
        if self.is_silent {
            return Some(if is_midi { Trouble::MidiIsSilent } else { Trouble::NoSamples });
        }
        if lately(self.frame) || lately(self.since) {
            return None;
        }
        Some(if is_midi {
            Trouble::MidiWithoutCode
        } else if lately(self.loud) {
            Trouble::SoundWithoutCode { channel: settings.channel }
        } else {
            Trouble::OnlySilence
        })
    }
}
