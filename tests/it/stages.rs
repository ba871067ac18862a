//! Stage files: the broken ones of `tests/broken-stages` and the ones of `config/`.

use std::path::Path;

use posed_stage::Problem;

/// One `# expect: line N, key K, fix mentions WORDS` of a broken file.
struct Expected<'a> {
    line: usize,
    key: &'a str,
    fix: &'a str,
}

fn expectations(text: &str) -> Vec<Expected<'_>> {
    text.lines()
        .map_while(|line| line.strip_prefix("# expect: "))
        .map(|line| {
            let mut parts = line.splitn(3, ", ");
            let mut part = |prefix: &str| parts.next().and_then(|part| part.strip_prefix(prefix)).unwrap();
            Expected { line: part("line ").parse().unwrap(), key: part("key "), fix: part("fix mentions ") }
        })
        .collect()
}

/// Each broken file gets exactly the problems that its first lines expect, in their order.
#[test]
fn every_broken_stage_is_answered_with_line_key_and_mend() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/broken-stages");
    let mut wrong = Vec::new();
    let mut count = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let expected = expectations(&text);
        assert!(!expected.is_empty(), "{} expects nothing", path.display());
        let report = posed_stage::check_in(&text, &folder);
        let fits = |(problem, expected): (&Problem, &Expected<'_>)| {
            problem.line == expected.line
                && problem.key == expected.key
                && problem.fix.contains(expected.fix)
                && !problem.message.is_empty()
        };
        let all = report.problems.iter().zip(&expected).all(fits);
        if report.ok || report.problems.len() != expected.len() || !all {
            wrong.push(format!("{}: {:#?}", path.display(), report.problems));
        }
        count += 1;
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count >= 20, "only {count} broken stages");
}
