//! What of this computer stands in the daemon's way: rights, adapters that collect bytes, a service that does not run.
//!
//! In: the system's own files under a root folder. Out: findings with what to do. Nothing is changed.

use std::path::Path;

use serde::Serialize;

use posed_stage::{Problem, Stage, readable_by_others};

/// Bytes wait in an adapter for no longer than this, ms.
const LONGEST_WAIT_MS: u32 = 2;
/// What the package installs.
const UNIT: &str = "usr/lib/systemd/system/posed.service";
const STAGE: &str = "etc/posed/stage.toml";
const RULES: &str = "usr/lib/udev/rules.d/60-posed.rules";

/// Something that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Finding {
    /// What it is about: `serial_rights`, `latency`, `polhemus_usb`, `stage` or `service`.
    pub(super) check: &'static str,
    /// What is wrong; absent where nothing is.
    pub(super) problem: Option<String>,
    /// What to do about it.
    pub(super) fix: Option<String>,
}

/// Looks at everything that this computer has; `ports` are its serial ports.
pub(super) fn look(root: &Path, ports: &[String]) -> Vec<Finding> {
    let mut findings = Vec::new();
    if !ports.is_empty() {
        findings.push(serial_rights(ports));
    }
    findings.extend(latencies(root));
    findings.extend(polhemus(root));
    if root.join(UNIT).exists() {
        findings.extend(stage(root));
        findings.push(service(root));
    }
    findings
}

fn good(check: &'static str) -> Finding {
    Finding { check, problem: None, fix: None }
}

fn bad(check: &'static str, problem: String, fix: &str) -> Finding {
    Finding { check, problem: Some(problem), fix: Some(fix.to_owned()) }
}

/// Whether this user may open the serial ports.
fn serial_rights(ports: &[String]) -> Finding {
    let denied = ports.iter().find(|port| {
        let opened = std::fs::OpenOptions::new().read(true).write(true).open(port);
        opened.is_err_and(|error| error.kind() == std::io::ErrorKind::PermissionDenied)
    });
    match denied {
        Some(port) => bad(
            "serial_rights",
            format!("this user may not open {port}"),
            "sudo usermod -aG dialout $USER, and log in again",
        ),
        None => good("serial_rights"),
    }
}

/// How long each FTDI adapter collects bytes.
fn latencies(root: &Path) -> Vec<Finding> {
    let Ok(adapters) = std::fs::read_dir(root.join("sys/bus/usb-serial/devices")) else { return Vec::new() };
    let mut names: Vec<_> = adapters.filter_map(|adapter| Some(adapter.ok()?.path())).collect();
    names.sort();
    let wait = |path: &Path| -> Option<u32> {
        std::fs::read_to_string(path.join("latency_timer")).ok()?.trim().parse().ok()
    };
    let finding = |path: &std::path::PathBuf| {
        let wait_ms = wait(path)?;
        let name = path.file_name()?.to_string_lossy().into_owned();
        Some(if wait_ms > LONGEST_WAIT_MS {
            let fix = if root.join(RULES).exists() {
                "unplug the adapter and plug it in again; the package's udev rule sets 1 ms"
            } else {
                "write 1 to its latency_timer, or install the package, whose udev rule does"
            };
            bad("latency", format!("the adapter of {name} collects bytes for {wait_ms} ms"), fix)
        } else {
            good("latency")
        })
    };
    names.iter().filter_map(finding).collect()
}

/// Polhemus units at USB, which is not read; those that have not got their firmware have another product number.
fn polhemus(root: &Path) -> Vec<Finding> {
    let Ok(devices) = std::fs::read_dir(root.join("sys/bus/usb/devices")) else { return Vec::new() };
    let mut paths: Vec<_> = devices.filter_map(|device| Some(device.ok()?.path())).collect();
    paths.sort();
    let id = |path: &Path, file| {
        std::fs::read_to_string(path.join(file)).unwrap_or_default().trim().to_lowercase()
    };
    let polhemus = paths.iter().filter(|path| id(path, "idVendor") == "0f44");
    polhemus
        .map(|path| {
            let product = id(path, "idProduct");
            let name = match product.as_str() {
                "ff20" | "ff21" | "ff11" | "ff12" => "Polhemus Liberty",
                "ef20" | "ef21" | "ef11" | "ef12" => "Polhemus Patriot",
                _ => "Polhemus unit",
            };
            let problem = format!("a {name} is plugged in at USB (0f44:{product}), which is not read");
            bad(
                "polhemus_usb",
                problem,
                "connect its RS-232 port, with a null-modem cable where its manual says so",
            )
        })
        .collect()
}

