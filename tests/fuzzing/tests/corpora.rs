//! The inputs of `fuzz/corpus/` as ordinary tests, each within its target's memory.

#![allow(clippy::unwrap_used, reason = "a test may stop where its ground gives way")]

use std::path::Path;
use std::process::Command;

use posed_fuzzing::TARGETS;

/// Largest corpus, bytes.
const MOST_BYTES: usize = 100_000;

fn corpora() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus")
}

#[test]
fn every_target_bears_its_corpus() {
    for target in TARGETS {
        let mut bytes = 0;
        let mut files: Vec<_> = std::fs::read_dir(corpora().join(target.name)).unwrap().flatten().collect();
        files.sort_by_key(std::fs::DirEntry::file_name);
        assert!(!files.is_empty(), "{} has no corpus", target.name);
        for file in files {
            let data = std::fs::read(file.path()).unwrap();
            println!("{}", file.path().display());
            target.run(&data);
            bytes += data.len();
        }
        assert!(bytes <= MOST_BYTES, "the corpus of {} has {bytes} bytes", target.name);
    }
}

#[test]
fn every_corpus_and_every_program_has_a_target() {
    let names: Vec<&str> = TARGETS.iter().map(|target| target.name).collect();
    for folder in std::fs::read_dir(corpora()).unwrap().flatten() {
        assert!(
            names.contains(&folder.file_name().to_str().unwrap()),
            "{:?} is no target",
            folder.file_name()
        );
    }
    let manifest = std::fs::read_to_string(corpora().join("../Cargo.toml")).unwrap();
    let programs: Vec<&str> = manifest
        .lines()
        .skip_while(|line| *line != "[[bin]]")
        .filter_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"'))
        .collect();
    assert_eq!(programs, names);
}

#[test]
fn what_takes_more_memory_than_it_may_is_stopped() {
    // It ends the whole process, so that this test runs itself.
    const BYTES: &str = "POSED_TAKES_BYTES";
    if let Ok(bytes) = std::env::var(BYTES) {
        let bytes = bytes.parse().unwrap();
        posed_rig::counting::within(1000, || drop(std::hint::black_box(Vec::<u8>::with_capacity(bytes))));
        return;
    }
    let run = |bytes: &str| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "what_takes_more_memory_than_it_may_is_stopped", "--nocapture"]);
        command.env(BYTES, bytes).output().unwrap()
    };
    assert!(run("900").status.success());
    let stopped = run("1100");
    assert!(!stopped.status.success());
    assert!(String::from_utf8_lossy(&stopped.stderr).contains("more than this may take"), "{stopped:?}");
}
