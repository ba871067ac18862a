//! Model files: those that a stage loads at its start, and the folder of taught exercises.
//!
//! In: paths. Out: models for the pipeline. What is taught or learnt is kept as `NAME-REVISION.json` (`.safetensors`): doing so again writes
//! a new file, and the old one stays. Never: a file half written, or one written over.

use std::io;
use std::path::{Path, PathBuf};

use posed_motion::exercise::{Exercise, ExerciseError, columns_of};
use posed_recording::AtomicFile;
use posed_stage::input::Model;
use posed_stage::signals;
use posed_stage::{BodyIndex, Stage, read_intrinsics};

/// What is wrong with a model, its file or its folder.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A folder cannot be read.
    #[error("cannot read the folder {}: {error}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// A file cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// What is in a file is none, or does not fit the stage.
    #[error("{}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The stage has not what an exercise looks at.
    #[error("exercise {exercise:?} needs the channel `{channel}`, which this stage does not have")]
    Lacks {
        /// The exercise.
        exercise: String,
        /// The channel.
        channel: String,
    },
    /// An exercise cannot be called that.
    #[error("name: give 1 to 64 letters, digits, spaces, '-' and '_'")]
    Name,
    /// An exercise cannot be written.
    #[error(transparent)]
    Exercise(#[from] ExerciseError),
    /// What its own reader says, which names the file.
    #[error("{0}")]
    Refused(String),
}

/// Longest name of an exercise, bytes.
const NAME_BYTES: usize = 64;

/// Where a stage keeps its exercises; `data` is where daemons keep what they learn.
pub(super) fn exercise_folder(stage: &Stage, data: &Path) -> PathBuf {
    stage.models.exercise_folder.clone().unwrap_or_else(|| data.join("exercises"))
}

/// Where a stage keeps the intrinsics of its IMUs; `data` is where daemons keep what they learn.
pub(super) fn imu_folder(stage: &Stage, data: &Path) -> PathBuf {
    stage.models.imu_folder.clone().unwrap_or_else(|| data.join("imus"))
}

/// The file of a unit: its serial number may be an address with colons.
pub(super) fn imu_file(unit: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') { c } else { '-' };
    unit.chars().map(plain).chain(".json".chars()).collect()
}

/// What a daemon begins with.
#[derive(Debug, Default)]
pub(super) struct Loaded {
    /// In the order in which they go into the log.
    pub(super) models: Vec<Model>,
    /// What is wrong with kept files that no stage file names: the daemon runs without them.
    pub(super) left_out: Vec<ModelError>,
}

/// The models that a stage file names, and the intrinsics of all units that were ever calibrated.
///
/// # Errors
/// A file that the stage file names cannot be read, is none, or does not fit the stage.
pub(super) fn load(stage: &Stage, data: &Path) -> Result<Loaded, ModelError> {
    let mut loaded = imus(stage, &imu_folder(stage, data));
    loaded.models.append(&mut named(stage)?);
    Ok(loaded)
}

/// The intrinsics in a folder, in the order of their files; none where there is no folder, or no IMU.
fn imus(stage: &Stage, folder: &Path) -> Loaded {
    let mut loaded = Loaded::default();
    if !stage.devices.iter().any(|device| device.driver.is_inertial()) {
        return loaded;
    }
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return loaded,
        Err(error) => {
            loaded.left_out.push(ModelError::Folder { folder: folder.to_owned(), error });
            return loaded;
        }
    };
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
    paths.sort();
    for path in &paths {
        match unit(path) {
            Ok(model) => loaded.models.push(model),
            Err(error) => loaded.left_out.push(error),
        }
    }
    loaded
}

/// The intrinsics of one unit.
fn unit(path: &Path) -> Result<Model, ModelError> {
    let intrinsics = read_intrinsics(path).map_err(ModelError::Refused)?;
    let unit = intrinsics.unit.clone().unwrap_or_default();
    let model = Model::Imu { unit, intrinsics: Box::new(intrinsics) };
    model.check().map_err(|reason| ModelError::File { path: path.to_owned(), reason })?;
    Ok(model)
}

fn named(stage: &Stage) -> Result<Vec<Model>, ModelError> {
    let faults = stage.models.faults.iter().map(|path| {
        let fault_map = stage.read_faults(path).map_err(ModelError::Refused)?;
        Ok(Model::Faults { fault_map: Box::new(fault_map) })
    });
    let exercises = stage.models.exercises.iter().map(|path| {
        let exercise = read_exercise(path)?;
        let unfit = |error: ModelError| ModelError::File { path: path.clone(), reason: error.to_string() };
        check_exercise(stage, &exercise).map_err(unfit)?;
        Ok(Model::Exercise { exercise: Box::new(exercise) })
    });
    faults.chain(exercises).collect()
}

