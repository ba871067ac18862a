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
    let unread = |line: &&str| {
        // systemd before 254 starts it anew every second.
        let later = line.contains("RestartSteps") || line.contains("RestartMaxDelaySec");
        line.contains("Failed to parse") || (line.contains("Unknown") && !later)
    };
    assert_eq!(verified.lines().find(unread), None, "{verified}");
}

/// The value of a key of the unit file.
fn directive(unit: &str, key: &str) -> String {
    let line = unit.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
    line.unwrap_or_else(|| panic!("the unit has no {key}")).to_owned()
}

#[test]
fn the_service_is_never_given_up_and_waits_for_its_address() {
    let unit = file("packaging/posed.service");
    for (key, value) in [
        ("Restart", "always"),
        ("StartLimitIntervalSec", "0"),
        ("RestartSteps", "8"),
        ("RestartMaxDelaySec", "30"),
        ("TimeoutStartSec", "infinity"),
        ("Wants", "network-online.target"),
        ("After", "network-online.target"),
    ] {
        assert_eq!(directive(&unit, key), value, "{key}");
    }
    assert!(directive(&unit, "ExecStart").ends_with(" --wait"));
}

/// Its own limits must not add up to more: honest use would end it.
#[test]
fn the_memory_of_the_service_is_beyond_what_its_limits_add_up_to() {
    let limits = posed_stage::Limits::default();
    let clients_gib = limits.all_queues_bytes as f64 / f64::from(1 << 30);
    let stated = directive(&file("packaging/posed.service"), "MemoryMax");
    let stated_gib: f64 = stated.strip_suffix('G').unwrap().parse().unwrap();
    assert!(stated_gib >= clients_gib + 1.0, "{stated} for {clients_gib} GiB of clients");
    assert!(file("docs/installing.md").contains(&format!("`MemoryMax={stated}`")));
}

#[test]
fn the_stage_file_is_installed_for_the_service_alone() {
    let manifest: toml::Table = file("Cargo.toml").parse().unwrap();
    let assets = manifest["package"]["metadata"]["deb"]["assets"].as_array().unwrap();
    let stage = assets.iter().find(|asset| asset[0].as_str() == Some("packaging/stage.toml")).unwrap();
    assert_eq!(stage[2].as_str(), Some("640"));
    let postinst = file("packaging/maintainer/postinst");
    for step in ["chown root:posed /etc/posed/stage.toml", "chmod 0640 /etc/posed/stage.toml"] {
        assert!(postinst.contains(step), "{step}");
    }
}

/// A line with a key or a table behind `# ` counts as if it stood there.
fn uncommented(text: &str) -> String {
    let key = |line: &str| {
        let word = line.split(" = ").next().unwrap();
        let is_key = line.contains(" = ") && word.chars().all(|c| c.is_ascii_lowercase() || c == '_');
        is_key || (line.starts_with('[') && line.ends_with(']'))
    };
    let lines = text.lines().map(|line| match line.strip_prefix("# ") {
        Some(commented) if key(commented) => commented,
        _ => line,
    });
    lines.collect::<Vec<_>>().join("\n")
}

#[test]
fn every_stage_that_is_installed_is_right_with_its_commented_keys_too() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let examples = fs::read_dir(root.join("config")).unwrap().map(|entry| entry.unwrap().path());
    let stages =
        examples.chain(["packaging/stage.toml", "packaging/inside/stage.toml"].map(|path| root.join(path)));
    let mut keys = 0;
    for path in stages.filter(|path| path.extension().is_some_and(|ending| ending == "toml")) {
        let text = fs::read_to_string(&path).unwrap();
        let whole = uncommented(&text);
        keys += text.lines().zip(whole.lines()).filter(|(one, other)| one != other).count();
        for text in [text, whole] {
            let report = posed_stage::check(&text);
            assert!(report.ok, "{}: {:?}", path.display(), report.problems);
        }
    }
    assert!(keys >= 10, "only {keys} keys are commented out: are they found?");
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
