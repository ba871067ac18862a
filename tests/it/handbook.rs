//! The documentation holds: every page is in the table of contents, every link leads somewhere, questions are answered within two clicks, and the
//! commands of the tutorials do what they say, in their order.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs")
}

/// All pages, by path within `docs/`; what a page includes is part of it.
fn pages() -> BTreeMap<PathBuf, String> {
    let mut pages = BTreeMap::new();
    for folder in ["", "methods", "tutorials", "reference"] {
        for entry in fs::read_dir(docs().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "md") {
                let mut text = fs::read_to_string(&path).unwrap();
                while let Some((before, rest)) = text.split_once("{{#include ") {
                    let (file, after) = rest.split_once("}}").unwrap();
                    let included = fs::read_to_string(path.with_file_name(file)).unwrap();
                    text = format!("{before}{included}{after}");
                }
                pages.insert(path.strip_prefix(docs()).unwrap().to_owned(), text);
            }
        }
    }
    pages
}

/// Where the links of a text lead, within the repository.
fn links(text: &str) -> impl Iterator<Item = &str> {
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')').map(|(target, _)| target));
    targets.filter(|target| !target.contains("://") && !target.contains([' ', '`', '{']))
}

/// `a/../b` without the detour; `None` where it leads out of the folder that it is relative to.
fn plain(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for part in path.components() {
        if part.as_os_str() != ".." {
            plain.push(part);
        } else if !plain.pop() {
            return None;
        }
    }
    Some(plain)
}

/// What a heading is linked as.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase().replace(' ', "-");
    kept.chars().filter(|c| c.is_alphanumeric() || *c == '-' || *c == '_').collect()
}

#[test]
fn every_page_is_in_the_table_of_contents_and_every_link_leads_somewhere() {
    let pages = pages();
    let contents: BTreeSet<PathBuf> =
        links(&pages[Path::new("SUMMARY.md")]).map(|target| PathBuf::from(target.to_owned())).collect();
    let listed = pages.keys().filter(|page| *page != Path::new("SUMMARY.md"));
    assert_eq!(contents, listed.cloned().collect());
    for (page, text) in &pages {
        for link in links(text) {
            let (file, wanted) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() {
                page.clone()
            } else {
                plain(&Path::new("docs").join(page.with_file_name(file)))
                    .expect("links stay in the repository")
            };
            let target = if file.is_empty() { Path::new("docs").join(target) } else { target };
            let from_root = Path::new(env!("CARGO_MANIFEST_DIR")).join(&target);
            assert!(from_root.exists(), "{}: {link} leads nowhere", page.display());
            if !wanted.is_empty() {
                let headings = fs::read_to_string(&from_root).unwrap();
                let found = headings.lines().filter(|line| line.starts_with('#'));
                let found =
                    found.map(|line| anchor(line.trim_start_matches('#'))).any(|anchor| anchor == wanted);
                assert!(found, "{}: {link} has no such heading", page.display());
            }
        }
    }
}

/// What people who know none of this ask, and words that only its answer has.
const QUESTIONS: [(&str, &str); 10] = [
    ("How do I see it without hardware?", "posed demo"),
    ("What do I write for my Xsens chain?", "### `driver = \"xbus\"`"),
    ("It says that the port is in use. What now?", "end the other program"),
    ("How does it start with the computer?", "systemctl"),
    ("How do I get the poses into my program?", "new WebSocket("),
    ("What does `suspect` mean?", "never use it as good"),
    ("Positions are wrong near metal.", "posed field solve"),
    ("How does it learn how sensors sit on the body?", "body.calibrate"),
    ("How do I teach an exercise?", "exercise.teach {name, repetitions}"),
    ("How do I compare two runs of my program on the same data?", "--expect golden.jsonl"),
];

#[test]
fn ten_questions_are_answered_within_two_clicks_of_the_first_page() {
    let pages = pages();
    let mut near: BTreeSet<PathBuf> = BTreeSet::from([PathBuf::from("index.md")]);
    for _click in 0..2 {
        let found = near.iter().flat_map(|page| {
            links(&pages[page])
                .filter_map(move |link| plain(&page.with_file_name(link.split('#').next().unwrap())))
        });
        let found: Vec<PathBuf> = found.filter(|target| pages.contains_key(target)).collect();
        near.extend(found);
    }
    for (question, answer) in QUESTIONS {
        let answered = near.iter().any(|page| pages[page].contains(answer));
        assert!(answered, "{question} {answer:?} is not on a page that is two clicks away");
    }
}

/// The shell of a reader: runs blocks of commands, and keeps a daemon until he types Ctrl-C.
struct Reader {
    folder: tempfile::TempDir,
    /// The process, its address, and whether its devices are simulated.
    daemon: Option<(Child, String, bool)>,
}

/// Whether the daemon has taken six hundred records of each device: of ten sensors some are good by then, after those with which their filters begin.
fn streams(address: &str) -> bool {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET /metrics HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let records = answer.lines().filter(|line| line.starts_with("posed_device_records{"));
    let counts: Vec<u64> = records.map(|line| line.rsplit(' ').next().unwrap().parse().unwrap()).collect();
    !counts.is_empty() && counts.iter().all(|count| *count >= 600)
}

