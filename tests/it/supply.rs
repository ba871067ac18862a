//! What posed is made of: every crate under a licence that `deny.toml` allows, from where it allows, once; a notice for all
//! of them in the package; and every crate of the workspace ready to be published.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use serde::Deserialize;
use serde::de::IgnoredAny;
use spdx::{Expression, Licensee, ParseMode};

/// `deny.toml`, as far as it is used. cargo-deny knows more keys; one that is not held here is refused.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Rules {
    #[serde(rename = "graph")]
    _graph: IgnoredAny,
    licenses: Licenses,
    bans: Bans,
    sources: Sources,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Licenses {
    allow: Vec<String>,
    exceptions: Vec<Exception>,
    #[serde(rename = "unused-allowed-license")]
    _unused_allowed_license: Deny,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Exception {
    #[serde(rename = "crate")]
    name: String,
    allow: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Bans {
    #[serde(rename = "wildcards")]
    _wildcards: Deny,
    /// What is next to it may be taken at any version by what is never published, and for its tests by anyone.
    #[serde(default)]
    allow_wildcard_paths: bool,
    #[serde(rename = "multiple-versions")]
    _multiple_versions: Deny,
    deny: Vec<Named>,
    skip: Vec<Named>,
    skip_tree: Vec<Named>,
}

/// A crate by its name, or one version of it by `name@version`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Named {
    #[serde(rename = "crate")]
    spec: String,
    reason: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Sources {
    #[serde(rename = "unknown-registry")]
    _unknown_registry: Deny,
    #[serde(rename = "unknown-git")]
    _unknown_git: Deny,
    allow_git: [String; 0],
}

/// The only level that is held here.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Deny {
    Deny,
}

/// What `cargo metadata` prints, as far as it is used.
#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    workspace_members: Vec<String>,
    resolve: Resolve,
}

#[derive(Deserialize)]
struct Package {
    id: String,
    name: String,
    version: String,
    manifest_path: PathBuf,
    source: Option<String>,
    license: Option<String>,
    description: Option<String>,
    readme: Option<String>,
    #[serde(default)]
    keywords: Vec<String>,
    #[serde(default)]
    categories: Vec<String>,
    /// Registries that may have it; absent: any.
    publish: Option<Vec<String>>,
    #[serde(default)]
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    req: String,
    /// `dev` or `build`; absent for those of the crate itself.
    #[serde(default)]
    kind: Option<String>,
    /// Where it is, if that is next to it.
    #[serde(default)]
    path: Option<PathBuf>,
}

#[derive(Deserialize)]
struct Resolve {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
    deps: Vec<Edge>,
}

#[derive(Deserialize)]
struct Edge {
    pkg: String,
}

impl Named {
    fn names(&self, package: &Package) -> bool {
        match self.spec.split_once('@') {
            Some((name, version)) => package.name == name && package.version == version,
            None => package.name == self.spec,
        }
    }
}

impl Package {
    fn called(&self) -> String {
        format!("{} {}", self.name, self.version)
    }
}

impl Metadata {
    /// The workspace's, for this machine: what other systems would need has not been fetched.
    fn read() -> Self {
        let compiler = Command::new("rustc").arg("-vV").output().unwrap();
        let emitted = String::from_utf8(compiler.stdout).unwrap();
        let host = emitted.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
        let text = cargo(&["metadata", "--format-version", "1", "--all-features", "--filter-platform", host]);
        serde_json::from_str(&text).unwrap()
    }

    fn members(&self) -> impl Iterator<Item = &Package> {
        self.packages.iter().filter(|package| self.workspace_members.contains(&package.id))
    }

    /// `roots` and all below them.
    fn below<'a>(&'a self, roots: impl Iterator<Item = &'a Package>) -> BTreeSet<&'a str> {
        let nodes: BTreeMap<&str, &Node> = self.resolve.nodes.iter().map(|node| (&*node.id, node)).collect();
        let mut open: Vec<&str> = roots.map(|package| &*package.id).collect();
        let mut reached = BTreeSet::new();
        while let Some(id) = open.pop() {
            if reached.insert(id) {
                open.extend(nodes[id].deps.iter().map(|edge| &*edge.pkg));
            }
        }
        reached
    }
}

