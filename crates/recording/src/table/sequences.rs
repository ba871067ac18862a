//! Sequences of joint positions: `t` (or a rate), `NAME_x,NAME_y,NAME_z` per joint, optional `label`, `transition`.

use std::path::Path;

use posed_motion::fault_map::Frames;

use super::{Clock, TableError, TableReader, TableWriter};

/// Positions of joints over time, with what somebody says they show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequences {
    /// Names of the joints, in the order of the file.
    pub joints: Vec<String>,
    /// Whether the file has a column `label`.
    pub labelled: bool,
    /// One per row.
    pub frames: Vec<SequenceFrame>,
    /// Positions in room axes (z up), m: one frame after the other, in the order of `joints`; `None` where one is missing.
    pub positions_m: Vec<Option<[f64; 3]>>,
}

/// One row beside its positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SequenceFrame {
    /// Time, s; its zero is the file's.
    pub t_s: f64,
    /// What it shows; `None` where nobody says.
    pub label: Option<String>,
    /// Between two labels: neither learned nor scored.
    pub transition: bool,
}

/// Unit of the file's positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Unit {
    /// Metres.
    #[default]
    M,
    /// Millimetres.
    Mm,
    /// Centimetres.
    Cm,
}

/// The file's upward axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Up {
    /// y, as motion capture files have it.
    #[default]
    Y,
    /// z, as the room has it.
    Z,
}

/// How to read a file of sequences.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SequenceOptions {
    /// Rate of a file without a column `t`, Hz, above 0; `None` where it has one.
    pub rate_hz: Option<f64>,
    /// Unit of its positions.
    pub unit: Unit,
    /// Its upward axis.
    pub up: Up,
}

impl Sequences {
    /// Reads a CSV file; positions are brought to metres and to room axes.
    ///
    /// # Errors
    /// The file cannot be read; otherwise as [`Sequences::from_table`].
    pub fn read(path: &Path, options: &SequenceOptions) -> Result<Self, TableError> {
        Self::from_table(TableReader::open(path)?, options)
    }

    /// Reads CSV; see [`Sequences::read`].
    ///
    /// # Errors
    /// It has no joints, or neither a column `t` nor a rate that serves; a joint lacks an axis, a cell is not what it should be.
    pub fn from_table(mut table: TableReader, options: &SequenceOptions) -> Result<Self, TableError> {
        let clock = Clock::new(&table, options.rate_hz)?;
        let mut joints: Vec<String> = Vec::new();
        for column in table.columns() {
            let joint = ["_x", "_y", "_z"].iter().find_map(|axis| column.strip_suffix(axis));
            if let Some(joint) = joint.filter(|joint| !joints.iter().any(|known| known == joint)) {
                joints.push(joint.to_owned());
            }
        }
        if joints.is_empty() {
            return Err(table.header_error("columns NAME_x,NAME_y,NAME_z of a joint", &table.columns_text()));
        }
        let mut columns = Vec::with_capacity(joints.len());
        for joint in &joints {
            let [x, y, z] = ["x", "y", "z"].map(|axis| format!("{joint}_{axis}"));
            columns.push(table.require([&x, &y, &z])?);
        }
        let label = table.column("label")?;
        let transition = table.column("transition")?;
        let scale = match options.unit {
            Unit::M => 1.0,
            Unit::Mm => 1e-3,
            Unit::Cm => 1e-2,
        };
        let mut sequences = Self { joints, labelled: label.is_some(), ..Self::default() };
        while table.next_row()? {
            for joint in &columns {
                let position = table.vector(*joint)?.map(|[x, y, z]| {
                    let [x, y, z] = [x * scale, y * scale, z * scale];
                    match options.up {
                        Up::Z => [x, y, z],
                        Up::Y => [x, -z, y],
                    }
                });
                sequences.positions_m.push(position);
            }
            let text = label.map_or("", |column| table.text(column));
            let transition = match transition.map(|column| (column, table.text(column))) {
                None | Some((_, "" | "0")) => false,
                Some((_, "1")) => true,
                Some((column, _)) => return Err(table.cell_error(column, "0 or 1")),
            };
            sequences.frames.push(SequenceFrame {
                t_s: clock.t_s(&table, sequences.frames.len())?,
                label: (!text.is_empty()).then(|| text.to_owned()),
                transition,
            });
        }
        Ok(sequences)
    }

    /// Positions of one frame in room axes, m, in the order of `joints`; empty where there is no such frame.
    pub fn positions_m(&self, frame: usize) -> &[Option<[f64; 3]>] {
        let width = self.joints.len();
        self.positions_m.get(frame * width..(frame + 1) * width).unwrap_or(&[])
    }

    /// The joints as sensors of a fault map, NaN where one is missing; in room axes, without orientations.
    pub fn poses(&self) -> Frames {
        Frames {
            sensors: self.joints.clone(),
            t_s: self.frames.iter().map(|frame| frame.t_s).collect(),
            positions_m: self.positions_m.iter().flat_map(|p| p.unwrap_or([f64::NAN; 3])).collect(),
            orientations_wxyz: Vec::new(),
        }
    }

    /// Writes the sequences in metres, y up: as [`SequenceOptions::default`] reads them. Labels are left out unless `labelled`.
    ///
    /// # Errors
    /// The file cannot be written; nothing is left behind.
    pub fn write(&self, path: &Path) -> Result<(), TableError> {
        let axes = |joint: &String| ["x", "y", "z"].map(|axis| format!("{joint}_{axis}"));
        let mut columns = vec!["t".to_owned()];
        columns.extend(self.joints.iter().flat_map(axes));
        if self.labelled {
            columns.extend(["label".to_owned(), "transition".to_owned()]);
        }
        let mut table = TableWriter::create(path, &columns)?;
        for (index, frame) in self.frames.iter().enumerate() {
            table.number(frame.t_s)?;
            for position in self.positions_m(index) {
                table.vector(position.map(|[x, y, z]| [x, z, -y]))?;
            }
            if self.labelled {
                table.text(frame.label.as_deref().unwrap_or(""))?;
                table.text(if frame.transition { "1" } else { "0" })?;
            }
            table.end_row()?;
        }
        table.finish()
    }
}
