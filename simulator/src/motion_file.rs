//! Files of motion before they are understood: which kind they are of, and the cells of tables.

use std::path::{Path, PathBuf};

use crate::bvh::BvhError;

/// Why a file of motion was refused.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// Its name says neither CSV nor BVH.
    #[error("{0}: the name should end in .csv, .csv.gz or .bvh")]
    Kind(PathBuf),
    /// It is no CSV table.
    #[error("{path}: {source}")]
    Csv {
        /// Which file.
        path: PathBuf,
        /// What is wrong, with the line.
        source: csv::Error,
    },
    /// A row of a CSV file makes no sense.
    #[error("{path}: line {line}, column {column}: {problem}")]
    Row {
        /// Which file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// Name of the column.
        column: String,
        /// What was expected and what stands there.
        problem: String,
    },
    /// A BVH file makes no sense.
    #[error("{path}: {source}")]
    Bvh {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and where.
        source: BvhError,
    },
}

/// What stands in a file.
pub(crate) enum MotionText {
    Bvh(String),
    /// CSV, unpacked.
    Table(Vec<u8>),
}

impl MotionText {
    /// Reads `.bvh`, `.csv` or `.csv.gz`.
    pub(crate) fn read(path: &Path) -> Result<Self, FileError> {
        let io = |source| FileError::Io { path: path.to_owned(), source };
        let name = path.to_string_lossy().to_lowercase();
        let bytes = std::fs::read(path).map_err(io)?;
        if name.ends_with(".bvh") {
            Ok(Self::Bvh(String::from_utf8_lossy(&bytes).into_owned()))
        } else if name.ends_with(".csv.gz") {
            let mut plain = Vec::new();
            let mut decoder = flate2::read::MultiGzDecoder::new(bytes.as_slice());
            std::io::Read::read_to_end(&mut decoder, &mut plain).map_err(io)?;
            Ok(Self::Table(plain))
        } else if name.ends_with(".csv") {
            Ok(Self::Table(bytes))
        } else {
            Err(FileError::Kind(path.to_owned()))
        }
    }
}

/// The header of a table, and its cells by it.
pub(crate) struct Cells<'a> {
    path: &'a Path,
    pub(crate) header: csv::StringRecord,
}

impl<'a> Cells<'a> {
    /// Lines that begin with # are comments.
    pub(crate) fn open(path: &'a Path, bytes: &'a [u8]) -> Result<(csv::Reader<&'a [u8]>, Self), FileError> {
        let mut reader =
            csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_reader(bytes);
        let header =
            reader.headers().map_err(|source| FileError::Csv { path: path.to_owned(), source })?.clone();
        Ok((reader, Self { path, header }))
    }

    /// What is no CSV.
    pub(crate) fn refused(&self, source: csv::Error) -> FileError {
        FileError::Csv { path: self.path.to_owned(), source }
    }

    pub(crate) fn wrong(&self, line: u64, column: &str, problem: String) -> FileError {
        FileError::Row { path: self.path.to_owned(), line, column: column.to_owned(), problem }
    }

    /// A finite number.
    pub(crate) fn number(&self, record: &csv::StringRecord, column: usize) -> Result<f64, FileError> {
        let cell = record.get(column).unwrap_or_default();
        let number = cell.parse::<f64>().ok().filter(|x| x.is_finite());
        number.ok_or_else(|| {
            let line = record.position().map_or(0, csv::Position::line);
            self.wrong(line, &self.header[column], format!("expected a number, found `{cell}`"))
        })
    }
}
