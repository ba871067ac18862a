//! liblsl, loaded when it is asked for: the only calls into it, each with what makes it sound.
#![expect(unsafe_code, reason = "liblsl is a C library that is loaded at run time")]

use std::ffi::{CString, c_char, c_double, c_int, c_void};
use std::path::{Path, PathBuf};
use std::ptr::NonNull;
use std::sync::Arc;

use libloading::Library as Loaded;

use posed_protocol::lsl::{Channel, Stream};

/// Names under which it is installed.
const NAMES: [&str; 5] = ["liblsl.so.2", "liblsl.so", "liblsl64.so", "liblsl.dylib", "lsl.dll"];
/// `cft_double64` and `cft_string` of `lsl_channel_format_t`.
const DOUBLE: c_int = 2;
const STRING: c_int = 3;
/// `LSL_IRREGULAR_RATE`: every sample says its own time.
const IRREGULAR: c_double = 0.0;
/// Seconds that are kept for a program that reads slowly.
const BUFFERED_S: c_int = 30;

type Handle = NonNull<c_void>;
type Pointer = *mut c_void;

/// The functions that are used; signatures as in `lsl_c.h` of version 1.13 and later, which has not changed them since.
pub(super) struct Library {
    local_clock: unsafe extern "C" fn() -> c_double,
    create_info:
        unsafe extern "C" fn(*const c_char, *const c_char, i32, c_double, c_int, *const c_char) -> Pointer,
    destroy_info: unsafe extern "C" fn(Pointer),
    description: unsafe extern "C" fn(Pointer) -> Pointer,
    append_child: unsafe extern "C" fn(Pointer, *const c_char) -> Pointer,
    append_value: unsafe extern "C" fn(Pointer, *const c_char, *const c_char) -> Pointer,
    create_outlet: unsafe extern "C" fn(Pointer, i32, i32) -> Pointer,
    destroy_outlet: unsafe extern "C" fn(Pointer),
    push_numbers: unsafe extern "C" fn(Pointer, *const c_double, c_double) -> i32,
    push_text: unsafe extern "C" fn(Pointer, *const *const c_char, c_double) -> i32,
    /// Behind the functions that are in it.
    _loaded: Loaded,
}

/// An outlet that programs find in the network; gone when dropped.
pub(super) struct Outlet {
    library: Arc<Library>,
    handle: Handle,
    /// Numbers per sample; 0: texts.
    channels: usize,
}

/// Why liblsl offers nothing.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LibraryError {
    /// A second C library would come with it.
    #[error("this posed is the static one, which loads no libraries: [lsl] needs the packaged one")]
    Static,
    /// It is nowhere.
    #[error(
        "liblsl is not installed, so [lsl] offers nothing: install it from \
         https://github.com/sccn/liblsl/releases, or name its file in lsl.library"
    )]
    Absent,
    /// The file that the stage names does not serve.
    #[error("cannot load {}: {error}", file.display())]
    Load {
        /// The file.
        file: PathBuf,
        /// What the system said.
        error: libloading::Error,
    },
    /// It lacks a function.
    #[error("this is no liblsl: {0}")]
    Lacks(libloading::Error),
    /// It refuses a stream.
    #[error("liblsl does not take the stream {0}")]
    Stream(String),
}

impl Library {
    /// Loads it from this file, or from where the system has it.
    pub(super) fn load(file: Option<&Path>) -> Result<Self, LibraryError> {
        if cfg!(target_feature = "crt-static") {
            return Err(LibraryError::Static);
        }
        let loaded = match file {
            Some(file) => {
                let unloaded = |error| LibraryError::Load { file: file.to_owned(), error };
                open(file.as_os_str()).map_err(unloaded)?
            }
            None => NAMES.iter().find_map(|name| open(name.as_ref()).ok()).ok_or(LibraryError::Absent)?,
        };
        let lacks = LibraryError::Lacks;
        // SAFETY: the symbols are those of lsl_c.h, whose signatures the fields have; the pointers live no longer than the library beside them.
        unsafe {
            Ok(Self {
                local_clock: *loaded.get(b"lsl_local_clock\0").map_err(lacks)?,
                create_info: *loaded.get(b"lsl_create_streaminfo\0").map_err(lacks)?,
                destroy_info: *loaded.get(b"lsl_destroy_streaminfo\0").map_err(lacks)?,
                description: *loaded.get(b"lsl_get_desc\0").map_err(lacks)?,
                append_child: *loaded.get(b"lsl_append_child\0").map_err(lacks)?,
                append_value: *loaded.get(b"lsl_append_child_value\0").map_err(lacks)?,
                create_outlet: *loaded.get(b"lsl_create_outlet\0").map_err(lacks)?,
                destroy_outlet: *loaded.get(b"lsl_destroy_outlet\0").map_err(lacks)?,
                push_numbers: *loaded.get(b"lsl_push_sample_dt\0").map_err(lacks)?,
                push_text: *loaded.get(b"lsl_push_sample_strt\0").map_err(lacks)?,
                _loaded: loaded,
            })
        }
    }

