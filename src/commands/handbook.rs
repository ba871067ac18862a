//! The reference of all commands, written from their own help, and the commands that the documents name.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser;

use super::Cli;

/// `docs/reference/commands.md`.
fn commands() -> String {
    let mut text = String::from(
        "# Commands\n\nWhat `posed COMMAND --help` says, written from the program; a test holds it. Exit codes: 0 done, 1 failed, 2 wrong use.\n",
    );
    let mut root = super::command();
    root.build();
    fn walk(command: &mut clap::Command, name: &str, text: &mut String) {
        // Some do their work by themselves, and have commands beside.
        if !command.is_subcommand_required_set() {
            // `--log` is everybody's, and said once.
            let command = command.clone().mut_arg("log", |log| log.hide(true)).term_width(100);
            let help = command.bin_name(name.to_owned()).render_long_help().to_string();
            let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
            writeln!(text, "\n## {name}\n\n```text\n{}\n```", lines.join("\n").trim_end()).unwrap();
        }
        for below in command.get_subcommands_mut().filter(|below| below.get_name() != "help") {
            let name = format!("{name} {}", below.get_name());
            walk(below, &name, text);
        }
    }
    walk(&mut root, "posed", &mut text);
    text
}

#[test]
fn the_reference_is_what_the_commands_say() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/commands.md");
    let written = commands();
    if std::env::var_os("POSED_BLESS").is_some() {
        fs::write(&path, &written).unwrap();
    }
    let committed = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == written,
        "docs/reference/commands.md is old: POSED_BLESS=1 cargo test --bin posed handbook"
    );
}

/// README and all pages.
fn documents() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut paths =
        vec![root.join("README.md"), root.join("config/README.md"), root.join("examples/trainer/README.md")];
    for folder in ["docs", "docs/tutorials"] {
        let entries = fs::read_dir(root.join(folder)).unwrap().map(|entry| entry.unwrap().path());
        paths.extend(entries.filter(|path| path.extension().is_some_and(|extension| extension == "md")));
    }
    paths
}

/// Words of a line as a shell takes them, up to a redirection or a comment.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), String::new(), None);
    for c in line.chars() {
        match quote {
            Some(end) if c == end => quote = None,
            None if c == '\'' || c == '"' => quote = Some(c),
            None if c == '#' && word.is_empty() => break,
            None if c == '>' || c == '|' || c == '&' => break,
            None if c.is_whitespace() => {
                if !word.is_empty() {
                    words.push(std::mem::take(&mut word));
                }
            }
            _ => word.push(c),
        }
    }
    if !word.is_empty() {
        words.push(word);
    }
    words
}

#[test]
fn every_command_that_a_document_names_is_one() {
    let mut named = 0;
    for path in documents() {
        let text = fs::read_to_string(&path).unwrap();
        let blocks = text.split("```").enumerate().filter(|(at, _)| at % 2 == 1).map(|(_, block)| block);
        for line in blocks.flat_map(str::lines).flat_map(|line| line.split("&& ")) {
            let line = line.trim().trim_start_matches("$ ");
            if !line.starts_with("posed ") || line.contains("...") {
                continue;
            }
            let words = words(line);
            if words.len() < 2 || !words[1].starts_with(|c: char| c.is_ascii_lowercase()) {
                continue;
            }
            named += 1;
            if let Err(error) = Cli::try_parse_from(&words) {
                panic!("{}: {line}\n{error}", path.display());
            }
        }
    }
    assert!(named > 60, "{named} commands");
}
