//! The page (`src/`, TypeScript): built by `build.rs`, its files embedded in the program.
//!
//! What comes in: a path. What goes out: the file's bytes and their kind. What it never does: read a disk while the
//! program runs. Files are kept as they are sent to every browser, compressed: a third of their length.

use std::io::Read;

use flate2::read::GzDecoder;

/// Path and bytes, by gzip, of every file, as `build.rs` lists them.
static FILES: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/files.rs"));

/// A file of the page.
#[derive(Clone, Debug)]
pub struct File {
    /// Its media type.
    pub kind: &'static str,
    /// Its bytes, compressed by gzip.
    pub gzip: &'static [u8],
}

impl File {
    /// Its bytes.
    pub fn plain(&self) -> Vec<u8> {
        let mut plain = Vec::new();
        GzDecoder::new(self.gzip).read_to_end(&mut plain).expect("`build.rs` has compressed it");
        plain
    }
}

/// The file at `path`, for example `index.html` or `assets/main.js`; `None` where the page has none.
pub fn file(path: &str) -> Option<File> {
    let (_, gzip) = FILES.iter().find(|(name, _)| *name == path)?;
    let kind = match path.rsplit_once('.').map(|(_, extension)| extension) {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        _ => "application/octet-stream",
    };
    Some(File { kind, gzip })
}
