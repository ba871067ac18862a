//! Calls `setup.*`: what the stage file says, changes of it, and what answers at the ports.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;
use std::time::Duration;

use super::super::find::proposal::{newcomers, propose};
use super::super::find::survey::{self, Wanted};
use super::super::fusion::{Command, FusionInbox};
use super::super::jobs::{Failure, Job};
use super::super::rehearse;
use super::super::stages::Editor;
use super::{Calls, Refusal, Reply};
use posed_drivers::port;
use posed_protocol::{
    Found, FoundPort, FoundSensor, RefusalReason, Setup, SetupBody, SetupDevice, SetupProblem, SetupSensor,
};
use posed_stage::edit::{Change, edit, owners};
use posed_stage::{Problem, Report, SEGMENTS, Stage, without_secrets};

/// How often a job looks whether it was cancelled.
const LOOK: Duration = Duration::from_millis(100);

/// Why there is nothing to change.
const NO_FILE: &str = "this daemon was not started on a stage file of its own (`posed demo` shows simulated devices): \
    begin one with `posed run --new stage.toml`";

/// The stage file of a daemon.
#[derive(Default)]
pub(super) struct File {
    /// The text that the daemon was started with.
    text: String,
    /// How the file is changed, if it can be.
    editor: Option<Editor>,
}

impl File {
    pub(super) fn new(text: String, editor: Option<Editor>) -> Self {
        Self { text, editor }
    }

    /// What stands in the file now.
    pub(super) fn read(&self) -> Result<String, Refusal> {
        let Some(Editor { file, .. }) = &self.editor else { return Ok(self.text.clone()) };
        std::fs::read_to_string(&file.path)
            .map_err(|error| Refusal::failed(format!("cannot read {}: {error}", file.path.display())))
    }

    fn check(&self, text: &str) -> Report {
        match &self.editor {
            Some(editor) => (editor.file.check)(text, editor.folder()),
            None => posed_stage::check(text),
        }
    }

    fn name(&self) -> String {
        let name = self.editor.as_ref().and_then(|editor| editor.file.path.file_name());
        name.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }
}

impl Calls {
    /// The stage file as it would be with these changes.
    pub(super) fn read_setup(&self, changes: &[Change]) -> Result<Setup, Refusal> {
        let text = self.file.read()?;
        let revision = revision(&text);
        let text = edited(text, changes)?;
        let Report { problems, warnings, .. } = self.file.check(&text);
        let why_not = match &self.file.editor {
            Some(editor) => editor.why_not(),
            None => Some(NO_FILE.to_owned()),
        };
        let (problems, warnings) = (placed(&text, problems), placed(&text, warnings));
        // Of a text that is no TOML nothing is known but its problems.
        let keys: toml::Table = toml::from_str(&text).unwrap_or_default();
        Ok(Setup {
            file: self.file.name(),
            revision,
            why_not,
            toml: without_secrets(&text),
            name: text_of(&keys, "name"),
            devices: tables(&keys, "device").into_iter().map(device).collect(),
            sensors: tables(&keys, "sensor").into_iter().map(sensor).collect(),
            bodies: tables(&keys, "body").into_iter().map(body).collect(),
            problems,
            warnings,
        })
    }

    /// Writes changes into the stage file, and has the changed stage begin.
    pub(super) fn save_setup(&self, changes: &[Change], read: &str) -> Result<(), Refusal> {
        let Some(editor) = &self.file.editor else {
            return Err(Refusal::new("read_only", NO_FILE).because(RefusalReason::NoFile));
        };
        if let Some(why_not) = editor.why_not() {
            return Err(Refusal::new("read_only", why_not));
        }
        if let Some(running) = self.jobs.running().first() {
            let reason = format!("{running} is running: the stage changes when it has ended, or was stopped");
            return Err(Refusal::new("busy", reason).because(RefusalReason::JobRuns).with("job", running));
        }
        let before = self.file.read()?;
        if revision(&before) != read {
            let reason = "the stage file was changed by somebody else meanwhile: read it again";
            return Err(Refusal::new("changed", reason).because(RefusalReason::FileChanged));
        }
        let text = edited(before.clone(), changes)?;
        if text == before {
            return Ok(());
        }
        if let Some(problem) = self.file.check(&text).problems.first() {
            return Err(Refusal::failed(problem));
        }
        let stage = Stage::load_text(&text, &editor.file.path).map_err(Refusal::failed)?;
        let options = (editor.file.options)(stage, text.clone());
        rehearse(&options).map_err(Refusal::failed)?;
        editor.write(&text).map_err(|error| {
            Refusal::failed(format!("cannot write {}: {error}", editor.file.path.display()))
        })?;
        editor.begin(options, before);
        Ok(())
    }

