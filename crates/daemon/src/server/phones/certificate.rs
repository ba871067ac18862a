//! The certificate that phones are served with: made and kept by the daemon.
//!
//! In: a folder, and the names and addresses of this computer. Out: an authority of this daemon's own, which a phone can be set to
//! trust, and leaves that it signs. Never: a key that another user of this computer may read, or an authority that could speak for a
//! name on the internet: it is constrained to local names and private addresses.

use std::fmt::Write;
use std::io;
use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;

use posed_recording::AtomicFile;
use rcgen::{
    BasicConstraints, CertificateParams, CidrSubnet, DnType, ExtendedKeyUsagePurpose, GeneralSubtree, IsCa,
    Issuer, KeyPair, KeyUsagePurpose, NameConstraints, SanType, date_time_ymd,
};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

use super::secret;

/// The authority's certificate in its folder.
const AUTHORITY: &str = "authority.pem";
/// Its key.
const KEY: &str = "authority-key.pem";
/// Years that a phone goes on trusting it.
const YEARS: i32 = 20;
/// Days that a leaf serves: one is made at every start, and by [`Certificates::acceptor`]'s caller when it is old. Phones refuse
/// leaves of more than 398 days.
pub(super) const LEAF_DAYS: i64 = 90;

/// What a leaf may be for: no phone that trusts the authority can be led astray by it on the internet.
const PRIVATE: [(&str, u8); 8] = [
    ("10.0.0.0", 8),
    ("172.16.0.0", 12),
    ("192.168.0.0", 16),
    ("169.254.0.0", 16),
    ("127.0.0.0", 8),
    ("fc00::", 7),
    ("fe80::", 10),
    ("::1", 128),
];
const LOCAL: [&str; 2] = ["local", "localhost"];

/// Why there is no certificate.
#[derive(Debug, thiserror::Error)]
pub enum CertificateError {
    /// The folder cannot be read or written.
    #[error("cannot keep the certificate for phones in {folder}: {error}")]
    Folder {
        /// Which.
        folder: String,
        /// What the system said.
        error: io::Error,
    },
    /// What lies there is none.
    #[error(
        "the certificate for phones cannot be used: {0}; remove its folder `phones`, and phones trust a new one"
    )]
    Unusable(String),
}

/// An authority of this daemon's own.
pub(super) struct Certificates {
    certificate: CertificateDer<'static>,
    key: KeyPair,
    name: String,
}

impl Certificates {
    /// The authority that is kept in the folder, or a new one.
    pub(super) fn open(folder: &Path, utc_ns: i64) -> Result<Self, CertificateError> {
        let refuse = |error| CertificateError::Folder { folder: folder.display().to_string(), error };
        let (certificate_path, key_path) = (folder.join(AUTHORITY), folder.join(KEY));
        if certificate_path.exists() && key_path.exists() {
            let certificate = CertificateDer::from_pem_file(&certificate_path).map_err(unusable)?;
            let key = std::fs::read_to_string(&key_path).map_err(refuse)?;
            let key = KeyPair::from_pem(&key).map_err(unusable)?;
            let name = name_of(&key);
            return Ok(Self { certificate, key, name });
        }
        let key = KeyPair::generate().map_err(unusable)?;
        let name = name_of(&key);
        let certificate = authority(&name, date(utc_ns).0).self_signed(&key).map_err(unusable)?;
        secret::write(&key_path, &key.serialize_pem()).map_err(refuse)?;
        AtomicFile::replace(&certificate_path, certificate.pem().as_bytes()).map_err(refuse)?;
        Ok(Self { certificate: certificate.der().clone(), key, name })
    }

    /// The authority's certificate as phones take it.
    pub(super) fn der(&self) -> &[u8] {
        &self.certificate
    }

    /// By which somebody recognises the authority on a phone: SHA-256, in pairs of digits.
    pub(super) fn fingerprint(&self) -> String {
        let digest = ring::digest::digest(&ring::digest::SHA256, &self.certificate);
        let mut text = String::new();
        for (at, byte) in digest.as_ref().iter().enumerate() {
            let _ = write!(text, "{}{byte:02X}", if at == 0 { "" } else { ":" });
        }
        text
    }

