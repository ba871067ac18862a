//! Where other machines are, and under which key a stage is known to them.

use std::path::Path;

use super::super::problem::Notes;
use super::super::secrets::secret_path;
use super::Item;
use super::server::{pem, secret, warn_if_readable};

pub(super) fn check(zenoh: &Item<'_, '_>, folder: Option<&Path>, notes: &mut Notes<'_>) {
    if endpoints(zenoh, "listen", &LINKS, notes) + endpoints(zenoh, "connect", &LINKS, notes) == 0 {
        let message = "nobody can be reached: there is neither an address to listen on nor one to connect to";
        notes.problem(
            &zenoh.header,
            "connect",
            message,
            "write connect = [\"tcp/HOST:PORT\"] with the hub's address",
        );
    }
    if let Some(key) = zenoh.text("key")
        && !is_key(key.value)
    {
        let message = format!("`{}` is no key", key.value);
        let fix = "write letters, digits, `-` and `_`, with `/` between, such as \"hall-2/stage-a\"";
        notes.problem(&key.at, "key", message, fix);
    }
    check_tls(zenoh, folder, notes);
    let password = secret(zenoh, "password", folder, notes).is_some();
    for (given, key, other) in [
        (zenoh.text("user"), "user", (!password).then_some("password")),
        (zenoh.text("password"), "password", (!zenoh.has("user")).then_some("user")),
        (zenoh.text("password_file"), "password_file", (!zenoh.has("user")).then_some("user")),
    ] {
        if let (Some(given), Some(other)) = (given, other) {
            let message = format!("it has no effect without `{other}`");
            notes.problem(&given.at, key, message, format!("add `{other}`"));
        }
    }
    if let (Some(users), Some(folder)) = (zenoh.text("users"), folder) {
        let full = secret_path(folder, Path::new(users.value));
        if !full.is_file() {
            let message = format!("there is no file `{}`", full.display());
            notes.problem(
                &users.at,
                "users",
                message,
                "name a file with a line NAME:PASSWORD for each who may connect",
            );
        }
        warn_if_readable(&full, &users.at, "users", notes);
    }
}

/// Certificates are there where links are encrypted, and only there.
fn check_tls(zenoh: &Item<'_, '_>, folder: Option<&Path>, notes: &mut Notes<'_>) {
    let ends = ["listen", "connect"].into_iter().filter_map(|key| zenoh.get(key)?.get_ref().as_array());
    let encrypted =
        ends.flatten().find(|end| end.get_ref().as_str().is_some_and(|text| text.starts_with("tls/")));
    match (encrypted, zenoh.item("tls")) {
        (Some(end), None) => {
            let message = "an encrypted link needs certificates";
            let fix = "make them with `posed hub --certificates`, and name them in [zenoh.tls]";
            notes.problem(&end.span(), "tls", message, fix);
        }
        (None, Some(tls)) => {
            let message = "it has no effect: none of the addresses is of an encrypted link";
            notes.problem(
                &tls.header,
                "tls",
                message,
                "write tls/ in the place of tcp/ before the addresses",
            );
        }
        (Some(_), Some(tls)) => {
            let Some(folder) = folder else { return };
            let path = |key| Path::new(tls.text(key).map_or("", |path| path.value));
            for key in ["authority", "certificate"] {
                pem(&tls, key, "CERTIFICATE", &folder.join(path(key)), notes);
            }
            let key = secret_path(folder, path("key"));
            pem(&tls, "key", "PRIVATE KEY", &key, notes);
            if let Some(named) = tls.text("key") {
                warn_if_readable(&key, &named.at, "key", notes);
            }
        }
        (None, None) => {}
    }
}

pub(super) fn check_ros2(ros2: &Item<'_, '_>, notes: &mut Notes<'_>) {
    if endpoints(ros2, "connect", &["tcp/"], notes) == 0
        && let Some(connect) = ros2.get("connect")
    {
        let fix = "write connect = [\"tcp/HOST:7447\"] with the address of the router, or leave it out for that of this computer";
        notes.problem(&connect.span(), "connect", "there is no router to connect to", fix);
    }
    for (key, example) in [("namespace", "hall/left"), ("frame", "map")] {
        let Some(text) = ros2.text(key) else { continue };
        if !is_ros_name(text.value) {
            let message = format!("`{}` is no name in ROS 2", text.value);
            let fix = format!(
                "write letters, digits and single `_`, a letter first, with `/` between, such as \"{example}\""
            );
            notes.problem(&text.at, key, message, fix);
        }
    }
}

/// Names without a slash at their beginning.
fn is_ros_name(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.split('/').all(|token| {
        token.starts_with(|c: char| c.is_ascii_alphabetic())
            && token.chars().all(plain)
            && !token.contains("__")
    })
}

/// What addresses of stages, routers and hubs begin with.
const LINKS: [&str; 2] = ["tcp/", "tls/"];

