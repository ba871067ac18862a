//! The page (`src/`, TypeScript): built by `build.rs`, its files embedded in the program.
//!
//! What comes in: a path. What goes out: the file's bytes and their kind. What it never does: read a disk while the
//! program runs.

/// Path and bytes of every file, as `build.rs` lists them.
static FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/files.rs"));

/// A file of the page.
#[derive(Clone, Debug)]
pub struct File {
    /// Its media type.
    pub kind: &'static str,
    /// Its bytes.
    pub data: &'static [u8],
}

/// The file at `path`, for example `index.html` or `assets/main.js`; `None` where the page has none.
pub fn file(path: &str) -> Option<File> {
    let (_, data) = FILES.iter().find(|(name, _)| *name == path)?;
    let kind = match path.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        _ => "application/octet-stream",
    };
    Some(File { kind, data })
}