/// Whether the service's stage file is right, and nobody's but the service's; nothing where it is not this user's to read.
fn stage(root: &Path) -> Option<Finding> {
    let path = root.join(STAGE);
    let check = "sudo posed check /etc/posed/stage.toml states what and how to fix it";
    Some(match std::fs::read_to_string(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => return None,
        Err(error) => bad("stage", format!("cannot read /{STAGE}: {error}"), check),
        Ok(text) => match (Stage::parse(&text), readable_by_others(&path, &text)) {
            (Err(problems), _) => bad("stage", format!("/{STAGE} is wrong: {problems}"), check),
            (Ok(_), Some(Problem { message, .. })) => {
                let fix =
                    "sudo chown root:posed /etc/posed/stage.toml && sudo chmod 0640 /etc/posed/stage.toml";
                bad("stage", format!("/{STAGE}: {message}"), fix)
            }
            (Ok(_), None) => good("stage"),
        },
    })
}

/// Whether the service runs: systemd keeps a link for each unit that does.
fn service(root: &Path) -> Finding {
    let runs = root.join("run/systemd/units/invocation:posed.service").is_symlink();
    if runs {
        return good("service");
    }
    bad(
        "service",
        "the service does not run".to_owned(),
        "journalctl -u posed states why; sudo systemctl enable --now posed starts it",
    )
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn put(root: &Path, path: &str, text: &str) {
        let path = root.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn problems(root: &Path) -> Vec<(&'static str, Option<String>)> {
        look(root, &[]).into_iter().map(|finding| (finding.check, finding.problem)).collect()
    }

    #[test]
    fn a_computer_without_adapters_and_service_has_no_findings() {
        assert_eq!(look(tempfile::tempdir().unwrap().path(), &[]), []);
    }

    #[test]
    fn a_slow_adapter_a_wrong_stage_and_a_dead_service_are_named() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        put(root, "sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "16\n");
        put(root, "sys/bus/usb-serial/devices/ttyUSB1/latency_timer", "1\n");
        put(root, "sys/bus/usb/devices/1-2/idVendor", "0f44\n");
        put(root, "sys/bus/usb/devices/1-2/idProduct", "ff20\n");
        put(root, "sys/bus/usb/devices/1-3/idVendor", "1209\n");
        let liberty = problems(root).remove(2);
        assert!(liberty.1.unwrap().contains("Polhemus Liberty"));
        std::fs::remove_dir_all(root.join("sys/bus/usb/devices/1-2")).unwrap();
        put(root, UNIT, "");
        let found = problems(root);
        assert_eq!(found[0], ("latency", Some("the adapter of ttyUSB0 collects bytes for 16 ms".into())));
        assert_eq!(found[1], ("latency", None));
        assert!(found[2].1.as_ref().unwrap().starts_with("cannot read /etc/posed/stage.toml"), "{found:?}");
        assert_eq!(found[3], ("service", Some("the service does not run".into())));

        put(root, STAGE, "name = \"stage\"\n");
        std::fs::create_dir_all(root.join("run/systemd/units")).unwrap();
        std::os::unix::fs::symlink("1", root.join("run/systemd/units/invocation:posed.service")).unwrap();
        put(root, "sys/bus/usb-serial/devices/ttyUSB0/latency_timer", "1\n");
        assert!(problems(root).iter().all(|(_, problem)| problem.is_none()), "{:?}", problems(root));

        let token = "[[server.token]]\nsecret = \"sixteen-or-more-of-it\"\nrole = \"watch\"\n";
        put(root, STAGE, &format!("name = \"stage\"\n{token}"));
        std::fs::set_permissions(root.join(STAGE), PermissionsExt::from_mode(0o644)).unwrap();
        assert!(problems(root)[2].1.as_ref().unwrap().contains("it holds secrets"), "{:?}", problems(root));
        std::fs::set_permissions(root.join(STAGE), PermissionsExt::from_mode(0o640)).unwrap();
        assert_eq!(problems(root)[2].1, None);
    }
}
