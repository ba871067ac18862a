//! The Python client, as a user has it: its wheel, against a running demo; its types, its notebook, and what it makes of a recording. And the Blender add-on.
//!
//! Runs where `POSED_TEST_READERS` names the folder into which `tests/readers/install` has put what it needs.

use std::path::Path;
use std::process::Command;

use crate::daemon::process::Posed;

#[test]
fn the_python_client_and_the_blender_add_on_do_what_they_say() {
    let Some(readers) = std::env::var_os("POSED_TEST_READERS") else {
        println!("skipped: set POSED_TEST_READERS to the folder that tests/readers/install has filled");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let demo = Posed::start([
        "demo".as_ref(),
        "--exercise".as_ref(),
        "curl".as_ref(),
        "--data".as_ref(),
        folder.path().as_os_str(),
    ]);
    let done = Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/client"))
        .arg(readers)
        .arg(folder.path())
        .env("POSED", env!("CARGO_BIN_EXE_posed"))
        .env("POSED_TEST_STAGE", demo.address.to_string())
        .env("POSED_TEST_RECORDINGS", folder.path().join("recordings"))
        .output()
        .unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&done.stdout), String::from_utf8_lossy(&done.stderr));
    println!("{said}");
    assert!(done.status.success(), "{said}");
    // One that is skipped is one that has not been run.
    assert!(!said.contains("skipped"), "{said}");
}
