//! Runs the committed fuzz corpus as an ordinary test.

use std::path::Path;

use posed_drivers::flock::fuzzing;

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target);
    let mut files: Vec<_> = std::fs::read_dir(&folder).expect("the corpus is committed").flatten().collect();
    files.sort_by_key(std::fs::DirEntry::file_name);
    assert!(!files.is_empty());
    let read = |file: &std::fs::DirEntry| std::fs::read(file.path()).expect("a corpus file");
    files.iter().map(|file| (file.file_name().to_string_lossy().into_owned(), read(file))).collect()
}

#[test]
fn flock_wire() {
    for (_, bytes) in corpus("flock_wire") {
        fuzzing::wire(&bytes);
    }
}

#[test]
fn flock_session() {
    for (name, bytes) in corpus("flock_session") {
        let samples = fuzzing::session(&bytes);
        // The seeds lead a fuzzer all the way to poses.
        if ["stand-alone", "group", "point"].contains(&name.as_str()) {
            assert!(samples > 10, "{name}: {samples} samples");
        }
    }
}