    /// Asks what is at the ports.
    pub(super) fn find_ports(&self, port: Option<String>, reply: Reply) {
        let (stage, inbox) = (self.stage.clone(), self.inbox.clone());
        self.jobs.run("setup.find", reply, move |job| find(&stage, &inbox, port, job));
    }
}

fn edited(text: String, changes: &[Change]) -> Result<String, Refusal> {
    if changes.is_empty() { Ok(text) } else { edit(&text, changes).map_err(Refusal::bad_request) }
}

/// Differs between texts.
fn revision(text: &str) -> String {
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}

/// Problems with what they are about.
fn placed(text: &str, problems: Vec<Problem>) -> Vec<SetupProblem> {
    let owners = owners(text, problems.iter().map(|problem| problem.line));
    let place =
        |(Problem { line, key, message, fix }, owner): (Problem, Option<posed_stage::edit::Owner>)| {
            let (table, name) = owner.map(|owner| (owner.table, owner.name)).unzip();
            SetupProblem { line, key, message, fix, table, name }
        };
    problems.into_iter().zip(owners).map(place).collect()
}

/// The tables of a key, whether one or several.
fn tables<'t>(keys: &'t toml::Table, key: &str) -> Vec<&'t toml::Table> {
    match keys.get(key) {
        Some(toml::Value::Table(only)) => vec![only],
        Some(toml::Value::Array(all)) => all.iter().filter_map(toml::Value::as_table).collect(),
        _ => Vec::new(),
    }
}

fn text_of(keys: &toml::Table, key: &str) -> String {
    keys.get(key).and_then(toml::Value::as_str).unwrap_or_default().to_owned()
}

fn device(keys: &toml::Table) -> SetupDevice {
    SetupDevice { name: text_of(keys, "name"), driver: text_of(keys, "driver"), port: text_of(keys, "port") }
}

fn sensor(keys: &toml::Table) -> SetupSensor {
    let name = text_of(keys, "name");
    let given = |key| keys.get(key).and_then(toml::Value::as_str).map(str::to_owned);
    let by_name = || SEGMENTS.contains(&name.as_str()).then(|| name.clone());
    let address = keys.get("address").and_then(toml::Value::as_integer);
    SetupSensor {
        device: text_of(keys, "device"),
        address: address.and_then(|address| u16::try_from(address).ok()).unwrap_or_default(),
        body: given("body"),
        segment: given("segment").or_else(by_name),
        name,
    }
}

fn body(keys: &toml::Table) -> SetupBody {
    let height_m =
        keys.get("height_m").and_then(|height| height.as_float().or(height.as_integer().map(|m| m as f64)));
    let name = text_of(keys, "name");
    SetupBody { name: if name.is_empty() { "person".to_owned() } else { name }, height_m }
}