/// How many there are in a list; those that are none are reported.
fn endpoints(table: &Item<'_, '_>, key: &str, protocols: &[&str], notes: &mut Notes<'_>) -> usize {
    let mut ends = 0;
    for end in table.get(key).and_then(|list| list.get_ref().as_array()).into_iter().flatten() {
        ends += 1;
        let Some(text) = end.get_ref().as_str() else { continue };
        if !is_endpoint(text, protocols) {
            let message = format!("`{text}` is no address of zenoh");
            let all: Vec<String> =
                protocols.iter().map(|protocol| format!("\"{protocol}HOST:PORT\"")).collect();
            let fix = format!("write {}, such as \"{}192.168.1.20:7447\"", all.join(" or "), protocols[0]);
            notes.problem(&end.span(), key, message, fix);
        }
    }
    ends
}

/// A host and a port, with nothing behind that would change what zenoh does.
fn is_endpoint(text: &str, protocols: &[&str]) -> bool {
    let address = protocols.iter().find_map(|protocol| text.strip_prefix(protocol));
    address.and_then(|address| address.rsplit_once(':')).is_some_and(|(host, port)| {
        !host.is_empty() && !host.contains(['/', ' ', '#', '?']) && port.parse::<u16>().is_ok()
    })
}

fn is_key(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    text.split('/').all(|chunk| !chunk.is_empty() && chunk.chars().all(plain))
}

#[cfg(test)]
mod tests {
    use crate::check;

    #[test]
    fn what_zenoh_could_not_use_is_reported_with_its_line_and_a_mend() {
        for (text, key) in [
            ("listen = [\"udp/0.0.0.0:7447\"]", "listen"),
            ("connect = [\"tcp/hub:7447#bind=1.2.3.4:1\"]", "connect"),
            ("connect = [\"tcp/hub\"]", "connect"),
            ("key = \"a\"", "connect"),
            ("connect = [\"tcp/hub:7447\"]\nkey = \"posed/**\"", "key"),
            ("connect = [\"tcp/hub:7447\"]\nkey = \"/a\"", "key"),
            ("connect = [\"tcp/hub:7447\"]\nuser = \"a\"", "user"),
            ("connect = [\"tcp/hub:7447\"]\nround_trip_ms = 0", "round_trip_ms"),
            ("connect = [\"tls/hub:7447\"]", "tls"),
            (
                "connect = [\"tcp/hub:7447\"]\ntls = {authority = \"a\", certificate = \"b\", key = \"c\"}",
                "tls",
            ),
            ("connect = [\"tls/hub:7447\"]\ntls = {certificate = \"b\", key = \"c\"}", "authority"),
            ("conect = []", "conect"),
        ] {
            let report = check(&format!("name = \"s\"\n[zenoh]\n{text}\n"));
            let problem = report.problems.iter().find(|problem| problem.key == key);
            assert!(problem.is_some_and(|problem| problem.line >= 2), "{text}: {:?}", report.problems);
        }
        for (text, key) in [
            ("connect = [\"udp/localhost:7447\"]", "connect"),
            ("connect = [\"tls/localhost:7447\"]", "connect"),
            ("connect = []", "connect"),
            ("namespace = \"/hall\"", "namespace"),
            ("namespace = \"hall__a\"", "namespace"),
            ("namespace = \"2nd\"", "namespace"),
            ("frame = \"my room\"", "frame"),
            ("frame = \"map/\"", "frame"),
            ("domain_id = 233", "domain_id"),
            ("domain_id = -1", "domain_id"),
            ("rate_hz = 0.0", "rate_hz"),
            ("topic = \"a\"", "topic"),
        ] {
            let report = check(&format!("name = \"s\"\n[ros2]\n{text}\n"));
            let problem = report.problems.iter().find(|problem| problem.key == key);
            assert!(problem.is_some_and(|problem| problem.line == 3), "{text}: {:?}", report.problems);
        }
        let right = "name = \"s\"\n[ros2]\nconnect = [\"tcp/robot:7447\"]\nnamespace = \"hall/left_2\"\nframe = \"world\"\n";
        assert!(check(right).ok, "{:?}", check(right).problems);
        let right = "name = \"s\"\n[zenoh]\nlisten = [\"tls/0.0.0.0:7447\"]\nconnect = [\"tcp/hub:7447\"]\n[zenoh.tls]\nauthority = \"a\"\ncertificate = \"b\"\nkey = \"c\"\n";
        assert!(check(right).ok, "{:?}", check(right).problems);
        let right = "name = \"s\"\n[zenoh]\nlisten = [\"tcp/[::]:7447\"]\nconnect = [\"tcp/hub:7447\"]\nkey = \"hall/a-1\"\n";
        assert!(check(right).ok, "{:?}", check(right).problems);
    }
}
