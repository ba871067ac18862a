//! Who may connect, and the files that the server needs.

use std::fs;
use std::net::{IpAddr, SocketAddr};
use std::ops::Range;
use std::path::Path;

use super::super::problem::Notes;
use super::super::secrets::{PLACEHOLDER, is_readable_by_others, read_secret, secret_path};
use super::{At, Item};

pub(super) fn check(server: &Item<'_, '_>, folder: Option<&Path>, notes: &mut Notes<'_>) {
    let tokens = server.items("token");
    distinct(&tokens, notes);
    for token in &tokens {
        match secret(token, "secret", folder, notes) {
            None => {
                let message = "the key `secret` of [token] is missing";
                let fix = "add `secret`, or `secret_file` with the file that holds it";
                notes.problem(&token.header, "secret", message, fix);
            }
            Some(given) if !given.value.chars().all(|c| c.is_ascii_graphic()) => {
                let message = "spaces and special letters do not pass an HTTP header";
                notes.problem(&given.at, "secret", message, "use letters, digits and punctuation of ASCII");
            }
            Some(_) => {}
        }
    }
    if let Some(listen) = server.text("listen") {
        match loopback(listen.value) {
            None => {
                let message = format!("`{}` is no address to listen on", listen.value);
                notes.problem(
                    &listen.at,
                    "listen",
                    message,
                    "write \"ADDRESS:PORT\", such as \"127.0.0.1:8787\"",
                );
            }
            Some(false) if tokens.is_empty() => {
                let message = "anyone in the network could connect, for there is no token";
                let fix = "add a [[server.token]] with secret and role, or listen on \"127.0.0.1:8787\"";
                notes.problem(&listen.at, "listen", message, fix);
            }
            Some(_) => {}
        }
    }
    if let Some(phones) = server.text("phones")
        && loopback(phones.value).is_none()
    {
        let message = format!("`{}` is no address to listen on", phones.value);
        notes.problem(&phones.at, "phones", message, "write \"ADDRESS:PORT\", such as \"0.0.0.0:8788\"");
    }
    for origin in
        server.get("allowed_origins").and_then(|list| list.get_ref().as_array()).into_iter().flatten()
    {
        let Some(text) = origin.get_ref().as_str() else { continue };
        let host = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"));
        if host.is_none_or(|host| host.is_empty() || host.contains(['/', '*', ' '])) {
            let message = format!("`{text}` is no origin");
            let fix = "write scheme, host and port without a path, such as \"https://trainer.example:8443\"";
            notes.problem(&origin.span(), "allowed_origins", message, fix);
        }
    }
    if let (Some(tls), Some(folder)) = (server.item("tls"), folder) {
        let path = |key| tls.text(key).map(|path| Path::new(path.value)).unwrap_or(Path::new(""));
        pem(&tls, "certificate", "CERTIFICATE", &folder.join(path("certificate")), notes);
        let key = secret_path(folder, path("key"));
        pem(&tls, "key", "PRIVATE KEY", &key, notes);
        if let Some(named) = tls.text("key") {
            warn_if_readable(&key, &named.at, "key", notes);
        }
    }
}

/// Looks at a secret, which stands under `key` or in the file under `key` and `_file`. Gives it, as far as it can be read, and
/// `None` where neither key is there.
pub(super) fn secret(
    table: &Item<'_, '_>,
    key: &str,
    folder: Option<&Path>,
    notes: &mut Notes<'_>,
) -> Option<At<String>> {
    let file_key = format!("{key}_file");
    match (table.text(key), table.text(&file_key)) {
        (None, None) => None,
        (Some(written), file) => {
            if let Some(file) = file {
                let message = format!("both `{key}` and `{file_key}` are given");
                notes.problem(&file.at, &file_key, message, "keep one of the two");
            }
            if folder.is_some() && written.value == PLACEHOLDER {
                let message = "this is a copy of a stage file, and its secrets were left out";
                notes.problem(&written.at, key, message, "write a secret of your own");
            }
            Some(At { value: written.value.to_owned(), at: written.at })
        }
        (None, Some(file)) => {
            let value =
                folder.and_then(|folder| secret_in(&file, &file_key, folder, notes)).unwrap_or_default();
            Some(At { value, at: file.at })
        }
    }
}

/// The secret in the file that a key names; `None`, and a problem, where it cannot be read.
fn secret_in(file: &At<&str>, key: &str, folder: &Path, notes: &mut Notes<'_>) -> Option<String> {
    let path = secret_path(folder, Path::new(file.value));
    match read_secret(&path) {
        Ok(secret) => {
            warn_if_readable(&path, &file.at, key, notes);
            Some(secret.reveal().to_owned())
        }
        Err(message) => {
            let fix = "name a file that this user may read, with the secret in it and nothing else";
            notes.problem(&file.at, key, message, fix);
            None
        }
    }
}

