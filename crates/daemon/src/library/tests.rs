use std::fs::{self, File};
use std::time::Duration;

use serde_json::{Value, json};

use super::*;
use crate::clock::StageClock;
use crate::server::Hub;
use crate::server::testing::Asking;
use posed_recording::testing::{chunk, header};
use posed_recording::{Writer, digest_file};

/// A library of a folder, and who asks it.
struct Desk {
    folder: tempfile::TempDir,
    library: TakeLibrary,
    jobs: Jobs,
    asking: Asking,
}

impl Desk {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let library = TakeLibrary::start(folder.path().join("recordings")).unwrap();
        let jobs = Jobs::new(StageClock::start(), Hub::default());
        Self { folder, library, jobs, asking: Asking::new() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join("recordings").join(name)
    }

    /// A recording that was ended in order.
    fn record(&self, name: &str) {
        fs::create_dir_all(self.path("")).unwrap();
        let mut writer = Writer::new(File::create(self.path(name)).unwrap(), header()).unwrap();
        (0..10).for_each(|n| writer.entry(&chunk(n)).unwrap());
        writer.finish("enough").unwrap();
    }

    fn ask(&self, call: Call) -> Value {
        self.library.ask(call, self.asking.reply(1), &self.jobs);
        std::iter::repeat_with(|| {
            std::thread::yield_now();
            self.asking.answers()
        })
        .flatten()
        .next()
        .unwrap()
    }

    fn ok(&self, call: Call) -> Value {
        let answer = self.ask(call);
        assert_eq!(answer["type"], "ok", "{answer}");
        answer["result"].clone()
    }

    fn code(&self, call: Call) -> String {
        let answer = self.ask(call);
        assert_eq!(answer["type"], "error", "{answer}");
        answer["code"].as_str().unwrap().to_owned()
    }

    fn names(&self, bin: bool) -> Vec<String> {
        let listed = self.ok(Call::LibraryList { bin });
        let takes = listed["takes"].as_array().unwrap().iter();
        takes.map(|take| take["name"].as_str().unwrap().to_owned()).collect()
    }
}

fn rename(name: &str, to: &str) -> Call {
    Call::LibraryRename { name: name.into(), to: to.into() }
}

fn remove(name: &str) -> Call {
    Call::LibraryRemove { name: name.into() }
}

fn restore(name: &str) -> Call {
    Call::LibraryRestore { name: name.into() }
}

#[test]
fn a_folder_that_is_not_there_is_empty_and_what_is_no_recording_says_so() {
    let desk = Desk::new();
    assert_eq!(desk.ok(Call::LibraryList { bin: false }), json!({"takes": [], "recording": null}));
    assert_eq!(desk.names(true), [""; 0]);
    assert_eq!(desk.ok(Call::LibraryEmptyBin {}), json!({"removed": 0}));
    desk.record("a.mcap");
    fs::write(desk.path("broken.mcap"), "nothing").unwrap();
    fs::create_dir(desk.path("folder.mcap")).unwrap();
    let listed = desk.ok(Call::LibraryList { bin: false });
    let [take, broken] = listed["takes"].as_array().unwrap().as_slice() else { panic!("{listed}") };
    assert_eq!((&take["name"], &take["stage"]), (&json!("a.mcap"), &json!("Test stage")));
    assert_eq!((&take["complete"], &take["unreadable"]), (&json!(true), &Value::Null));
    assert!(take["utc"].as_str().unwrap().starts_with("2023-11-14T22:13:20."), "{take}");
    assert_eq!((&broken["name"], &broken["utc"]), (&json!("broken.mcap"), &Value::Null));
    assert!(broken["unreadable"].as_str().unwrap().contains("no recording"), "{broken}");
}

