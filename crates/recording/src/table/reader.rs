//! Rows of a CSV file, one at a time, with the line they stand on.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use csv_core::ReadRecordResult;
use flate2::bufread::MultiGzDecoder;

use super::TableError;

/// Longest row that is believed, bytes: a binary file has no lines.
const LONGEST_ROW: usize = 1 << 20;

/// Reads a CSV file row by row; plain or gzip, distinguished by its first bytes.
pub struct TableReader {
    file: String,
    source: Box<dyn BufRead>,
    parser: csv_core::Reader,
    columns: Vec<String>,
    /// Line of the current row's first byte, from 1.
    line: u64,
    /// Lines read so far.
    lines: u64,
    /// The current row: all cells in one string, and where each ends.
    cells: String,
    ends: Vec<usize>,
    // Buffers.
    text: Vec<u8>,
    output: Vec<u8>,
    output_ends: Vec<usize>,
}

impl TableReader {
    /// Opens a file and reads its header row.
    ///
    /// # Errors
    /// It cannot be read, has no header row, or is no UTF-8 text in lines of less than 1 MiB.
    pub fn open(path: &Path) -> Result<Self, TableError> {
        let name = path.display().to_string();
        match File::open(path) {
            Ok(file) => Self::new(&name, file),
            Err(source) => Err(TableError::Io { tried: "read", file: name, source }),
        }
    }

    /// Reads the header row of `source`; `file` is its name for errors.
    ///
    /// # Errors
    /// As [`TableReader::open`].
    pub fn new(file: &str, source: impl Read + 'static) -> Result<Self, TableError> {
        let mut source = BufReader::with_capacity(1 << 16, source);
        let failed = |source| TableError::Io { tried: "read", file: file.to_owned(), source };
        let zipped = source.fill_buf().map_err(failed)?.starts_with(&[0x1f, 0x8b]);
        let source: Box<dyn BufRead> =
            if zipped { Box::new(BufReader::new(MultiGzDecoder::new(source))) } else { Box::new(source) };
        let mut table = Self {
            file: file.to_owned(),
            source,
            parser: csv_core::Reader::new(),
            columns: Vec::new(),
            line: 0,
            lines: 0,
            cells: String::new(),
            ends: Vec::new(),
            text: Vec::new(),
            output: vec![0; 1 << 10],
            output_ends: vec![0; 1 << 5],
        };
        if !table.read_row()? {
            return Err(table.line_error(table.lines + 1, "a header row", "nothing"));
        }
        table.columns = (0..table.ends.len()).map(|column| table.text(column).to_owned()).collect();
        Ok(table)
    }

    /// Names of all columns, in order.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// Index of a column; `None` where it is not there.
    ///
    /// # Errors
    /// It is there twice.
    pub fn column(&self, name: &str) -> Result<Option<usize>, TableError> {
        let mut found = (0..self.columns.len()).filter(|column| self.columns[*column] == name);
        let first = found.next();
        match found.next() {
            None => Ok(first),
            Some(_) => Err(self.header_error(&format!("one column `{name}`"), "two of that name")),
        }
    }

    /// Indices of columns that must all be there.
    ///
    /// # Errors
    /// One is missing, or there twice.
    pub fn require<const N: usize>(&self, names: [&str; N]) -> Result<[usize; N], TableError> {
        let mut columns = [0; N];
        for (column, name) in columns.iter_mut().zip(names) {
            *column = self.column(name)?.ok_or_else(|| {
                let expected = format!("the columns {}, `{name}` among them", names.join(","));
                self.header_error(&expected, &self.columns_text())
            })?;
        }
        Ok(columns)
    }

    /// Indices of columns of which either all are there or none (`None`).
    ///
    /// # Errors
    /// Some are there and some are not, or one is there twice.
    pub fn all_or_none<const N: usize>(&self, names: [&str; N]) -> Result<Option<[usize; N]>, TableError> {
        for name in names {
            if self.column(name)?.is_some() {
                return self.require(names).map(Some);
            }
        }
        Ok(None)
    }

    /// Goes to the next row, over comments and empty lines; `false` at the end of the file.
    ///
    /// # Errors
    /// The file cannot be read or is no text, a quote is not closed, or a row has another number of cells than the header.
    pub fn next_row(&mut self) -> Result<bool, TableError> {
        if !self.read_row()? {
            return Ok(false);
        }
        if self.ends.len() != self.columns.len() {
            let expected = format!("{} cells as in the header", self.columns.len());
            return Err(self.line_error(self.line, &expected, &self.ends.len().to_string()));
        }
        Ok(true)
    }

    /// A cell of the current row, without the spaces around it; empty for a column that is not there.
    pub fn text(&self, column: usize) -> &str {
        let Some(&end) = self.ends.get(column) else { return "" };
        let start = if column == 0 { 0 } else { self.ends[column - 1] };
        self.cells.get(start..end).unwrap_or("").trim()
    }

