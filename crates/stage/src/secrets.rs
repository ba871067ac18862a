//! What a stage file holds that is nobody else's business: tokens, and the password of zenoh.
//!
//! What comes in: the text of a stage file, and files with one secret each. What goes out: the secrets, for who lets people in;
//! and the text without them, for recordings and other machines. What it never does: show a secret, in a message, in debug
//! output or in what is written from a [`Stage`].

use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use toml::de::{DeTable, DeValue};
use toml_parser::Source;
use toml_parser::lexer::TokenKind;

use super::Stage;
use super::problem::Problem;

/// Stands where a secret was. It is long enough for one, so that the text stays a stage file; nobody is let in by it.
pub(super) const PLACEHOLDER: &str = "left-out-of-this-copy";

/// Keys whose values are secrets, wherever they stand in the file.
const KEYS: [&str; 2] = ["secret", "password"];

/// Lengths that a secret may have, characters; the schema states the same.
const LENGTHS: std::ops::RangeInclusive<usize> = 16..=512;

/// Where a service manager puts the files of secrets that only the service may read.
const CREDENTIALS: &str = "CREDENTIALS_DIRECTORY";

/// A token or password. It is only ever given away by [`Secret::reveal`]: `Debug` hides it, and serialised it is a placeholder.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(transparent)]
pub struct Secret(String);

impl Secret {
    /// The secret itself; not for messages, recordings or logs.
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// Whether it is what stands in a recording in a secret's place: everybody knows it.
    pub fn is_placeholder(&self) -> bool {
        self.0 == PLACEHOLDER
    }
}

impl From<String> for Secret {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

impl Serialize for Secret {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(PLACEHOLDER)
    }
}

/// The text of a stage file with a placeholder for every secret; it makes the same stage but for them. Comments that speak of
/// secrets are left out too: a key that was commented out may still open a door somewhere. A text without secrets stays as it
/// is, to the byte; one that is no TOML may hold anything, and nothing of it is left.
pub fn without_secrets(text: &str) -> String {
    let Ok(document) = DeTable::parse(text) else { return String::new() };
    let mut found = Found::default();
    found.table(document.get_ref());
    let placeholder = format!("\"{PLACEHOLDER}\"");
    let mut replaced: Vec<(Range<usize>, &str)> =
        found.places.iter().map(|place| (place.clone(), &placeholder[..])).collect();
    let comments = Source::new(text).lex().filter(|token| token.kind() == TokenKind::Comment);
    for comment in comments.map(|token| token.span().start()..token.span().end()) {
        if found.speaks_of_secrets(&text[comment.clone()]) {
            replaced.push((comment, "# left out of this copy"));
        }
    }
    replaced.sort_by_key(|(place, _)| place.start);
    let mut copy = String::with_capacity(text.len());
    let mut end = 0;
    for (place, instead) in replaced {
        copy.push_str(&text[end..place.start]);
        copy.push_str(instead);
        end = place.end;
    }
    copy.push_str(&text[end..]);
    copy
}

/// What is wrong where a file holds secrets and everybody on this computer may read it; `text` is its contents.
pub fn readable_by_others(path: &Path, text: &str) -> Option<Problem> {
    let first = first_secret(text)?;
    is_readable_by_others(path).then(|| Problem {
        line: 1 + text[..first].matches('\n').count(),
        key: String::new(),
        message: "everybody on this computer may read this file, and it holds secrets".to_owned(),
        fix: format!(
            "chmod o= {}, or move the secrets into files of their own (`secret_file`)",
            path.display()
        ),
    })
}