#[test]
fn a_take_goes_into_the_bin_and_back_with_what_belongs_to_it_and_never_over_another() {
    let desk = Desk::new();
    desk.record("a.mcap");
    let digest = digest_file(&desk.path("a.mcap"));
    fs::write(&digest, "{}").unwrap();
    fs::write(desk.path("a.labels.csv"), "label\n").unwrap();
    assert_eq!(desk.ok(rename("a.mcap", "b")), json!({"name": "b.mcap"}));
    assert!(
        !digest.exists() && desk.path("b.mcap.digest.json").exists() && desk.path("b.labels.csv").exists()
    );
    desk.record("a.mcap");
    assert_eq!(desk.code(rename("a.mcap", "b.mcap")), "exists");
    assert_eq!(desk.ok(rename("a.mcap", "a")), json!({"name": "a.mcap"}), "the same name is no other");

    assert_eq!(desk.ok(remove("b.mcap")), json!({"name": "b.mcap"}));
    assert!(desk.path("bin/b.labels.csv").exists());
    desk.ok(rename("a.mcap", "b"));
    assert_eq!(desk.ok(remove("b.mcap")), json!({"name": "b-2.mcap"}));
    assert_eq!((desk.names(false), desk.names(true)), (vec![], vec!["b-2.mcap".into(), "b.mcap".into()]));
    desk.record("b.mcap");
    assert_eq!(desk.code(restore("b.mcap")), "exists");
    assert_eq!(desk.ok(restore("b-2.mcap")), json!({"name": "b-2.mcap"}));
    assert_eq!(desk.ok(Call::LibraryEmptyBin {}), json!({"removed": 1}));
    assert_eq!(fs::read_dir(desk.path("bin")).unwrap().count(), 0);
    assert_eq!(desk.names(false), ["b-2.mcap", "b.mcap"]);
}

#[test]
fn no_name_leads_out_of_the_folder() {
    let desk = Desk::new();
    desk.record("a.mcap");
    let outside = desk.folder.path().join("outside.mcap");
    fs::copy(desk.path("a.mcap"), &outside).unwrap();
    fs::create_dir_all(desk.path("bin")).unwrap();
    for name in ["../outside.mcap", "nobody.mcap", "", ".", "bin", "./a.mcap", outside.to_str().unwrap()] {
        assert_eq!(desk.code(remove(name)), "not_found", "{name}");
        assert_eq!(desk.code(restore(name)), "not_found", "{name}");
        assert_eq!(desk.code(rename(name, "b")), "not_found", "{name}");
        assert_eq!(desk.code(Call::LibraryDigest { name: name.into(), make: true }), "not_found", "{name}");
        assert_eq!(desk.code(export(name, "csv")), "not_found", "{name}");
    }
    for to in ["../b", "", ".b", "a/b", "a\\b", "x\u{0}", &"x".repeat(129)] {
        assert_eq!(desk.code(rename("a.mcap", to)), "bad_request", "{to}");
    }
    assert_eq!(desk.names(false), ["a.mcap"]);
    assert!(outside.exists());
}

#[test]
fn what_is_in_use_stays_where_it_is() {
    let desk = Desk::new();
    desk.record("a.mcap");
    let path = desk.path("a.mcap");
    let in_use = desk.library.in_use();
    for how in [Use::Recorded, Use::Read, Use::Played] {
        let held = in_use.hold(&path, how);
        assert_eq!(desk.code(remove("a.mcap")), "busy", "{how:?}");
        assert_eq!(desk.code(rename("a.mcap", "b")), "busy", "{how:?}");
        drop(held);
    }
    let held = in_use.hold(&path, Use::Recorded);
    assert_eq!(desk.ok(Call::LibraryList { bin: false })["recording"], "a.mcap");
    assert_eq!(desk.code(export("a.mcap", "csv")), "busy");
    drop(held);
    // A recorder of another program holds a lock.
    let file = File::options().write(true).open(&path).unwrap();
    file.lock().unwrap();
    assert_eq!(desk.code(remove("a.mcap")), "busy");
    drop(file);

    // One that is open for who may come back is closed for who moves it.
    let held = std::sync::Mutex::new(Some(in_use.hold(&path, Use::Played)));
    let (sender, reported) = bounded(1);
    desk.library.lend(Box::new(move |name| {
        sender.send(name.to_owned()).unwrap();
        held.lock().unwrap().take().is_some()
    }));
    assert_eq!(desk.ok(remove("a.mcap")), json!({"name": "a.mcap"}));
    assert_eq!(reported.recv_timeout(Duration::from_secs(10)).unwrap(), "a.mcap");
}

