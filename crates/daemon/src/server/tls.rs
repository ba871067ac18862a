//! TLS from the stage file's PEM files.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

use posed_stage::Tls;

/// Why TLS cannot be offered.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read, or is no PEM file of its kind.
    #[error("cannot read the {what} {}: {error}", path.display())]
    File {
        /// Certificate or key.
        what: &'static str,
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        error: rustls::pki_types::pem::Error,
    },
    /// The certificate file is empty.
    #[error("there is no certificate in {}", path.display())]
    Empty {
        /// Which file.
        path: PathBuf,
    },
    /// The two do not go together.
    #[error("certificate and key do not serve: {0}")]
    Refused(#[from] rustls::Error),
}

/// Reads the files; relative paths start from `folder`.
pub(super) fn acceptor(files: &Tls, folder: &Path) -> Result<TlsAcceptor, TlsError> {
    let path = folder.join(&files.certificate);
    let refuse = |error| TlsError::File { what: "certificate", path: path.clone(), error };
    let chain = CertificateDer::pem_file_iter(&path).map_err(refuse)?;
    let chain = chain.collect::<Result<Vec<_>, _>>().map_err(refuse)?;
    if chain.is_empty() {
        return Err(TlsError::Empty { path });
    }
    let path = folder.join(&files.key);
    let key =
        PrivateKeyDer::from_pem_file(&path).map_err(|error| TlsError::File { what: "key", path, error })?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()?
        .with_no_client_auth()
        .with_single_cert(chain, key)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}