    /// What the authority is called on a phone.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// A server with a new leaf for these names and addresses; an address outside of the private ranges has none.
    pub(super) fn acceptor(
        &self,
        names: &[String],
        addresses: &[IpAddr],
        utc_ns: i64,
    ) -> Result<TlsAcceptor, CertificateError> {
        let (leaf, key) = self.leaf(names, addresses, utc_ns)?;
        serving(vec![leaf, self.certificate.clone()], key)
            .map_err(|error| CertificateError::Unusable(error.to_string()))
    }

    fn leaf(
        &self,
        names: &[String],
        addresses: &[IpAddr],
        utc_ns: i64,
    ) -> Result<(CertificateDer<'static>, PrivateKeyDer<'static>), CertificateError> {
        let mut params = CertificateParams::new(names.to_vec()).map_err(unusable)?;
        let private = addresses.iter().filter(|address| is_private(**address));
        params.subject_alt_names.extend(private.copied().map(SanType::IpAddress));
        let called = names.first().map_or("posed", String::as_str);
        params.distinguished_name = rcgen::DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, called);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        params.use_authority_key_identifier_extension = true;
        let day_ns = 86_400_000_000_000;
        // From yesterday on: a phone's clock may be behind.
        let (year, month, day) = date(utc_ns.saturating_sub(day_ns));
        params.not_before = date_time_ymd(year, month, day);
        let (year, month, day) = date(utc_ns.saturating_add((LEAF_DAYS + 1) * day_ns));
        params.not_after = date_time_ymd(year, month, day);
        let of_authority = authority(&self.name, date(utc_ns).0);
        let issuer = Issuer::from_params(&of_authority, &self.key);
        let key = KeyPair::generate().map_err(unusable)?;
        let leaf = params.signed_by(&key, &issuer).map_err(unusable)?;
        let key = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.serialize_der()));
        Ok((leaf.der().clone(), key))
    }
}

fn serving(
    chain: Vec<CertificateDer<'static>>,
    key: PrivateKeyDer<'static>,
) -> Result<TlsAcceptor, rustls::Error> {
    let mut config = ServerConfig::builder_with_provider(Arc::new(crypto::ring::default_provider()))
        .with_safe_default_protocol_versions()?
        .with_no_client_auth()
        .with_single_cert(chain, key)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}

fn unusable(error: impl ToString) -> CertificateError {
    CertificateError::Unusable(error.to_string())
}

/// By its key, so that it is the same whenever a leaf is signed, and each daemon's differs.
fn name_of(key: &KeyPair) -> String {
    let digest = ring::digest::digest(&ring::digest::SHA256, key.public_key_raw());
    let [a, b, c, ..] = digest.as_ref() else { return "posed".to_owned() };
    format!("posed {a:02x}{b:02x}{c:02x}")
}

fn authority(name: &str, year: i32) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let addresses = PRIVATE.iter().filter_map(|(address, prefix)| {
        Some(GeneralSubtree::IpAddress(CidrSubnet::from_addr_prefix(address.parse().ok()?, *prefix)))
    });
    let names = LOCAL.iter().map(|name| GeneralSubtree::DnsName((*name).to_owned()));
    params.name_constraints = Some(NameConstraints {
        permitted_subtrees: names.chain(addresses).collect(),
        excluded_subtrees: Vec::new(),
    });
    params.not_before = date_time_ymd(year - 1, 1, 1);
    params.not_after = date_time_ymd(year + YEARS, 1, 1);
    params
}

/// Whether a leaf can be for this address.
pub(super) fn is_private(address: IpAddr) -> bool {
    PRIVATE.iter().any(|(network, prefix)| match (address, network.parse()) {
        (IpAddr::V4(address), Ok(IpAddr::V4(network))) => {
            (address.to_bits() ^ network.to_bits()).leading_zeros() >= u32::from(*prefix)
        }
        (IpAddr::V6(address), Ok(IpAddr::V6(network))) => {
            (address.to_bits() ^ network.to_bits()).leading_zeros() >= u32::from(*prefix)
        }
        _ => false,
    })
}

