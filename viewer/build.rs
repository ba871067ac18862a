//! Builds the viewer page with npm and hands a list of its files to `embed.rs`.
//!
//! Without npm the build goes on, with a page in its place that states what is missing. `POSED_VIEWER=skip` leaves npm out on
//! purpose; with `POSED_VIEWER=require` a viewer that cannot be built is an error: for packages and for the tests.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

use flate2::Compression;
use flate2::write::GzEncoder;

const SOURCES: [&str; 11] = [
    "src",
    "../clients/typescript/src",
    "index.html",
    "hub.html",
    "phone.html",
    "package.json",
    "package-lock.json",
    "tsconfig.json",
    "svelte.config.js",
    "lean.ts",
    "vite.config.ts",
];

fn main() {
    let viewer = PathBuf::from(env::var("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let target = PathBuf::from(env::var("OUT_DIR").expect("cargo sets it"));
    let out = target.join("viewer");
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
    let mut files = Vec::new();
    let listed = collect(&out, "", &mut files).and_then(|()| {
        files.sort();
        let compressed = compress(&files, &target.join("compressed"))?;
        fs::write(target.join("files.rs"), list(&compressed))
    });
    if let Err(error) = listed {
        println!("cargo::error={}: {error}", out.display());
    }
}

/// All files of a folder and of those in it, by their path in the page.
fn collect(folder: &Path, prefix: &str, files: &mut Vec<(String, PathBuf)>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let path = format!("{prefix}{}", entry.file_name().display());
        if entry.file_type()?.is_dir() {
            collect(&entry.path(), &format!("{path}/"), files)?;
        } else {
            files.push((path, entry.path()));
        }
    }
    Ok(())
}

/// The files compressed into a folder, which is made anew.
fn compress(files: &[(String, PathBuf)], folder: &Path) -> io::Result<Vec<(String, PathBuf)>> {
    let _ = fs::remove_dir_all(folder);
    fs::create_dir_all(folder)?;
    let compressed = files.iter().enumerate().map(|(at, (path, file))| {
        let into = folder.join(format!("{at}.gz"));
        let mut gzip = GzEncoder::new(fs::File::create(&into)?, Compression::best());
        gzip.write_all(&fs::read(file)?)?;
        gzip.finish()?;
        Ok((path.clone(), into))
    });
    compressed.collect()
}

/// An expression of Rust with every file's path and bytes.
fn list(files: &[(String, PathBuf)]) -> String {
    let entries = files.iter().map(|(path, file)| format!("({path:?}, include_bytes!({file:?})),\n"));
    format!("&[\n{}]\n", entries.collect::<String>())
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
        .and_then(|()| fs::write(out.join("hub.html"), &page))
        .and_then(|()| fs::write(out.join("phone.html"), &page));
    if let Err(error) = written {
        println!("cargo::error={}: {error}", out.display());
    }
}