    /// Its clock, s.
    pub(super) fn clock_s(&self) -> f64 {
        // SAFETY: it takes nothing and keeps no state of ours.
        unsafe { (self.local_clock)() }
    }

    /// Offers a stream.
    pub(super) fn offer(self: &Arc<Self>, stream: &Stream) -> Result<Outlet, LibraryError> {
        let refused = || LibraryError::Stream(stream.name.clone());
        let [name, kind, source] = [stream.name.as_str(), stream.kind, &stream.source_id].map(text);
        let channels = i32::try_from(stream.channels.len()).map_err(|_| refused())?;
        let (count, format) = if channels == 0 { (1, STRING) } else { (channels, DOUBLE) };
        // SAFETY: texts end in zero and live during the calls; the info is destroyed once, after the outlet has copied it.
        unsafe {
            let info =
                (self.create_info)(name.as_ptr(), kind.as_ptr(), count, IRREGULAR, format, source.as_ptr());
            if info.is_null() {
                return Err(refused());
            }
            self.describe((self.description)(info), &stream.channels);
            let outlet = (self.create_outlet)(info, 0, BUFFERED_S);
            (self.destroy_info)(info);
            let handle = NonNull::new(outlet).ok_or_else(refused)?;
            Ok(Outlet { library: Arc::clone(self), handle, channels: stream.channels.len() })
        }
    }

    /// Names the channels as XDF files do.
    ///
    /// # Safety
    /// `description` is that of a stream info that lives.
    unsafe fn describe(&self, description: Pointer, channels: &[Channel]) {
        // SAFETY: as the caller says; liblsl copies the texts, and answers null with null.
        unsafe {
            (self.append_value)(description, c"manufacturer".as_ptr(), c"posed".as_ptr());
            let list = (self.append_child)(description, c"channels".as_ptr());
            for channel in channels {
                let entry = (self.append_child)(list, c"channel".as_ptr());
                for (key, value) in
                    [(c"label", channel.label.as_str()), (c"type", channel.kind), (c"unit", channel.unit)]
                {
                    (self.append_value)(entry, key.as_ptr(), text(value).as_ptr());
                }
            }
        }
    }
}

// SAFETY: liblsl's outlets may be used and destroyed in any thread; ours belongs to one at a time.
unsafe impl Send for Outlet {}

impl Outlet {
    /// Tells one number per channel, at a time of the library's clock, s.
    pub(super) fn numbers(&self, numbers: &[f64], t_s: f64) {
        if numbers.len() == self.channels && self.channels > 0 {
            // SAFETY: as many numbers as the outlet has channels are read, and copied.
            unsafe { (self.library.push_numbers)(self.handle.as_ptr(), numbers.as_ptr(), t_s) };
        }
    }

    /// Tells a text.
    pub(super) fn text(&self, emitted: &str, t_s: f64) {
        if self.channels == 0 {
            let emitted = text(emitted);
            let list = [emitted.as_ptr()];
            // SAFETY: one text is read, for the outlet has one channel, and copied.
            unsafe { (self.library.push_text)(self.handle.as_ptr(), list.as_ptr(), t_s) };
        }
    }
}

impl Drop for Outlet {
    fn drop(&mut self) {
        // SAFETY: it was created by this library and is destroyed once.
        unsafe { (self.library.destroy_outlet)(self.handle.as_ptr()) };
    }
}

fn open(name: &std::ffi::OsStr) -> Result<Loaded, libloading::Error> {
    // SAFETY: the operator names the file, or has installed it; its initialisers are liblsl's.
    unsafe { Loaded::new(name) }
}

/// Without what C takes for the end.
fn text(of: &str) -> CString {
    CString::new(of.replace('\0', " ")).unwrap_or_default()
}