/// Year, month and day of a time in ns since 1970.
fn date(utc_ns: i64) -> (i32, u8, u8) {
    let utc = jiff::Timestamp::from_nanosecond(utc_ns.into()).unwrap_or_default();
    let date = utc.to_zoned(jiff::tz::TimeZone::UTC).date();
    (date.year().into(), date.month().unsigned_abs(), date.day().unsigned_abs())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use rustls::client::WebPkiServerVerifier;
    use rustls::client::danger::ServerCertVerifier;
    use rustls::pki_types::{ServerName, UnixTime};

    use super::*;

    const UTC_NS: i64 = 1_796_000_000_000_000_000;

    #[test]
    fn the_authority_stays_and_its_key_is_nobody_elses() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("phones");
        let first = Certificates::open(&folder, UTC_NS).unwrap();
        let again = Certificates::open(&folder, UTC_NS + 1).unwrap();
        assert_eq!((first.der(), first.name()), (again.der(), again.name()));
        assert_eq!(first.fingerprint().len(), 32 * 3 - 1);
        let mode = std::fs::metadata(folder.join(KEY)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        std::fs::write(folder.join(KEY), "none").unwrap();
        assert!(matches!(Certificates::open(&folder, UTC_NS), Err(CertificateError::Unusable(_))));
    }

    #[test]
    fn who_trusts_the_authority_trusts_its_leaf_for_local_names_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let certificates = Certificates::open(&folder.path().join("phones"), UTC_NS).unwrap();
        let leaf_for = |names: &[&str], addresses: &[&str]| {
            let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
            let addresses: Vec<IpAddr> = addresses.iter().map(|address| address.parse().unwrap()).collect();
            certificates.leaf(&names, &addresses, UTC_NS).unwrap().0
        };
        let mut roots = rustls::RootCertStore::empty();
        roots.add(CertificateDer::from(certificates.der().to_vec())).unwrap();
        let provider = Arc::new(crypto::ring::default_provider());
        let verifier =
            WebPkiServerVerifier::builder_with_provider(Arc::new(roots), provider).build().unwrap();
        let trusts = |leaf: &CertificateDer<'_>, name: &str, utc_s: u64| {
            let name = ServerName::try_from(name.to_owned()).unwrap();
            let time = UnixTime::since_unix_epoch(std::time::Duration::from_secs(utc_s));
            verifier.verify_server_cert(leaf, &[], &name, &[], time).is_ok()
        };
        let (now_s, day_s) = (UTC_NS as u64 / 1_000_000_000, 86_400);
        let leaf = leaf_for(&["posed-lab.local", "localhost"], &["192.168.1.5", "8.8.8.8"]);
        assert!(trusts(&leaf, "posed-lab.local", now_s) && trusts(&leaf, "192.168.1.5", now_s + 89 * day_s));
        assert!(!trusts(&leaf, "192.168.1.6", now_s) && !trusts(&leaf, "8.8.8.8", now_s));
        assert!(!trusts(&leaf, "posed-lab.local", now_s + 92 * day_s), "it has ended");
        // Were its key stolen, it could not speak for others.
        assert!(!trusts(&leaf_for(&["bank.example"], &[]), "bank.example", now_s));
    }

    #[test]
    fn an_authority_speaks_for_its_own_network_only() {
        for private in ["192.168.1.5", "10.1.2.3", "172.31.0.1", "127.0.0.1", "fe80::1", "fd00::7", "::1"] {
            assert!(is_private(private.parse().unwrap()), "{private}");
        }
        for public in ["8.8.8.8", "172.32.0.1", "192.169.0.1", "2001:db8::1", "::2"] {
            assert!(!is_private(public.parse().unwrap()), "{public}");
        }
    }
}