/// Whether a stage has what an exercise looks at.
pub(super) fn check_exercise(stage: &Stage, exercise: &Exercise) -> Result<(), ModelError> {
    let columns = signals::columns_of(stage);
    let lacks = |channel| ModelError::Lacks { exercise: exercise.name.clone(), channel };
    // Joints may be those of any body that has them.
    let of_body = |body: BodyIndex| -> Vec<String> {
        let prefix = signals::prefix_of(stage, body);
        columns.iter().map(|column| column.strip_prefix(&prefix).unwrap_or(column).to_owned()).collect()
    };
    let mut missing = None;
    for body in 0..stage.bodies.len().max(1) as BodyIndex {
        match columns_of(&exercise.channels, &of_body(body)) {
            Ok(_) => return Ok(()),
            Err(channel) => missing = missing.or(Some(channel)),
        }
    }
    missing.map_or(Ok(()), |channel| Err(lacks(channel)))
}

fn read_exercise(path: &Path) -> Result<Exercise, ModelError> {
    let path = || path.to_owned();
    let text = std::fs::read_to_string(path()).map_err(|error| ModelError::Read { path: path(), error })?;
    Exercise::from_json(&text).map_err(|error| ModelError::File { path: path(), reason: error.to_string() })
}

/// A folder of models with revisions: taught exercises, fault maps, or segmentation networks.
#[derive(Clone, Debug)]
pub(super) struct Library {
    folder: PathBuf,
    /// How its files end, without the dot.
    ending: &'static str,
}

/// A model in the folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Kept {
    /// Its name.
    pub(super) name: String,
    /// The newest revision.
    pub(super) revision: u32,
    ending: &'static str,
}

impl Kept {
    /// Name of its file.
    pub(super) fn file(&self) -> String {
        format!("{}-{:03}.{}", self.name, self.revision, self.ending)
    }
}

impl Library {
    pub(super) fn new(folder: PathBuf, ending: &'static str) -> Self {
        Self { folder, ending }
    }