impl Reader {
    /// Runs the lines of a block; daemons are started, and run on.
    fn block(&mut self, page: &str, block: &str) {
        let mut script = String::new();
        for line in block.lines() {
            let word = line.split_whitespace().nth(1).unwrap_or_default();
            let serves = line.starts_with("posed ")
                && (["demo", "run"].contains(&word)
                    || word == "replay" && !line.contains(" -o ") && !line.contains("--expect"));
            if serves {
                self.shell(page, &std::mem::take(&mut script));
                self.serve(page, line);
            } else {
                script += line;
                script.push('\n');
            }
        }
        self.shell(page, &script);
    }

    fn command(&self, script: &str) -> Command {
        let posed = Path::new(env!("CARGO_BIN_EXE_posed")).parent().unwrap();
        let path = format!("{}:{}", posed.display(), std::env::var("PATH").unwrap());
        let mut command = Command::new("bash");
        command.args(["-euo", "pipefail", "-c", script]).env("PATH", path).current_dir(self.folder.path());
        command
    }

    fn shell(&self, page: &str, script: &str) {
        let address = self.daemon.as_ref().map_or("127.0.0.1:8787", |daemon| &daemon.1);
        let done = self.command(&script.replace("127.0.0.1:8787/", &format!("{address}/"))).output().unwrap();
        let emitted = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(done.status.success(), "{page}: {script}\n{emitted}");
    }

    fn serve(&mut self, page: &str, line: &str) {
        let mut command = self.command(&format!("exec {line} --listen 127.0.0.1:0"));
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut emitted = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut emitted).unwrap();
        let address = emitted.split("http://").nth(1).and_then(|rest| rest.split('/').next());
        let address = address.unwrap_or_else(|| panic!("{page}: {line} said {emitted:?}")).to_owned();
        self.daemon = Some((child, address, line.starts_with("posed demo")));
    }

    /// Ctrl-C, once every device of a simulated stage has sent some records.
    #[expect(clippy::disallowed_methods, reason = "a recording wants some stream")]
    fn interrupt(&mut self, page: &str) {
        let Some((mut child, address, simulated)) = self.daemon.take() else { return };
        let begun = Instant::now();
        while simulated && !streams(&address) {
            assert!(begun.elapsed() < Duration::from_secs(120), "{page}: not every device streams");
            std::thread::sleep(Duration::from_millis(50));
        }
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            assert!(begun.elapsed() < Duration::from_secs(60), "{page}: the daemon does not end");
            std::thread::sleep(Duration::from_millis(50));
        }
        assert_eq!(child.wait().unwrap().code(), Some(0), "{page}");
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        if let Some((child, ..)) = &mut self.daemon {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Runs all that a tutorial tells its reader to type. Daemons are ended before the next block, unless that one is typed `meanwhile`.
fn follow(page: &str) -> Reader {
    let text = fs::read_to_string(docs().join("tutorials").join(page)).unwrap();
    let mut reader = Reader { folder: tempfile::tempdir().unwrap(), daemon: None };
    let mut blocks = 0;
    let mut before = "";
    for (at, part) in text.split("```").enumerate() {
        if at % 2 == 0 {
            before = part;
        } else if let Some(block) = part.strip_prefix("sh\n") {
            if !before.trim_end().ends_with("<!-- meanwhile -->") {
                reader.interrupt(page);
            }
            reader.block(page, block);
            blocks += 1;
        }
    }
    reader.interrupt(page);
    assert!(blocks >= 4, "{page}: {blocks} blocks of commands");
    reader
}

/// Lines of a file that a tutorial has made.
fn made(reader: &Reader, name: &str) -> Vec<String> {
    let text = fs::read_to_string(reader.folder.path().join(name)).unwrap();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn the_operators_tutorial_does_what_it_says() {
    follow("operator.md");
}

#[test]
fn the_front_end_tutorial_does_what_it_says() {
    follow("front-end.md");
}

#[test]
fn the_tutorial_of_recorded_streams_does_what_it_says() {
    let reader = follow("recorded-streams.md");
    // What was streamed is in the files: poses that are good, and every message of the replay.
    let good = made(&reader, "poses.csv").iter().filter(|line| line.ends_with(",ok")).count();
    let golden = made(&reader, "golden.jsonl").len();
    println!("{good} good poses, {golden} messages, {} key poses", made(&reader, "keys.csv").len() - 1);
    assert!(good > 100 && golden > 100, "{good} good poses, {golden} messages");
}

/// The fixed ones; those of the stage file are in its reference.
#[test]
fn the_budgets_are_those_of_the_code() {
    let page = fs::read_to_string(docs().join("fault-tolerance.md")).unwrap();
    let rows = page.lines().filter(|line| line.starts_with("| ") && line.contains(".rs` `"));
    let mut count = 0;
    for row in rows {
        let marked: Vec<&str> = row.split('`').skip(1).step_by(2).collect();
        let [file, name, value, ..] = marked[..] else { panic!("{row}") };
        let code = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
        let line = code.lines().find(|line| line.contains(&format!("const {name}: ")));
        let line = line.unwrap_or_else(|| panic!("{file} has no {name}"));
        assert!(line.ends_with(&format!(" = {value};")), "{name} is {line}");
        count += 1;
    }
    assert!(count > 20, "{count}");
}

/// What a queue is made with, in a line of code; empty: without a bound.
fn capacity(line: &str) -> Option<&str> {
    if line.trim_start().starts_with("//") {
        return None;
    }
    let made = |maker| {
        let (before, made) = line.split_once(maker)?;
        let whole = !before.ends_with(|last: char| last.is_alphanumeric() || last == '_');
        let arguments = match made.strip_prefix("::<") {
            Some(typed) => typed.rsplit_once(">(")?.1,
            None => made.strip_prefix('(')?,
        };
        let capacity = arguments.split_once(')')?.0;
        let simple = capacity.chars().all(|c| c.is_alphanumeric() || "_:. *".contains(c));
        (whole && simple).then_some(capacity)
    };
    let unbounded = line.contains("unbounded_channel(").then_some("");
    unbounded
        .or_else(|| made("mpsc::channel"))
        .or_else(|| made("sync_channel"))
        .or_else(|| made("bounded").filter(|capacity| !capacity.is_empty()))
}

#[test]
fn every_queue_has_its_bound_in_the_table() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = fs::read_to_string(docs().join("fault-tolerance.md")).unwrap();
    let mut folders = vec![root.join("src"), root.join("drivers/src"), root.join("crates")];
    let (mut named, mut other) = (0, Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            if path.extension().is_none_or(|extension| extension != "rs") {
                continue;
            }
            let code = fs::read_to_string(&path).unwrap();
            let code = code.split("#[cfg(test)]").next().unwrap();
            let file = path.strip_prefix(root).unwrap().display().to_string();
            for capacity in code.lines().filter_map(capacity) {
                // A constant of this file, or one that another names for it; or a single answer.
                let is_here = page.contains(&format!("{file}` `{capacity}`"));
                let is_elsewhere = !code.contains(&format!("const {capacity}:"))
                    && page.contains(&format!(".rs` `{capacity}`"));
                match capacity.parse::<usize>() {
                    Ok(0..=2) => {}
                    _ if is_here || is_elsewhere => named += 1,
                    _ => other.push((file.clone(), capacity.to_owned())),
                }
            }
        }
    }
    assert!(named > 10, "{named}");
    other.sort();
    // The recorder's own tests make it smaller. The truth of a simulation waits without a bound: a file with holes would be none.
    let known = [("crates/daemon/src/recorder.rs", "room.items"), ("src/commands/simulate.rs", "")];
    assert_eq!(other, known.map(|(file, capacity)| (file.to_owned(), capacity.to_owned())));
}