/// Warns of the file of a secret that everybody may read.
pub(super) fn warn_if_readable(path: &Path, at: &Range<usize>, key: &str, notes: &mut Notes<'_>) {
    if is_readable_by_others(path) {
        let message = format!("everybody on this computer may read {}", path.display());
        notes.warning(at, key, message, format!("chmod o= {}", path.display()));
    }
}

/// Notes each secret that an earlier token has already, without showing it.
fn distinct(tokens: &[Item<'_, '_>], notes: &mut Notes<'_>) {
    for (index, token) in tokens.iter().enumerate() {
        let Some(secret) = token.text("secret").filter(|secret| secret.value != PLACEHOLDER) else {
            continue;
        };
        let mut earlier = tokens[..index].iter().filter_map(|token| token.text("secret"));
        if let Some(earlier) = earlier.find(|earlier| earlier.value == secret.value) {
            let message =
                format!("this is the secret of another token in line {}", notes.line(earlier.at.start));
            notes.problem(&secret.at, "secret", message, "give each token a secret of its own");
        }
    }
}

/// The address for VRPN clients.
pub(super) fn check_vrpn(vrpn: &Item<'_, '_>, notes: &mut Notes<'_>) {
    let Some(listen) = vrpn.text("listen") else { return };
    if loopback(listen.value).is_none() {
        let message = format!("`{}` is no address to listen on", listen.value);
        let fix = "write \"ADDRESS:PORT\", such as \"127.0.0.1:3883\" or \"0.0.0.0:3883\"";
        notes.problem(&listen.at, "listen", message, fix);
    }
}

/// Where datagrams go, `usual` as an example. Names are looked up when the daemon starts.
pub(super) fn check_targets(table: &Item<'_, '_>, usual: &str, notes: &mut Notes<'_>) {
    for target in table.get("targets").and_then(|list| list.get_ref().as_array()).into_iter().flatten() {
        let Some(text) = target.get_ref().as_str() else { continue };
        let is_target = text.rsplit_once(':').is_some_and(|(host, port)| {
            !host.is_empty() && !host.contains(['/', ' ']) && port.parse::<u16>().is_ok_and(|port| port > 0)
        });
        if !is_target {
            let message = format!("`{text}` is no address to send to");
            let fix = format!("write \"HOST:PORT\", such as \"{usual}\"");
            notes.problem(&target.span(), "targets", message, fix);
        }
    }
}

/// Whether an address to listen on is this machine's own; `None` if it is no address.
fn loopback(listen: &str) -> Option<bool> {
    if let Ok(address) = listen.parse::<SocketAddr>() {
        return Some(match address.ip() {
            IpAddr::V4(ip) => ip.is_loopback(),
            IpAddr::V6(ip) => ip.is_loopback() || ip.to_ipv4_mapped().is_some_and(|ip| ip.is_loopback()),
        });
    }
    let (host, port) = listen.rsplit_once(':')?;
    port.parse::<u16>().ok()?;
    (host == "localhost").then_some(true)
}

/// The file under `key`, which is `full`, must hold a PEM block of some kind.
pub(super) fn pem(tls: &Item<'_, '_>, key: &str, block: &str, full: &Path, notes: &mut Notes<'_>) {
    let Some(path) = tls.text(key) else { return };
    match fs::read(full) {
        Err(error) => {
            let message = format!("cannot read {}: {error}", full.display());
            notes.problem(
                &path.at,
                key,
                message,
                "name a PEM file that this user may read; relative paths begin at the stage file",
            );
        }
        Ok(bytes) => {
            let text = String::from_utf8_lossy(&bytes);
            if !text.lines().any(|line| line.starts_with("-----BEGIN") && line.contains(block)) {
                let message = format!("{} holds no {block} block", full.display());
                notes.problem(&path.at, key, message, "name a PEM file");
            }
        }
    }
}

/// The model is read when the daemon starts.
pub(super) fn segments_model(segments: &Item<'_, '_>, folder: &Path, notes: &mut Notes<'_>) {
    let Some(path) = segments.text("model") else { return };
    let full = folder.join(path.value);
    if !full.is_file() {
        let message = format!("there is no file `{}`", full.display());
        notes.problem(&path.at, "model", message, "name a model that `posed segments train` wrote");
    }
}

#[cfg(test)]
mod tests {
    use super::loopback;

    #[test]
    fn only_this_machine_is_loopback() {
        for own in ["127.0.0.1:8787", "127.8.8.8:1", "[::1]:8787", "[::ffff:127.0.0.1]:80", "localhost:8787"]
        {
            assert_eq!(loopback(own), Some(true), "{own}");
        }
        for open in ["0.0.0.0:8787", "[::]:8787", "192.168.1.7:8787"] {
            assert_eq!(loopback(open), Some(false), "{open}");
        }
        for wrong in ["8787", ":8787", "127.0.0.1", "stage.example:8787", "127.0.0.1:99999", "localhost:x"] {
            assert_eq!(loopback(wrong), None, "{wrong}");
        }
    }
}