    /// Whether an exercise can have this name, which is also that of its file.
    pub(super) fn check_name(name: &str) -> Result<(), ModelError> {
        let plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | ' ');
        let good = !name.trim().is_empty() && name.len() <= NAME_BYTES && name.chars().all(plain);
        if good { Ok(()) } else { Err(ModelError::Name) }
    }

    /// The newest revision of every exercise, by name; none where there is no folder yet.
    pub(super) fn list(&self) -> Result<Vec<Kept>, ModelError> {
        let entries = match std::fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(ModelError::Folder { folder: self.folder.clone(), error }),
        };
        let mut all: Vec<Kept> = entries
            .filter_map(|entry| {
                let file = entry.ok()?.file_name().into_string().ok()?;
                let (name, revision) = file.strip_suffix(self.ending)?.strip_suffix('.')?.rsplit_once('-')?;
                Some(self.kept(name, revision.parse().ok()?))
            })
            .collect();
        all.sort_by(|a, b| a.name.cmp(&b.name).then(b.revision.cmp(&a.revision)));
        all.dedup_by(|older, newer| older.name == newer.name);
        Ok(all)
    }

    /// The newest revision of an exercise; `None` if there is none of this name.
    pub(super) fn newest(&self, name: &str) -> Result<Option<Exercise>, ModelError> {
        match self.list()?.into_iter().find(|kept| kept.name == name) {
            Some(kept) => read_exercise(&self.path(&kept)).map(Some),
            None => Ok(None),
        }
    }

    /// Keeps an exercise under the next revision of its name, which it gets.
    pub(super) fn keep(&self, exercise: &mut Exercise) -> Result<(), ModelError> {
        let name = exercise.name.clone();
        self.keep_next::<_, ModelError>(&name, |revision| {
            exercise.revision = revision;
            Ok(exercise.to_json()?.into_bytes())
        })?;
        Ok(())
    }

    /// Keeps what `bytes` makes for the next revision of a name. Another daemon may have taken that meanwhile: then it is the one
    /// after.
    pub(super) fn keep_next<B: AsRef<[u8]>, E: From<ModelError>>(
        &self,
        name: &str,
        mut bytes: impl FnMut(u32) -> Result<B, E>,
    ) -> Result<Kept, E> {
        let known = self.list()?.into_iter().find(|kept| kept.name == name);
        let mut revision = known.map_or(0, |kept| kept.revision);
        loop {
            revision += 1;
            let kept = self.kept(name, revision);
            match self.write(&kept, bytes(kept.revision)?.as_ref()) {
                Err(ModelError::Write { error, .. }) if error.kind() == io::ErrorKind::AlreadyExists => {}
                written => return written.map(|()| kept).map_err(E::from),
            }
        }
    }

    fn kept(&self, name: &str, revision: u32) -> Kept {
        Kept { name: name.to_owned(), revision, ending: self.ending }
    }

    /// Writes a revision's file, whole or not at all, and never in the place of another.
    fn write(&self, kept: &Kept, bytes: &[u8]) -> Result<(), ModelError> {
        let path = self.path(kept);
        let write = || {
            std::fs::create_dir_all(&self.folder)?;
            let mut file = AtomicFile::create(&path)?;
            std::io::Write::write_all(&mut file, bytes)?;
            file.commit_new()
        };
        write().map_err(|error| ModelError::Write { path, error })
    }

    fn path(&self, kept: &Kept) -> PathBuf {
        self.folder.join(kept.file())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMU: &str = r#"{"gyro_bias_rad_s": [0.01, 0, 0], "gyro_bias_sigma_rad_s": 0.001, "accel_bias_m_s2": [0, 0.1, 0],
        "accel_scale": [1, 1, 1.01], "accel_residual_m_s2": 0.01, "directions": 9, "mag": null"#;

    #[test]
    fn every_unit_that_was_calibrated_is_loaded_and_a_bad_file_is_left_out_and_named() {
        let data = tempfile::tempdir().unwrap();
        let stage = |driver: &str| {
            let device = format!(
                "name = \"x\"\n[[device]]\nname = \"d\"\nport = \"auto\"\ndriver = \"{driver}\"\n[[sensor]]\nname = \"s\"\ndevice = \"d\"\naddress = 1\n"
            );
            Stage::parse(&device).unwrap()
        };
        let units = |driver: &str| -> (Vec<String>, String) {
            let unit = |model| match model {
                Model::Imu { unit, .. } => unit,
                other => panic!("{other:?}"),
            };
            let Loaded { models, left_out } = load(&stage(driver), data.path()).unwrap();
            let left_out: Vec<String> = left_out.iter().map(ToString::to_string).collect();
            (models.into_iter().map(unit).collect(), left_out.join("\n"))
        };
        let all = |units: &[&str]| (units.iter().map(ToString::to_string).collect(), String::new());
        assert_eq!(units("xbus"), all(&[]), "no folder yet");
        let folder = data.path().join("imus");
        std::fs::create_dir(&folder).unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).unwrap();
        write("0BB.json", &format!("{IMU}}}"));
        write(&imu_file("aa:11"), &format!("{IMU}, \"unit\": \"aa:11\"}}"));
        write("notes.txt", "not one of them");
        assert_eq!(units("xbus"), all(&["0BB", "aa:11"]));
        assert_eq!(units("fastrak"), all(&[]), "no IMU on this stage");
        let microtesla = "\"mag\": {\"offset\": [1, 2, 3], \"matrix\": [[1,0,0],[0,1,0],[0,0,1]], \"norm\": 49, \"residual\": 0.01}";
        write("0CC.json", &format!("{}}}", IMU.replace("\"mag\": null", microtesla)));
        let (loaded, refused) = units("x-imu3");
        assert!(refused.contains("0CC.json: ") && refused.contains("about 1, not 49"), "{refused}");
        write("0CC.json", "[]");
        std::fs::create_dir(folder.join("0DD.json")).unwrap();
        let (still, refused) = units("x-imu3");
        assert!(refused.contains("0CC.json: ") && refused.contains("0DD.json"), "{refused}");
        assert_eq!((&loaded, &still), (&all(&["0BB", "aa:11"]).0, &loaded), "the others are not left out");
    }

    #[test]
    fn a_revision_that_another_daemon_has_taken_meanwhile_is_not_overwritten() {
        let data = tempfile::tempdir().unwrap();
        let library = || Library::new(data.path().to_owned(), "json");
        let kept = library().keep_next("curl", |revision| {
            if revision == 1 {
                library().keep_next("curl", |_| Ok::<_, ModelError>(b"theirs".to_vec()))?;
            }
            Ok::<_, ModelError>(format!("ours, {revision}").into_bytes())
        });
        assert_eq!(kept.unwrap().revision, 2);
        assert_eq!(std::fs::read(data.path().join("curl-001.json")).unwrap(), b"theirs");
        assert_eq!(std::fs::read(data.path().join("curl-002.json")).unwrap(), b"ours, 2");
    }
}