/// Names and versions of what one crate or all are built of, with all features, by the kinds of edges to follow. The
/// metadata have more: crates that only tests take, and optional ones that nobody asked for.
fn tree(of: &str, edges: &str) -> BTreeSet<String> {
    let format = ["--prefix", "none", "--format", "{p}"];
    let text = cargo(&[&["tree", of, "--all-features", "--edges", edges], &format[..]].concat());
    let called = |line: &str| {
        let mut words = line.split(' ');
        Some(format!("{} {}", words.next()?, words.next()?.strip_prefix('v')?))
    };
    text.lines().filter_map(called).collect()
}

/// What cargo prints in the repository.
fn cargo(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .arg("--locked")
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "cargo {arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn rules() -> Rules {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("deny.toml");
    toml::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

/// Everything that is against the rules, in words. `part` has what others get: no crate that only tests take.
fn violations(rules: &Rules, metadata: &Metadata, part: &BTreeSet<String>) -> Vec<String> {
    let part: Vec<&Package> =
        metadata.packages.iter().filter(|package| part.contains(&package.called())).collect();
    [
        licences(&rules.licenses, &part),
        duplicates(&rules.bans, metadata, &part),
        bans(&rules.bans, metadata, &part),
        sources(&rules.sources, metadata),
    ]
    .concat()
}

fn licences(rules: &Licenses, part: &[&Package]) -> Vec<String> {
    let licensee = |text: &String| Licensee::parse(text).unwrap();
    let allowed: Vec<Licensee> = rules.allow.iter().map(licensee).collect();
    let mut used = BTreeSet::new();
    let mut found = Vec::new();
    for package in part {
        let Some(text) = &package.license else {
            found.push(format!("{} names no licence", package.called()));
            continue;
        };
        let expression = match Expression::parse_mode(text.trim(), ParseMode::LAX) {
            Ok(expression) => expression,
            Err(error) => {
                found.push(format!("{}: licence {text:?}: {}", package.called(), error.reason));
                continue;
            }
        };
        let excepted: Vec<Licensee> = rules
            .exceptions
            .iter()
            .filter(|exception| exception.name == package.name)
            .flat_map(|exception| exception.allow.iter().map(licensee))
            .collect();
        let accepted = expression.evaluate(|required| {
            let one = allowed.iter().position(|licensee| licensee.satisfies(required));
            used.extend(one);
            one.is_some() || excepted.iter().any(|licensee| licensee.satisfies(required))
        });
        if !accepted {
            found.push(format!("{}: licence {text:?} is not allowed", package.called()));
        }
    }
    let unused = (0..allowed.len()).filter(|index| !used.contains(index));
    found.extend(
        unused.map(|index| format!("no crate comes under {:?}: allow it no more", rules.allow[index])),
    );
    let gone = rules.exceptions.iter().filter(|one| !part.iter().any(|package| package.name == one.name));
    found.extend(gone.map(|one| format!("there is no crate {}: except it no more", one.name)));
    found
}

fn duplicates(rules: &Bans, metadata: &Metadata, part: &[&Package]) -> Vec<String> {
    let roots = part.iter().copied().filter(|package| rules.skip_tree.iter().any(|one| one.names(package)));
    let below = metadata.below(roots);
    let mut versions: BTreeMap<&str, Vec<&Package>> = BTreeMap::new();
    for package in part.iter().filter(|package| !below.contains(&*package.id)) {
        versions.entry(&package.name).or_default().push(package);
    }
    let mut found = Vec::new();
    for packages in versions.values() {
        let kept = packages.iter().filter(|package| !rules.skip.iter().any(|one| one.names(package)));
        let kept: Vec<String> = kept.map(|package| package.called()).collect();
        if kept.len() > 1 {
            found.push(format!("more than one version: {}", kept.join(", ")));
        }
    }
    for one in rules.skip.iter().chain(&rules.skip_tree) {
        if !part.iter().any(|package| one.names(package)) {
            found.push(format!("there is no crate {}: skip it no more", one.spec));
        }
    }
    found
}

fn bans(rules: &Bans, metadata: &Metadata, part: &[&Package]) -> Vec<String> {
    let mut found = Vec::new();
    for package in part {
        for one in rules.deny.iter().filter(|one| one.names(package)) {
            found.push(format!("{} is banned: {}", package.called(), one.reason));
        }
    }
    for member in metadata.members() {
        let is_private = member.publish.as_ref().is_some_and(Vec::is_empty);
        let may_be_any = |dependency: &Dependency| {
            let for_tests = dependency.kind.as_deref() == Some("dev");
            rules.allow_wildcard_paths && dependency.path.is_some() && (is_private || for_tests)
        };
        let any = |dependency: &&Dependency| dependency.req == "*" && !may_be_any(dependency);
        for dependency in member.dependencies.iter().filter(any) {
            found.push(format!("{} takes any version of {}", member.name, dependency.name));
        }
    }
    found
}

/// All of one registry, nothing from anywhere else: without configuration that is Cargo's own.
fn sources(rules: &Sources, metadata: &Metadata) -> Vec<String> {
    let [] = &rules.allow_git;
    let own = |package: &Package| metadata.workspace_members.contains(&package.id);
    let registry = metadata.packages.iter().find_map(|package| package.source.as_deref());
    let foreign = metadata.packages.iter().filter(|package| match package.source.as_deref() {
        Some(source) => {
            let of_a_registry = source.starts_with("registry+") || source.starts_with("sparse+");
            !of_a_registry || Some(source) != registry
        }
        None => !own(package),
    });
    foreign.map(|package| format!("{} comes from {:?}", package.called(), package.source)).collect()
}

/// The workspace's crates, each with those of the workspace that it uses.
pub(crate) fn uses() -> BTreeMap<String, BTreeSet<String>> {
    let metadata = Metadata::read();
    let own: BTreeSet<&str> = metadata.members().map(|package| &*package.name).collect();
    let used = |package: &Package| {
        let normal = package.dependencies.iter().filter(|dependency| dependency.kind.is_none());
        normal.map(|dependency| dependency.name.clone()).filter(|name| own.contains(&**name)).collect()
    };
    metadata.members().map(|package| (package.name.clone(), used(package))).collect()
}

#[test]
fn what_posed_is_made_of_keeps_to_the_rules() {
    let found = violations(&rules(), &Metadata::read(), &tree("--workspace", "normal,build"));
    assert!(found.is_empty(), "against deny.toml:\n{}", found.join("\n"));
}

/// A workspace of one crate, `own`, and what it takes, directly.
fn made_up(taken: &[(&str, &str, &str)], dependencies: serde_json::Value) -> Metadata {
    let registry = "registry+one";
    let id = |name: &str, version: &str| format!("{name}@{version}");
    let mut packages = vec![serde_json::json!({
        "id": "own@1.0.0", "name": "own", "version": "1.0.0", "license": "MIT", "manifest_path": "", "dependencies": dependencies,
    })];
    let mut nodes = Vec::new();
    let mut edges = Vec::new();
    for (name, version, licence) in taken {
        packages.push(serde_json::json!({
            "id": id(name, version), "name": name, "version": version, "license": licence, "manifest_path": "", "source": registry,
        }));
        nodes.push(serde_json::json!({ "id": id(name, version), "deps": [] }));
        edges.push(serde_json::json!({ "pkg": id(name, version) }));
    }
    nodes.push(serde_json::json!({ "id": "own@1.0.0", "deps": edges }));
    serde_json::from_value(serde_json::json!({
        "packages": packages, "workspace_members": ["own@1.0.0"], "resolve": { "nodes": nodes },
    }))
    .unwrap()
}

/// What a made-up workspace says against rules.
fn reported(rules: &Rules, metadata: &Metadata) -> Vec<String> {
    let all = metadata.packages.iter().map(Package::called).collect();
    violations(rules, metadata, &all)
}

/// Rules of which every line is needed.
fn small_rules() -> Rules {
    toml::from_str(
        r#"
        [graph]
        [licenses]
        allow = ["MIT"]
        exceptions = []
        unused-allowed-license = "deny"
        [bans]
        wildcards = "deny"
        multiple-versions = "deny"
        deny = [{ crate = "leftpad", reason = "it goes away" }]
        skip = []
        skip-tree = []
        [sources]
        unknown-registry = "deny"
        unknown-git = "deny"
        allow-git = []
        "#,
    )
    .unwrap()
}

/// What a crate under such a licence says against the small rules.
fn against(licence: &str) -> Vec<String> {
    reported(&small_rules(), &made_up(&[("one", "0.1.0", licence)], serde_json::json!([])))
}

#[test]
fn a_licence_is_read_as_an_expression() {
    for allowed in ["MIT", "MIT OR GPL-3.0-only", "GPL-3.0-only/MIT", "(MIT AND MIT) OR Apache-2.0"] {
        assert_eq!(against(allowed), [""; 0], "{allowed}");
    }
    for forbidden in ["GPL-3.0-only", "MIT AND GPL-3.0-only", "MIT WITH Classpath-exception-2.0", "Nobody's"]
    {
        assert_eq!(against(forbidden).len(), 1, "{forbidden}: {:?}", against(forbidden));
    }
}

#[test]
fn an_exception_holds_for_its_crate_alone() {
    let mut rules = small_rules();
    rules.licenses.exceptions.push(Exception { name: "one".to_owned(), allow: vec!["MPL-2.0".to_owned()] });
    let taken = [("one", "0.1.0", "MPL-2.0"), ("two", "0.1.0", "MPL-2.0")];
    let found = reported(&rules, &made_up(&taken, serde_json::json!([])));
    assert_eq!(found, ["two 0.1.0: licence \"MPL-2.0\" is not allowed"]);
}

#[test]
fn a_licence_or_a_crate_that_is_gone_is_reported() {
    let mut rules = small_rules();
    rules.licenses.allow.push("ISC".to_owned());
    rules.bans.skip.push(Named { spec: "one@0.1.0".to_owned(), reason: String::new() });
    assert_eq!(reported(&rules, &made_up(&[], serde_json::json!([]))).len(), 2);
}

#[test]
fn a_ban_a_second_version_and_any_version_are_reported() {
    let taken = [("leftpad", "1.0.0", "MIT"), ("one", "0.1.0", "MIT"), ("one", "0.2.0", "MIT")];
    let mut rules = small_rules();
    let metadata = made_up(&taken, serde_json::json!([{ "name": "one", "req": "*" }]));
    let expected = [
        "more than one version: one 0.1.0, one 0.2.0",
        "leftpad 1.0.0 is banned: it goes away",
        "own takes any version of one",
    ];
    assert_eq!(reported(&rules, &metadata), expected);
    rules.bans.skip.push(Named { spec: "one@0.1.0".to_owned(), reason: String::new() });
    assert_eq!(reported(&rules, &metadata), expected[1..]);
}

#[test]
fn a_crate_from_elsewhere_is_reported() {
    for source in
        [Some("git+https://github.com/somebody/one"), Some("registry+https://example.org/index"), None]
    {
        let taken = [("one", "0.1.0", "MIT"), ("two", "0.1.0", "MIT")];
        let mut metadata = made_up(&taken, serde_json::json!([]));
        metadata.packages[2].source = source.map(str::to_owned);
        assert_eq!(reported(&small_rules(), &metadata).len(), 1, "{source:?}");
    }
}

#[test]
fn the_notices_name_all_that_is_linked_or_bundled() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    if !root.join("viewer/node_modules/three").exists() {
        assert_ne!(std::env::var("POSED_VIEWER").as_deref(), Ok("require"));
        println!("skipped: the page's packages are not there");
        return;
    }
    let output = Command::new(root.join("packaging/notices")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let notices = String::from_utf8(output.stdout).unwrap();
    let (list, _) = notices.split_once("\nText 1\n").unwrap();

    let own: BTreeSet<String> = Metadata::read().members().map(Package::called).collect();
    for name in tree("--package=posed", "normal,no-proc-macro").difference(&own) {
        assert!(list.contains(&format!("\n{name}: ")), "{name}");
    }
    for name in ["three", "uplot"] {
        assert!(list.contains(&format!("\n{name} ")), "{name}");
    }
}

#[test]
fn every_crate_can_be_published() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let metadata = Metadata::read();
    // What is for tests alone is nobody else's.
    let published =
        metadata.members().filter(|member| member.publish.as_ref().is_none_or(|to| !to.is_empty()));
    for member in published {
        let name = &member.name;
        assert!(member.description.as_ref().is_some_and(|text| text.ends_with('.')), "{name}: description");
        assert_eq!(member.license.as_deref(), Some("MIT OR Apache-2.0"), "{name}");
        assert!(member.readme.is_some(), "{name}: readme");
        assert!(!member.keywords.is_empty() && !member.categories.is_empty(), "{name}: keywords, categories");
        let list = cargo(&["package", "--list", "--allow-dirty", "--package", name]);
        for file in ["LICENSE-MIT", "LICENSE-APACHE", "README.md", "Cargo.toml"] {
            assert!(list.lines().any(|line| line == file), "{name}: {file} is not in its package");
        }
        assert!(!list.contains("node_modules/"), "{name}");
        let folder = member.manifest_path.parent().unwrap();
        for licence in ["LICENSE-MIT", "LICENSE-APACHE"] {
            let text = |folder: &Path| std::fs::read_to_string(folder.join(licence)).unwrap();
            assert_eq!(text(folder), text(root), "{name}: {licence}");
        }
    }
}