    /// A number of the current row; `None` where the cell is empty.
    ///
    /// # Errors
    /// The cell holds something else, or a number that is not finite.
    pub fn number(&self, column: usize) -> Result<Option<f64>, TableError> {
        let text = self.text(column);
        if text.is_empty() {
            return Ok(None);
        }
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Some(number)),
            Ok(_) => Err(self.cell_error(column, "a finite number (or an empty cell for no value)")),
            Err(_) => Err(self.cell_error(column, "a number")),
        }
    }

    /// A number of the current row that must be there.
    ///
    /// # Errors
    /// The cell is empty or holds something else.
    pub fn required_number(&self, column: usize) -> Result<f64, TableError> {
        self.number(column)?.ok_or_else(|| self.cell_error(column, "a number"))
    }

    /// Numbers of the current row that belong together: all or none.
    ///
    /// # Errors
    /// Some are empty and some are not, or a cell holds something else.
    pub fn vector<const N: usize>(&self, columns: [usize; N]) -> Result<Option<[f64; N]>, TableError> {
        let mut vector = [0.0; N];
        let mut empty = None;
        let mut filled = false;
        for (value, column) in vector.iter_mut().zip(columns) {
            match self.number(column)? {
                Some(number) => (*value, filled) = (number, true),
                None => empty = Some(column),
            }
        }
        match (empty, filled) {
            (None, _) => Ok(Some(vector)),
            (Some(_), false) => Ok(None),
            (Some(column), true) => Err(self.cell_error(column, "a number, as in the columns beside it")),
        }
    }

    /// An error about a cell of the current row.
    pub fn cell_error(&self, column: usize, expected: &str) -> TableError {
        let found = self.text(column);
        TableError::Cell {
            file: self.file.clone(),
            line: self.line,
            column: self.columns.get(column).cloned().unwrap_or_default(),
            expected: expected.to_owned(),
            found: if found.is_empty() { "an empty cell".to_owned() } else { format!("`{}`", short(found)) },
        }
    }

    /// An error about the header row: to be asked for before the first row, for it names the current line.
    pub fn header_error(&self, expected: &str, found: &str) -> TableError {
        // Asked for before the first row is read: the header's line is still the current one.
        self.line_error(self.line, expected, found)
    }

    /// The header's columns, for errors.
    pub(super) fn columns_text(&self) -> String {
        format!("`{}`", short(&self.columns.join(",")))
    }

    fn line_error(&self, line: u64, expected: &str, found: &str) -> TableError {
        let (file, expected) = (self.file.clone(), expected.to_owned());
        TableError::Line { file, line, expected, found: found.to_owned() }
    }

    /// Reads the next row that is no comment; `false` at the end.
    fn read_row(&mut self) -> Result<bool, TableError> {
        loop {
            if !self.read_line()? {
                return Ok(false);
            }
            self.line = self.lines;
            if !self.text.starts_with(b"#") && !self.text.trim_ascii().is_empty() {
                break;
            }
        }
        self.parser.reset();
        let (mut input, mut written, mut ends) = (0, 0, 0);
        loop {
            let (result, read, wrote, ended) = self.parser.read_record(
                &self.text[input..],
                &mut self.output[written..],
                &mut self.output_ends[ends..],
            );
            (input, written, ends) = (input + read, written + wrote, ends + ended);
            match result {
                ReadRecordResult::Record => break,
                ReadRecordResult::OutputFull => self.output.resize(2 * self.output.len(), 0),
                ReadRecordResult::OutputEndsFull => self.output_ends.resize(2 * self.output_ends.len(), 0),
                // A quoted cell goes on in the next line.
                ReadRecordResult::InputEmpty => {
                    if written > LONGEST_ROW || !self.read_line()? {
                        return Err(self.line_error(self.line, "a closing quote", "none"));
                    }
                    input = 0;
                }
                ReadRecordResult::End => return Ok(false),
            }
        }
        let Ok(cells) = std::str::from_utf8(&self.output[..written]) else {
            return Err(self.line_error(self.line, "UTF-8 text", "other bytes"));
        };
        self.cells.clear();
        self.cells.push_str(cells);
        self.ends.clear();
        self.ends.extend_from_slice(&self.output_ends[..ends]);
        Ok(true)
    }

    /// Reads a line into `text`, always with one line feed at its end; `false` at the end of the file.
    fn read_line(&mut self) -> Result<bool, TableError> {
        self.text.clear();
        let read = self.source.by_ref().take(LONGEST_ROW as u64).read_until(b'\n', &mut self.text);
        match read {
            Err(source) => Err(TableError::Io { tried: "read", file: self.file.clone(), source }),
            Ok(0) => Ok(false),
            Ok(LONGEST_ROW) => Err(self.line_error(self.lines + 1, "lines of text", "a line without an end")),
            Ok(_) => {
                if self.lines == 0 && self.text.starts_with(b"\xef\xbb\xbf") {
                    self.text.drain(..3);
                }
                while self.text.ends_with(b"\n") || self.text.ends_with(b"\r") {
                    self.text.pop();
                }
                self.text.push(b'\n');
                self.lines += 1;
                Ok(true)
            }
        }
    }
}