/// What the devices of the stage have, what sends to them and is not on the stage, and what answers at all other ports.
fn find(stage: &Stage, inbox: &FusionInbox, port: Option<String>, job: &Job) -> Result<String, Failure> {
    let held: Vec<FoundPort> = (0..stage.devices.len()).map(|index| held(stage, index)).collect();
    let is_held = |port: &str| held.iter().any(|held| same_port(&held.port, port));
    if let Some(port) = &port
        && let Some(held) = held.iter().find(|held| same_port(&held.port, port))
    {
        return Err(
            format!("{port} belongs to {} already", held.device.as_deref().unwrap_or_default()).into()
        );
    }
    let alone = port.is_some();
    let asked: Vec<String> = match port {
        Some(port) => vec![port],
        None => port::list().into_iter().filter(|port| !is_held(port)).collect(),
    };
    let names = stage.devices.iter().map(|device| device.name.as_str());
    let names: Vec<&str> = names.chain(stage.sensors.iter().map(|sensor| sensor.name.as_str())).collect();
    let sending = if alone { Vec::new() } else { inbox.ask(|to| Command::Found { to })? };
    let sending = stage.devices.iter().zip(&sending);
    let sending: Vec<FoundPort> =
        sending.filter_map(|(device, found)| newcomers(device, found, &names)).collect();
    let mut shown: Vec<Option<FoundPort>> = asked.iter().map(|_| None).collect();
    let all = |answered: &[Option<FoundPort>], network: &[FoundPort]| {
        let mut ports: Vec<FoundPort> = answered.iter().flatten().chain(network).cloned().collect();
        propose(&mut ports, &names);
        ports.splice(0..0, held.iter().chain(&sending).cloned());
        Found { ports }
    };
    let tell = |fraction: f64, message: String, found: &Found| match serde_json::to_value(found) {
        Ok(found) => job.progress_with(Some(fraction), message, found),
        Err(error) => tracing::error!(%error, "what was found cannot be reported"),
    };
    let count = asked.len();
    tell(0.0, format!("asking {count} ports"), &all(&shown, &[]));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let found = runtime.block_on(async {
        let network = async { if alone { Vec::new() } else { survey::network().await } };
        let ports = survey::ports(asked, Wanted::default(), survey::LIMIT, |index, report| {
            shown[index] = Some(report.clone());
            let answered = shown.iter().flatten().count();
            let message = format!("{answered} of {count} ports asked");
            tell(answered as f64 / count as f64, message, &all(&shown, &[]));
        });
        tokio::select! {
            (ports, network) = async { tokio::join!(ports, network) } => Some((ports, network)),
            () = cancelled(job) => None,
        }
    });
    let Some((ports, network)) = found else { return Ok("asked no more".to_owned()) };
    let ports: Vec<Option<FoundPort>> = ports.into_iter().map(Some).collect();
    let network: Vec<FoundPort> = network.into_iter().filter(|unit| !is_held(&unit.port)).collect();
    let found = all(&ports, &network);
    tell(1.0, format!("{count} of {count} ports asked"), &found);
    Ok(match found.ports.iter().filter(|port| !port.adds.is_empty()).count() {
        0 => "no device answers that this stage does not have".to_owned(),
        1 => "1 device answers that this stage does not have".to_owned(),
        count => format!("{count} devices answer that this stage does not have"),
    })
}

#[expect(clippy::disallowed_methods, reason = "somebody cancels in real time")]
async fn cancelled(job: &Job) {
    while !job.is_cancelled() {
        tokio::time::sleep(LOOK).await;
    }
}

/// A device of the stage, which has its port open.
fn held(stage: &Stage, index: usize) -> FoundPort {
    let device = &stage.devices[index];
    let sensors = stage.sensors.iter().filter(|sensor| sensor.device == device.name);
    FoundPort {
        port: device.port.clone(),
        local_port: device.local_port,
        device: Some(device.name.clone()),
        driver: Some(device.driver.word().to_owned()),
        sensors: sensors
            .map(|sensor| FoundSensor { address: sensor.address, serial: sensor.serial.clone() })
            .collect(),
        ..FoundPort::default()
    }
}

/// Whether two names are those of one port: `/dev/serial/by-id` has links.
fn same_port(one: &str, other: &str) -> bool {
    let real = |port: &str| std::fs::canonicalize(port).unwrap_or_else(|_| PathBuf::from(port));
    one == other || real(one) == real(other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_problem_is_at_what_it_is_about() {
        let text = "name = \"s\"\n[[device]]\nname = \"a\"\ndriver = \"fastrak\"\nport = \"usb\"\n[[sensor]]\nname = \"x\"\ndevice = \"b\"\naddress = 1\n";
        let problems = placed(text, posed_stage::check(text).problems);
        let about: Vec<(&str, Option<&str>)> =
            problems.iter().map(|problem| (problem.key.as_str(), problem.name.as_deref())).collect();
        assert_eq!(about, [("port", Some("a")), ("device", Some("x"))]);
    }

    #[test]
    fn a_port_is_known_by_its_links_too() {
        let folder = tempfile::tempdir().unwrap();
        let (port, link) = (folder.path().join("ttyUSB0"), folder.path().join("by-id"));
        std::fs::write(&port, "").unwrap();
        std::os::unix::fs::symlink(&port, &link).unwrap();
        let [port, link] = [port, link].map(|path| path.display().to_string());
        assert!(same_port(&port, &link) && same_port("tcp://a:1", "tcp://a:1"));
        assert!(!same_port("tcp://a:1", "tcp://a:2"));
    }
}
