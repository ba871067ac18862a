//! What the Debian package brings, as far as it can be held against the documents without installing it: `packaging/check` does that,
//! as root, in a Debian of its own.

use std::fs;
use std::path::Path;
use std::process::Command;

fn file(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// The number between two words.
fn number(text: &str, before: &str) -> f64 {
    let (_, rest) = text.split_once(before).unwrap_or_else(|| panic!("no {before:?} in {text:?}"));
    rest.split([' ', ',', ')']).next().unwrap().parse().unwrap()
}

#[test]
fn the_service_has_no_more_rights_than_is_said() {
    let unit = Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging/posed.service");
    let analyze = |args: &[&str]| Command::new("systemd-analyze").args(args).arg(&unit).output();
    let Ok(output) = analyze(&["security", "--offline=true", "--no-pager"]) else {
        println!("skipped: there is no systemd-analyze");
        return;
    };
    let emitted = String::from_utf8_lossy(&output.stdout).into_owned();
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr).into_owned();
        // Older than 250.
        assert!(why.contains("unrecognized option"), "{why}");
        println!("skipped: this systemd-analyze cannot look at a file");
        return;
    }
    let exposure = number(&emitted, "exposure level for posed.service: ");
    let stated = number(&file("docs/installing.md"), "exposure of ");
    assert!(exposure <= stated, "{exposure}, and the documents say {stated}:\n{emitted}");
    // A directive that systemd does not know is ignored with a warning, and protects nothing.
    let verified = String::from_utf8_lossy(&analyze(&["verify"]).unwrap().stderr).into_owned();
    assert!(!verified.contains("Unknown") && !verified.contains("Failed to parse"), "{verified}");
}

#[test]
fn the_scripts_of_the_package_are_ones_a_shell_reads() {
    for script in ["maintainer/postinst", "maintainer/postrm", "build", "check"] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("packaging").join(script);
        let text = fs::read_to_string(&path).unwrap();
        let shell = text.lines().next().unwrap().rsplit(['/', ' ']).next().unwrap();
        let output = Command::new(shell).arg("-n").arg(&path).output().unwrap();
        assert!(output.status.success(), "{script}: {}", String::from_utf8_lossy(&output.stderr));
    }
    for script in ["maintainer/postinst", "maintainer/postrm"] {
        // Where cargo-deb puts what starts and ends the service.
        assert!(file(&format!("packaging/{script}")).contains("\n#DEBHELPER#\n"), "{script}");
    }
}
