//! `library.export`: what `posed export` writes, into a folder from where it is fetched.

use std::path::Path;

use serde_json::json;

use super::{EXPORTS, Librarian, NICE, Progress, Use};
use crate::jobs::{Jobs, give_way};
use crate::recordings;
use crate::server::{Refusal, Reply};
use posed_protocol::RefusalReason;
use posed_recording::export::Export;

/// What is asked for, in the words of `posed export`.
pub(super) struct Wanted {
    pub(super) format: String,
    pub(super) bones: Option<String>,
    pub(super) model: Option<String>,
    pub(super) body: Option<String>,
    pub(super) frame: Option<String>,
}

impl Wanted {
    fn export(self) -> Result<Export, Refusal> {
        let Self { format, bones, model, body, frame } = self;
        Export::parse(&format, bones.as_deref(), model.as_deref(), body, frame.as_deref())
            .map_err(Refusal::bad_request)
    }
}

impl Librarian {
    pub(super) fn export(&self, name: &str, wanted: Wanted, reply: Reply, jobs: &Jobs) {
        let (export, path) = match self.exportable(name, wanted) {
            Ok(exportable) => exportable,
            Err(refusal) => return reply.refuse(refusal),
        };
        let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy();
        let (folder, file) = (self.folder.join(EXPORTS), export.file_name(&stem));
        let held = self.in_use.hold(&path, Use::Read);
        jobs.run("library.export", reply, move |job| {
            let _held = held;
            give_way(NICE);
            std::fs::create_dir_all(&folder)?;
            let output = folder.join(&file);
            let mut progress = Progress::over(&path);
            match export.write(&path, &output, |bytes| progress.at(bytes, job)) {
                Ok(rows) => {
                    let bytes = output.metadata()?.len();
                    job.result(json!({ "file": file, "rows": rows, "bytes": bytes }));
                    Ok(format!("{file}: {rows} rows"))
                }
                Err(error) if error.is_cancelled() => Ok("nothing was written".to_owned()),
                Err(error) => Err(error.into()),
            }
        });
    }

    fn exportable(&self, name: &str, wanted: Wanted) -> Result<(Export, std::path::PathBuf), Refusal> {
        let export = wanted.export()?;
        let path = recordings::find(&self.folder, name)?;
        if self.in_use.is_recorded(&path) {
            return Err(Refusal::new("busy", "it is being recorded; stop that first")
                .because(RefusalReason::IsRecorded));
        }
        Ok((export, path))
    }
}