fn short(text: &str) -> String {
    match text.char_indices().nth(80) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};

    use super::*;

    fn table(text: &str) -> TableReader {
        TableReader::new("a.csv", Cursor::new(text.as_bytes().to_vec())).unwrap()
    }

    fn error_of(text: &str, column: usize) -> String {
        let mut table = table(text);
        loop {
            match table
                .next_row()
                .and_then(|more| if more { table.number(column).map(|_| true) } else { Ok(false) })
            {
                Ok(true) => {}
                Ok(false) => panic!("no error in {text}"),
                Err(error) => return error.to_string(),
            }
        }
    }

    #[test]
    fn comments_empty_lines_spaces_quotes_and_line_ends_of_all_kinds_are_read() {
        let text = "\u{feff}# a comment\r\n\r\nt, name ,x\r\n# another\r\n1,\"a, \"\"b\"\"\",2\n\n3,\"two\nlines\",\n 5 , c,6";
        let mut table = table(text);
        assert_eq!(table.columns(), ["t", "name", "x"]);
        assert!(table.next_row().unwrap());
        assert_eq!((table.line, table.text(1)), (5, "a, \"b\""));
        assert!(table.next_row().unwrap());
        assert_eq!((table.line, table.text(1), table.number(2).unwrap()), (7, "two\nlines", None));
        assert!(table.next_row().unwrap());
        assert_eq!(
            (table.line, table.number(0).unwrap(), table.number(2).unwrap()),
            (9, Some(5.0), Some(6.0))
        );
        assert!(!table.next_row().unwrap());
        assert!(!table.next_row().unwrap());
    }

    #[test]
    fn errors_name_file_line_column_and_what_was_expected() {
        assert_eq!(
            error_of("# c\nt,x\n1,2\n\n3,abc\n", 1),
            "a.csv, line 5, column x: expected a number, found `abc`"
        );
        assert_eq!(
            error_of("t,x\n1,nan\n", 1),
            "a.csv, line 2, column x: expected a finite number (or an empty cell for no value), found `nan`"
        );
        assert_eq!(error_of("t,x\n1,2,3\n", 1), "a.csv, line 2: expected 2 cells as in the header, found 3");
        assert_eq!(error_of("t,x\n1,\"2\n", 0), "a.csv, line 2: expected a closing quote, found none");
    }

    #[test]
    fn given_a_wrong_header_it_says_what_is_missing() {
        let table = table("t;x;y\n");
        assert_eq!(
            table.require(["t", "x"]).unwrap_err().to_string(),
            "a.csv, line 1: expected the columns t,x, `t` among them, found `t;x;y`"
        );
        let doubled = self::table("x,x\n");
        assert!(doubled.column("x").unwrap_err().to_string().contains("two of that name"));
    }

    #[test]
    fn given_nothing_or_garbage_it_is_refused() {
        for text in [&b""[..], b"# only a comment\n", b"\n\n"] {
            let error = TableReader::new("a.csv", Cursor::new(text)).err().unwrap().to_string();
            assert!(error.contains("expected a header row, found nothing"), "{error}");
        }
        let error = TableReader::new("a.csv", Cursor::new(vec![0xff; 64])).err().unwrap();
        assert!(error.to_string().contains("UTF-8"), "{error}");
        let endless = TableReader::new("a.csv", Cursor::new(vec![b'a'; 2 * LONGEST_ROW])).err().unwrap();
        assert!(endless.to_string().contains("without an end"), "{endless}");
    }

    #[test]
    fn given_a_vector_with_a_gap_the_empty_cell_is_named() {
        let mut table = table("x,y\n1,\n,\n3,4\n");
        let columns = table.require(["x", "y"]).unwrap();
        table.next_row().unwrap();
        assert!(table.vector(columns).unwrap_err().to_string().contains("column y"));
        table.next_row().unwrap();
        assert_eq!(table.vector(columns).unwrap(), None);
        table.next_row().unwrap();
        assert_eq!(table.vector(columns).unwrap(), Some([3.0, 4.0]));
    }

    #[test]
    fn given_a_cut_gzip_file_it_is_an_error() {
        let mut zip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        for row in 0..1000 {
            writeln!(zip, "{row},{}", row * row).unwrap();
        }
        let bytes = zip.finish().unwrap();
        let cut = Cursor::new(bytes[..bytes.len() / 2].to_vec());
        let mut table = TableReader::new("a.csv.gz", cut).unwrap();
        let error = loop {
            match table.next_row() {
                Ok(true) => {}
                Ok(false) => panic!("the cut went unnoticed"),
                Err(error) => break error,
            }
        };
        assert!(matches!(error, TableError::Io { .. } | TableError::Line { .. }));
    }
}
