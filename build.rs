//! Builds the viewer page (`viewer/`) with npm and hands its folder to the server, which embeds it.
//!
//! Without npm the build goes on, with a page in its place that says what is missing. `POSED_VIEWER=skip` leaves npm out on
//! purpose; with `POSED_VIEWER=require` a viewer that cannot be built is an error: for packages and for the tests.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

const SOURCES: [&str; 7] =
    ["src", "index.html", "hub.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts"];

fn main() {
    let viewer = PathBuf::from(env::var("CARGO_MANIFEST_DIR").expect("cargo sets it")).join("viewer");
    let out = PathBuf::from(env::var("OUT_DIR").expect("cargo sets it")).join("viewer");
    println!("cargo::rustc-env=POSED_VIEWER_DIR={}", out.display());
    println!("cargo::rerun-if-env-changed=POSED_VIEWER");
    for source in SOURCES {
        println!("cargo::rerun-if-changed={}", viewer.join(source).display());
    }
    let wish = env::var("POSED_VIEWER").unwrap_or_default();
    let built = if wish == "skip" { Err("POSED_VIEWER=skip".to_owned()) } else { build(&viewer, &out) };
    if let Err(reason) = built {
        if wish == "require" {
            println!("cargo::error=the viewer page cannot be built: {reason}");
        } else if wish != "skip" {
            println!("cargo::warning=posed is built without its viewer page: {reason}");
        }
        explain(&out, &reason);
    }
}

/// `npm ci`, where the packages are not those of the lock file, then Vite.
fn build(viewer: &Path, out: &Path) -> Result<(), String> {
    let lock =
        fs::read(viewer.join("package-lock.json")).map_err(|error| format!("package-lock.json: {error}"))?;
    let stamp = viewer.join("node_modules/.posed-lock");
    if fs::read(&stamp).ok().as_deref() != Some(&lock) {
        npm(viewer, &["ci", "--no-audit", "--no-fund"])?;
        fs::write(&stamp, &lock).map_err(|error| format!("{}: {error}", stamp.display()))?;
    }
    let out = out.to_str().ok_or("the build folder's path is not text")?;
    npm(viewer, &["run", "build", "--", "--outDir", out, "--emptyOutDir", "--logLevel", "warn"])
}

fn npm(viewer: &Path, arguments: &[&str]) -> Result<(), String> {
    let output = Command::new("npm")
        .args(arguments)
        .current_dir(viewer)
        .output()
        .map_err(|error| format!("npm cannot be started ({error}); install nodejs and npm"))?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let last = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or_default();
    Err(format!("npm {}: {}", arguments.join(" "), last.trim()))
}

/// The page in the viewer's place.
fn explain(out: &Path, reason: &str) {
    let reason = reason.replace('&', "&amp;").replace('<', "&lt;");
    let page = format!(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>posed</title>\n\
         <h1>posed is running</h1>\n<p>This build has no viewer page: {reason}. Install nodejs and npm and build again.</p>\n\
         <p>Everything else works: the websocket at /ws, <a href=\"metrics\">metrics</a>, <a href=\"health\">health</a>.</p>\n</html>\n"
    );
    let _ = fs::remove_dir_all(out);
    let written = fs::create_dir_all(out)
        .and_then(|()| fs::write(out.join("index.html"), &page))
        .and_then(|()| fs::write(out.join("hub.html"), &page));
    if let Err(error) = written {
        println!("cargo::error={}: {error}", out.display());
    }
}