/// Whether a file below this folder has a test, by the file's module and its name.
fn has_test(folder: &Path, test: &str) -> bool {
    let Some((module, name)) = test.rsplit_once("::") else { panic!("{test}: name its module") };
    let module = module.replace("::", "/");
    let (files, test) = ([format!("{module}.rs"), format!("{module}/mod.rs")], format!("fn {name}()"));
    fs::read_dir(folder).unwrap().any(|entry| {
        let path = entry.unwrap().path();
        if path.is_dir() {
            return has_test(&path, &format!("{module}::{name}"));
        }
        files.iter().any(|file| path.ends_with(file)) && fs::read_to_string(path).unwrap().contains(&test)
    })
}

/// Those of the stage file too.
#[test]
fn every_budget_has_a_test_that_goes_beyond_it() {
    let page = fs::read_to_string(docs().join("fault-tolerance.md")).unwrap();
    let section = page.split("\n## ").find(|section| section.starts_with("Budgets")).unwrap();
    let limits = serde_json::to_value(posed_stage::Limits::default()).unwrap();
    let mut keys: BTreeSet<&str> = limits.as_object().unwrap().keys().map(String::as_str).collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for row in section.lines().filter(|line| line.starts_with("| ") && line.contains('`')) {
        let cells: Vec<&str> = row.trim_matches(['|', ' ']).split(" | ").collect();
        keys.remove(cells[0].trim_matches('`'));
        // Those behind a crate are its own; those before are here.
        let (mut folder, mut count) = (root.join("tests/it"), 0);
        for name in cells[cells.len() - 1].split('`').skip(1).step_by(2) {
            match name.strip_prefix("posed-") {
                Some("drivers") => folder = root.join("drivers"),
                Some(name) => folder = root.join("crates").join(name),
                None => {
                    assert!(has_test(&folder, name), "{} has no {name}", folder.display());
                    count += 1;
                }
            }
        }
        assert!(count > 0, "no test: {row}");
    }
    assert!(keys.is_empty(), "no row, and no test: {keys:?}");
}
