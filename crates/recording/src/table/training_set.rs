//! What a model is learned from: labelled files, brought to the joints that all of them have.

use posed_motion::segments::{Options, Sequence, Trainer};

use super::Sequences;
use super::labelled::Named;

/// Sequences that a model can be learned from.
#[derive(Clone, Debug)]
pub struct TrainingSet {
    /// The joints that all files have, in the order of the first.
    pub joints: Vec<String>,
    /// All labels in alphabetical order: a class is its index here.
    pub labels: Vec<String>,
    /// Names of the files and their numbers of frames.
    pub files: Vec<(String, u64)>,
    /// Joints that are left out because a file lacks them, one sentence each.
    pub notes: Vec<String>,
    sequences: Vec<Sequence>,
}

impl TrainingSet {
    /// From files, with those of their joints that are `wanted`.
    ///
    /// # Errors
    /// One sentence: there is no file, or the files have no wanted joint in common.
    pub fn new(files: &[Named], wanted: impl Fn(&str) -> bool) -> Result<Self, String> {
        let mut joints = files.first().map(|(_, file)| file.joints.clone()).unwrap_or_default();
        joints.retain(|joint| wanted(joint));
        let mut notes = Vec::new();
        for (name, file) in files {
            joints.retain(|joint| {
                let kept = file.joints.contains(joint);
                if !kept {
                    notes.push(format!("goes without `{joint}`, which {name} lacks"));
                }
                kept
            });
        }
        if joints.is_empty() {
            return Err("the files have no joint in common that is wanted".to_owned());
        }
        let named = |(_, file): &Named| {
            file.frames.iter().filter_map(|frame| frame.label.clone()).collect::<Vec<_>>()
        };
        let mut labels: Vec<String> = files.iter().flat_map(named).collect();
        labels.sort();
        labels.dedup();
        let sequence =
            |(name, file): &Named| file.sequence(&joints, &labels).map_err(|what| format!("{name}: {what}"));
        let sequences = files.iter().map(sequence).collect::<Result<_, _>>()?;
        let files = files.iter().map(|(name, file)| (name.clone(), file.frames.len() as u64)).collect();
        Ok(Self { joints, labels, files, notes, sequences })
    }

    /// A training on these sequences.
    ///
    /// # Errors
    /// As for [`Trainer::new`].
    pub fn trainer(&self, options: Options) -> Result<Trainer, String> {
        Trainer::new(options, self.joints.clone(), &self.labels, self.sequences.clone())
    }

    /// Number of frames of all files together.
    pub fn frames(&self) -> u64 {
        self.files.iter().map(|(_, frames)| frames).sum()
    }
}

impl Sequences {
    /// As a network takes it. `joints` is the model's order; one that the file lacks is missing in every frame. `labels` are its
    /// classes, in their order; a frame without a label, or between two, has none.
    ///
    /// # Errors
    /// One sentence: a label that is not among them.
    pub fn sequence(&self, joints: &[String], labels: &[String]) -> Result<Sequence, String> {
        let column = |joint: &String| self.joints.iter().position(|name| name == joint);
        let columns: Vec<Option<usize>> = joints.iter().map(column).collect();
        let mut sequence = Sequence { joints: joints.len(), ..Sequence::default() };
        for (index, frame) in self.frames.iter().enumerate() {
            let class = match frame.label.as_deref().filter(|_| !frame.transition) {
                None => None,
                Some(label) => match labels.iter().position(|known| known == label) {
                    Some(class) => Some(class as u16),
                    None => return Err(format!("the label `{label}` is none of {}", labels.join(", "))),
                },
            };
            let row = self.positions_m(index);
            sequence.t_s.push(frame.t_s);
            sequence.positions_m.extend(columns.iter().map(|column| column.and_then(|column| row[column])));
            sequence.classes.push(class);
        }
        Ok(sequence)
    }
}