fn export(name: &str, format: &str) -> Call {
    let (name, format) = (name.to_owned(), format.to_owned());
    Call::LibraryExport { name, format, bones: None, model: None, body: None, frame: None }
}

#[test]
fn an_export_that_cannot_be_is_refused_before_it_is_a_job() {
    let desk = Desk::new();
    desk.record("a.mcap");
    assert_eq!(desk.code(export("a.mcap", "docx")), "bad_request");
    let mut wrong = export("a.mcap", "csv");
    if let Call::LibraryExport { bones, .. } = &mut wrong {
        *bones = Some("mixamo".into());
    }
    assert_eq!(desk.code(wrong), "bad_request");
    assert!(!desk.path(EXPORTS).exists());
    assert!(desk.ok(export("a.mcap", "csv"))["job"].is_u64());
}

#[test]
fn a_take_without_a_digest_says_so_and_one_that_cannot_be_made_is_a_job_that_fails() {
    let desk = Desk::new();
    desk.record("a.mcap");
    let ask = |make| Call::LibraryDigest { name: "a.mcap".into(), make };
    assert_eq!(desk.ok(ask(false)), json!({"unknown": true}));
    // Its snapshot is none: it cannot be replayed.
    assert!(desk.ok(ask(true))["job"].is_u64());
    assert_eq!(desk.ok(ask(false)), json!({"unknown": true}));
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_may_not_be_written_to_is_a_refusal_in_words() {
    use std::os::unix::fs::PermissionsExt;
    let desk = Desk::new();
    desk.record("a.mcap");
    let mode = |mode| fs::set_permissions(desk.path(""), fs::Permissions::from_mode(mode)).unwrap();
    mode(0o555);
    // Who may do everything is not refused by rights.
    let is_root = File::create(desk.path("probe")).is_ok();
    if !is_root {
        assert_eq!(desk.code(remove("a.mcap")), "failed");
        assert_eq!(desk.code(rename("a.mcap", "b")), "failed");
        assert_eq!(desk.names(false), ["a.mcap"]);
    }
    mode(0o755);
}

#[test]
fn three_hundred_takes_are_listed_at_once_and_again_without_reading_them() {
    let desk = Desk::new();
    desk.record("take-000.mcap");
    for number in 1..300 {
        fs::copy(desk.path("take-000.mcap"), desk.path(&format!("take-{number:03}.mcap"))).unwrap();
    }
    let names = desk.names(false);
    assert_eq!(names.len(), 300);
    // What was read is known as long as the file is as it was.
    let path = desk.path("take-000.mcap");
    let (bytes, modified) = (fs::read(&path).unwrap(), path.metadata().unwrap().modified().unwrap());
    fs::write(&path, vec![0; bytes.len()]).unwrap();
    File::options().write(true).open(&path).unwrap().set_modified(modified).unwrap();
    assert_eq!(desk.names(false), names);
    let unreadable = |listed: Value| listed["takes"][299]["unreadable"].is_string();
    assert!(!unreadable(desk.ok(Call::LibraryList { bin: false })));
    fs::write(&path, vec![0; bytes.len() - 1]).unwrap();
    assert!(unreadable(desk.ok(Call::LibraryList { bin: false })));
}

#[test]
fn a_person_who_is_forgotten_leaves_no_recording_in_the_bin_nor_what_was_made_of_one() {
    let desk = Desk::new();
    desk.record("a.mcap");
    desk.record("ab.mcap");
    fs::write(digest_file(&desk.path("a.mcap")), "{}").unwrap();
    desk.ok(remove("a.mcap"));
    desk.record("a.mcap");
    fs::create_dir_all(desk.path(EXPORTS)).unwrap();
    for export in ["a.csv", "a.anna.bvh", "ab.csv"] {
        fs::write(desk.path(EXPORTS).join(export), "").unwrap();
    }
    forget(&desk.path(""), "a.mcap").unwrap();
    forget(&desk.path(""), "gone.mcap").unwrap();
    assert_eq!((desk.names(false), desk.names(true)), (vec!["ab.mcap".to_owned()], vec![]));
    let left: Vec<_> =
        fs::read_dir(desk.path(EXPORTS)).unwrap().map(|file| file.unwrap().file_name()).collect();
    assert_eq!(left, ["ab.csv"]);
    assert_eq!(fs::read_dir(desk.path("bin")).unwrap().count(), 0);
}

#[test]
fn more_calls_than_may_wait_for_a_disk_that_hangs_are_refused_and_those_that_wait_are_there() {
    let (asks, hangs) = bounded(WAITING);
    let library = TakeLibrary { asks, in_use: InUse::default(), shared: Arc::default() };
    let jobs = Jobs::new(StageClock::start(), Hub::default());
    let asking = Asking::new();
    for id in 0..WAITING + 50 {
        library.ask(Call::LibraryList { bin: false }, asking.reply(id), &jobs);
    }
    let refused = asking.answers();
    assert!(refused.iter().all(|answer| answer["code"] == "busy"), "{refused:?}");
    assert_eq!(crate::server::testing::ids(&refused), (WAITING..WAITING + 50).collect::<Vec<_>>());
    hangs.try_iter().for_each(|ask| ask.reply.ok(None));
    assert_eq!(crate::server::testing::ids(&asking.answers()), (0..WAITING).collect::<Vec<_>>());
}

#[test]
fn what_somebody_says_of_a_take_is_kept_where_training_reads_it() {
    let desk = Desk::new();
    desk.record("a.mcap");
    let label = |from_s, to_s, label: &str| Call::ReplayLabel {
        name: "a.mcap".into(),
        from_s,
        to_s,
        label: label.into(),
    };
    let labels = || Call::ReplayLabels { name: "a.mcap".into() };
    assert_eq!(desk.code(label(11.0, 12.0, "walk")), "no_digest");
    assert_eq!(desk.ok(labels()), json!({"labels": []}));
    let digest = posed_protocol::Digest { first_frame_s: Some(10.25), ..Default::default() };
    keep_digest(&desk.path("a.mcap"), &digest).unwrap();
    let walk = json!({"label": "walk", "from_s": 11.0, "to_s": 13.5});
    assert_eq!(desk.ok(label(11.0, 13.5, " walk ")), json!({"labels": [walk]}));
    desk.ok(label(12.0, 13.0, "pick"));
    desk.ok(label(12.0, 20.0, ""));
    let left = json!({"labels": [{"label": "walk", "from_s": 11.0, "to_s": 12.0}]});
    assert_eq!(desk.ok(labels()), left);
    let kept = posed_recording::table::read_elan_segments(&desk.path("a.eaf")).unwrap();
    assert_eq!(kept, [("walk".to_owned(), 0.75, 1.75)], "s since the first frame");
    for wrong in [
        label(2.0, 1.0, "x"),
        label(1.0, 1.0, "x"),
        label(0.0, 1.0, &"x".repeat(201)),
        label(0.0, 1.0, "a\nb"),
    ] {
        assert_eq!(desk.code(wrong), "bad_request");
    }
    let elsewhere = Call::ReplayLabel { name: "../a.mcap".into(), from_s: 0.0, to_s: 1.0, label: "x".into() };
    assert_eq!(desk.code(elsewhere), "not_found");
    // Labels frame by frame count before these, and are not touched.
    fs::write(desk.path("a.labels.csv"), "t,label\n10.25,sit\n10.5,sit\n10.75,\n").unwrap();
    assert_eq!(desk.code(label(11.0, 13.5, "walk")), "exists");
    assert_eq!(desk.ok(labels()), json!({"labels": [{"label": "sit", "from_s": 10.25, "to_s": 10.75}]}));
}
