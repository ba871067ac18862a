//! Certificates for encrypted links between stages, routers and hubs: an authority of their own, and one for each computer that it signs.
//!
//! In: a folder, and by which names and addresses each computer is known. Out: PEM files; those of `[zenoh.tls]` are to be copied to their computers.
//! Never: a file that is there written over, or a key that other users of this computer may read.

use std::io;
use std::path::{Path, PathBuf};

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};

use posed_daemon::server::write_secret;
use posed_recording::AtomicFile;

/// The authority, in its folder: its certificate goes to every computer.
pub const AUTHORITY: &str = "authority.pem";
/// Its key, which stays where it is.
const AUTHORITY_KEY: &str = "authority-key.pem";

/// Why there are no certificates.
#[derive(Debug, thiserror::Error)]
pub enum CertificatesError {
    /// A file cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// No computer is called so.
    #[error("{0:?} is no name of a computer")]
    Name(String),
    /// What lies in the folder is no authority, or a name cannot be in a certificate.
    #[error("{subject}: {error}")]
    Unusable {
        /// Which file or name.
        subject: String,
        /// What is wrong with it.
        error: rcgen::Error,
    },
}

/// Writes `NAME.pem` and `NAME-key.pem` for each computer that has none yet, and the authority that signs them if the folder has
/// none. Each of `computers` is a list of names and addresses with commas between, such as `hub.local,10.0.0.5`, of which the first names the files.
/// Returns the certificates that are new.
///
/// # Errors
/// A file that cannot be read or written, or a name that is none.
pub fn write_certificates(folder: &Path, computers: &[String]) -> Result<Vec<PathBuf>, CertificatesError> {
    let (certificate, key) = (folder.join(AUTHORITY), folder.join(AUTHORITY_KEY));
    let mut written = Vec::new();
    let authority_key = match std::fs::read_to_string(&key) {
        Ok(text) => KeyPair::from_pem(&text).map_err(unusable(&key.display().to_string()))?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let new = KeyPair::generate().map_err(unusable("a key"))?;
            write_secret(&key, &new.serialize_pem()).map_err(file(&key))?;
            new
        }
        Err(error) => return Err(file(&key)(error)),
    };
    // Its own decision: what ended between the two has left a key alone.
    if !certificate.exists() {
        let signed = authority().self_signed(&authority_key).map_err(unusable("the authority"))?;
        AtomicFile::replace(&certificate, signed.pem().as_bytes()).map_err(file(&certificate))?;
        written.push(certificate);
    }
    let issuer = Issuer::new(authority(), authority_key);
    for computer in computers {
        let names: Vec<String> = computer.split(',').map(|name| name.trim().to_owned()).collect();
        let Some(first) = names.first().filter(|name| !name.is_empty() && !name.contains(['/', '\\'])) else {
            return Err(CertificatesError::Name(computer.clone()));
        };
        let path = folder.join(format!("{first}.pem"));
        if path.exists() {
            continue;
        }
        let mut params = CertificateParams::new(names.clone()).map_err(unusable(computer))?;
        params.distinguished_name = rcgen::DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, first.as_str());
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        // Either end may listen.
        params.extended_key_usages =
            vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        params.use_authority_key_identifier_extension = true;
        let key = KeyPair::generate().map_err(unusable("a key"))?;
        let signed = params.signed_by(&key, &issuer).map_err(unusable(computer))?;
        let key_path = folder.join(format!("{first}-key.pem"));
        write_secret(&key_path, &key.serialize_pem()).map_err(file(&key_path))?;
        AtomicFile::replace(&path, signed.pem().as_bytes()).map_err(file(&path))?;
        written.push(path);
    }
    Ok(written)
}

fn authority() -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, "posed links");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn file(path: &Path) -> impl Fn(io::Error) -> CertificatesError {
    let path = path.to_owned();
    move |error| CertificatesError::File { path: path.clone(), error }
}

fn unusable(subject: &str) -> impl Fn(rcgen::Error) -> CertificatesError {
    let subject = subject.to_owned();
    move |error| CertificatesError::Unusable { subject: subject.clone(), error }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_there_stays_and_a_name_that_is_none_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let write = |computers: &[&str]| {
            let computers: Vec<String> = computers.iter().map(|name| (*name).to_owned()).collect();
            write_certificates(folder.path(), &computers)
        };
        let names = |paths: Vec<PathBuf>| -> Vec<String> {
            paths.iter().map(|path| path.file_name().unwrap().to_string_lossy().into_owned()).collect()
        };
        assert_eq!(names(write(&["hub.local,127.0.0.1"]).unwrap()), [AUTHORITY, "hub.local.pem"]);
        let before = std::fs::read(folder.path().join("hub.local.pem")).unwrap();
        assert_eq!(names(write(&["hub.local", "stage-a"]).unwrap()), ["stage-a.pem"]);
        assert_eq!(std::fs::read(folder.path().join("hub.local.pem")).unwrap(), before);
        std::fs::remove_file(folder.path().join(AUTHORITY)).unwrap();
        assert_eq!(names(write(&["stage-b"]).unwrap()), [AUTHORITY, "stage-b.pem"]);
        for none in ["", ",", "../key", "a/b", "bä r"] {
            assert!(write(&[none]).is_err(), "{none:?}");
        }
        use std::os::unix::fs::PermissionsExt;
        for key in [AUTHORITY_KEY, "stage-a-key.pem"] {
            let mode = std::fs::metadata(folder.path().join(key)).unwrap().permissions().mode();
            assert_eq!(mode & 0o077, 0, "{key}");
        }
    }
}