/// Whether the file's mode lets everybody read it; false where nobody can say.
pub(super) fn is_readable_by_others(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::metadata(path).is_ok_and(|file| file.permissions().mode() & 0o004 != 0)
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

/// The file that a key names: a relative path is looked for in the folder of credentials first, then in that of the stage file.
pub(super) fn secret_path(folder: &Path, path: &Path) -> PathBuf {
    let credentials = std::env::var_os(CREDENTIALS).map(PathBuf::from);
    credentials
        .map(|credentials| credentials.join(path))
        .filter(|path| path.is_file())
        .unwrap_or_else(|| folder.join(path))
}

/// Reads the one secret that a file holds; a line's end behind it does not count.
///
/// # Errors
/// One sentence that names the file and does not hold what is in it.
pub(super) fn read_secret(path: &Path) -> Result<Secret, String> {
    let text =
        std::fs::read_to_string(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    let text = text.trim_end_matches(['\r', '\n']);
    if !LENGTHS.contains(&text.chars().count()) {
        return Err(format!(
            "{} must hold one secret of {} to {} characters",
            path.display(),
            LENGTHS.start(),
            LENGTHS.end()
        ));
    }
    Ok(Secret(text.to_owned()))
}

impl Stage {
    /// Puts the contents of the files that `secret_file` and `password_file` name beside them.
    pub(super) fn read_secrets(&mut self, folder: &Path) -> Result<(), String> {
        let tokens = self.server.tokens.iter_mut().map(|token| (&token.secret_file, &mut token.secret));
        let password = self.zenoh.iter_mut().map(|zenoh| (&zenoh.password_file, &mut zenoh.password));
        for (file, secret) in tokens.chain(password) {
            if let Some(file) = file {
                *secret = Some(read_secret(&secret_path(folder, file))?);
            }
        }
        Ok(())
    }
}

/// Where the first secret is, in bytes.
fn first_secret(text: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let mut found = Found::default();
    found.table(document.get_ref());
    found.places.iter().map(|place| place.start).min()
}

/// The secrets of a document.
#[derive(Default)]
struct Found<'i> {
    places: Vec<Range<usize>>,
    values: Vec<&'i str>,
}

impl<'i> Found<'i> {
    fn table(&mut self, table: &'i DeTable<'_>) {
        for (key, value) in table {
            match value.get_ref() {
                DeValue::String(text) if KEYS.contains(&&**key.get_ref()) => {
                    self.places.push(value.span());
                    self.values.push(text);
                }
                value => self.value(value),
            }
        }
    }

    fn value(&mut self, value: &'i DeValue<'_>) {
        match value {
            DeValue::Table(table) => self.table(table),
            DeValue::Array(items) => items.iter().for_each(|item| self.value(item.get_ref())),
            _ => {}
        }
    }

    /// Whether a comment may give one away.
    fn speaks_of_secrets(&self, comment: &str) -> bool {
        let assigns = comment.contains('=') && KEYS.iter().any(|key| comment.contains(key));
        assigns || self.values.iter().any(|value| !value.is_empty() && comment.contains(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
        name = "hall"                 # not a secret = of any kind
        [server]
        listen = "0.0.0.0:8787"
        [[server.token]]
        secret = "the-first-of-them-all"   # in use
        role = "operate"
        [[server.token]]
        "secret" = '''the-second-of-them-all'''  # before: the-first-of-them-all
        role = "watch"
        # [[server.token]]
        # secret = "one-of-last-year-still"
        [zenoh]
        connect = ["tcp/hub:7447"]
        user = "hall"
        password = "the-pass\u0077ord-of-zenoh"
    "#;

    #[test]
    fn a_copy_holds_no_secret_and_makes_the_same_stage() {
        let copy = without_secrets(TEXT);
        for secret in ["the-first", "the-second", "last-year", "the-pass"] {
            assert!(!copy.contains(secret), "{secret} in {copy}");
        }
        assert!(copy.contains("# in use") && copy.lines().count() == TEXT.lines().count(), "{copy}");
        let (stage, of_copy) = (Stage::parse(TEXT).unwrap(), Stage::parse(&copy).unwrap());
        assert!(of_copy.server.tokens.iter().all(|token| token.secret.as_ref().unwrap().is_placeholder()));
        assert_eq!(stage.shareable_toml(), of_copy.shareable_toml());
        assert_eq!(without_secrets(&copy), copy, "once is enough");
        let plain = "name = \"hall\" # of the north\n";
        assert_eq!(without_secrets(plain), plain);
        assert_eq!(without_secrets("secret = \"cut off"), "");
    }

    #[test]
    fn inline_tables_hide_nothing() {
        let text = "name = \"x\"\nserver = { token = [{ secret = \"inline-and-very-secret\", role = \"watch\" }] }\n";
        Stage::parse(text).unwrap();
        let copy = without_secrets(text);
        assert!(!copy.contains("inline-and"), "{copy}");
        Stage::parse(&copy).unwrap();
    }

    #[test]
    fn a_secret_is_neither_printed_nor_written() {
        let stage = Stage::parse(TEXT).unwrap();
        let shown = format!("{stage:?}\n{}", toml::to_string(&stage).unwrap());
        for secret in ["the-first", "the-second", "the-password"] {
            assert!(!shown.contains(secret), "{shown}");
        }
        let twice = TEXT.replace("the-second", "the-first");
        let problems = Stage::parse(&twice).unwrap_err().to_string();
        assert!(
            problems.contains("another token in line 6") && !problems.contains("the-first"),
            "{problems}"
        );
    }

    #[test]
    fn secrets_come_from_files_and_a_bad_one_is_named_without_its_contents() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let load = |token: &str, zenoh: &str| {
            let text = format!(
                "name = \"x\"\n[server]\nlisten = \"0.0.0.0:0\"\n[[server.token]]\nrole = \"watch\"\n{token}\n[zenoh]\n\
                 connect = [\"tcp/hub:7447\"]\nuser = \"x\"\n{zenoh}\n"
            );
            put("stage.toml", &text);
            Stage::load(&folder.path().join("stage.toml")).map_err(|error| error.to_string())
        };
        put("token", "a-token-from-a-file\n");
        put("password", "a-password-of-a-file");
        put("short", "0123");
        put("spaced", "a token of several words");
        let stage = load("secret_file = \"token\"", "password_file = \"password\"").unwrap();
        let secret = |secret: &Option<Secret>| secret.as_ref().unwrap().reveal().to_owned();
        assert_eq!(secret(&stage.server.tokens[0].secret), "a-token-from-a-file");
        assert_eq!(secret(&stage.zenoh.unwrap().password), "a-password-of-a-file");
        for (token, zenoh, word) in [
            ("secret_file = \"gone\"", "password_file = \"password\"", "gone"),
            ("secret_file = \"short\"", "password_file = \"password\"", "16 to 512 characters"),
            ("secret_file = \"spaced\"", "password_file = \"password\"", "HTTP header"),
            ("", "password_file = \"password\"", "secret"),
            (
                "secret = \"sixteen-or-more-of-it\"\nsecret_file = \"token\"",
                "password_file = \"password\"",
                "both",
            ),
            (
                "secret_file = \"token\"",
                "password = \"sixteen-or-more-of-it\"\npassword_file = \"password\"",
                "both",
            ),
            ("secret_file = \"token\"", "", "password"),
            ("secret = \"left-out-of-this-copy\"", "password_file = \"password\"", "copy"),
        ] {
            let refused = load(token, zenoh).unwrap_err();
            assert!(refused.contains(word), "{word}: {refused}");
            assert!(!refused.contains("0123") && !refused.contains("several words"), "{refused}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_file_with_secrets_that_everybody_may_read_is_reported() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stage.toml");
        std::fs::write(&path, TEXT).unwrap();
        let problem = |mode: u32, text: &str| {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            readable_by_others(&path, text).map(|problem| problem.line)
        };
        assert_eq!(problem(0o644, TEXT), Some(6));
        assert_eq!(problem(0o640, TEXT), None);
        assert_eq!(problem(0o644, "name = \"x\"\n"), None);
    }
}
