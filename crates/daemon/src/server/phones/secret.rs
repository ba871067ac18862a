//! Files that nobody but the daemon's user may read: the key of the certificate, and the token that phones come with.

use std::io::{self, Write};
use std::path::Path;

use posed_stage::Secret;
use ring::rand::{SecureRandom, SystemRandom};

/// The token in its folder.
const TOKEN: &str = "token";
/// Bytes of chance in a token: none is guessed, and it still fits a small QR code.
const TOKEN_BYTES: usize = 15;

/// Writes a new file, mode 0600, whole or not at all; its folder is made if there is none, mode 0700.
///
/// # Errors
/// What the system says.
pub fn write(path: &Path, text: &str) -> io::Result<()> {
    use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
    if let Some(folder) = path.parent() {
        std::fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    }
    let unfinished = path.with_extension("new");
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create(true).truncate(true).mode(0o600);
    let mut file = options.open(&unfinished)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    std::fs::rename(unfinished, path)
}

/// The token that is kept in the folder, or a new one.
pub(super) fn token(folder: &Path) -> io::Result<Secret> {
    let path = folder.join(TOKEN);
    match std::fs::read_to_string(&path) {
        Ok(text) if text.trim().len() >= 16 => return Ok(Secret::from(text.trim().to_owned())),
        Ok(_) => {}
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let mut bytes = [0; TOKEN_BYTES];
    SystemRandom::new()
        .fill(&mut bytes)
        .map_err(|_| io::Error::other("the system gives no random numbers"))?;
    let text = data_encoding::BASE64URL_NOPAD.encode(&bytes);
    write(&path, &text)?;
    Ok(Secret::from(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_made_once() {
        let folder = tempfile::tempdir().unwrap();
        let first = token(folder.path()).unwrap();
        assert_eq!(first.reveal().len(), 20);
        assert_eq!(token(folder.path()).unwrap(), first);
    }
}
