//! `posed check STAGE.toml`: reports all that is wrong with a stage file, and how to fix it.

use std::path::{Path, PathBuf};

use posed_stage::{Problem, Report, Stage};

use super::{Error, print, print_json, simulation};

/// What to check.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed check config/flock-group.toml\n\n\
    Exit code 1 if there are problems; warnings alone do not count.")]
pub(crate) struct Args {
    /// The stage file.
    stage: PathBuf,
    /// Print one JSON object: ok, problems and warnings, each with line, key, message and fix.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let report = match std::fs::read(&args.stage) {
        Ok(bytes) => report(&bytes, &args.stage),
        Err(error) => return Err(Error::file("read", &args.stage, &error)),
    };
    if args.json {
        print_json(&report)?;
    } else {
        print(&sentences(&args.stage, &report))?;
    }
    if report.ok { Ok(()) } else { Err(Error::Reported) }
}

/// Checks the text of a stage file, whose relative paths begin at `folder`.
pub(crate) fn of_text(text: &str, folder: &Path) -> Report {
    let mut report = posed_stage::check_in(text, folder);
    if report.ok
        && let Ok(stage) = Stage::parse(text)
    {
        report.problems.extend(simulation::problems(text, &stage, folder));
        report.ok = report.problems.is_empty();
    }
    report
}

/// Checks the bytes of the stage file at `path`.
fn report(bytes: &[u8], path: &Path) -> Report {
    match std::str::from_utf8(bytes) {
        Ok(text) => {
            let mut report = of_text(text, path.parent().unwrap_or(Path::new("")));
            report.warnings.extend(posed_stage::readable_by_others(path, text));
            report
        }
        Err(error) => {
            let line = 1 + bytes[..error.valid_up_to()].iter().filter(|byte| **byte == b'\n').count();
            let problem = Problem {
                line,
                key: String::new(),
                message: "this is no UTF-8 text".to_owned(),
                fix: "save the file as UTF-8".to_owned(),
            };
            Report { ok: false, problems: vec![problem], warnings: Vec::new() }
        }
    }
}

/// For people: one line per problem in the form that editors can jump to.
fn sentences(path: &Path, report: &Report) -> String {
    let file = path.display();
    let mut text = String::new();
    let lines =
        report.problems.iter().map(|p| ("", p)).chain(report.warnings.iter().map(|w| ("warning: ", w)));
    for (label, Problem { line, key, message, fix }) in lines {
        let key = if key.is_empty() { String::new() } else { format!("{key}: ") };
        text.push_str(&format!("{file}:{line}: {label}{key}{message}\n    fix: {fix}\n"));
    }
    let count = report.problems.len();
    let verdict = match count {
        0 => "right".to_owned(),
        1 => "1 problem".to_owned(),
        _ => format!("{count} problems"),
    };
    text.push_str(&format!("{file}: {verdict}\n"));
    text
}
