//! CSV tables, and findings that name the cell that is wrong.
//!
//! Columns are found by name, in any order. A table is read to its end whatever is wrong with it, so
//! that one run reports everything.

mod findings;

pub use findings::{Finding, Findings};

use crate::disk;
use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer};
use std::collections::BTreeSet;
use std::path::Path;

/// What a cell must hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A whole number.
    Integer,
    /// A finite number.
    Number,
    /// A finite number, or nothing where it is not known.
    NumberOrEmpty,
    /// A finite number of at least zero, or nothing where it is not known.
    SigmaOrEmpty,
    /// A number of at least zero, `inf` where nothing determines it, or nothing where it is not known.
    SigmaOfResult,
    /// A text.
    Text,
    /// A text or nothing.
    TextOrEmpty,
}

/// A column of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name in the header.
    pub name: &'static str,
    /// What its cells hold.
    pub kind: Kind,
    /// Whether the table must have it.
    pub required: bool,
}

impl Column {
    /// A column that a table must have.
    pub const fn required(name: &'static str, kind: Kind) -> Self {
        Column { name, kind, required: true }
    }

    /// A column that a table may have.
    pub const fn optional(name: &'static str, kind: Kind) -> Self {
        Column { name, kind, required: false }
    }
}

/// A row of a table as a struct whose fields are named as the columns.
pub trait Row: DeserializeOwned {
    /// The columns.
    const COLUMNS: &'static [Column];
}

/// A table of cells as CSV, its header first.
pub fn written<R: IntoIterator<Item: AsRef<[u8]>>>(
    header: &[impl AsRef<[u8]>],
    rows: impl IntoIterator<Item = R>,
) -> Vec<u8> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(header).expect("writing to memory");
    for row in rows {
        writer.write_record(row).expect("a row as long as the header");
    }
    writer.into_inner().expect("writing to memory")
}

/// A row and the line of the file it begins on.
#[derive(Clone, Debug, PartialEq)]
pub struct Line<R> {
    /// The line, the header being 1.
    pub line: u64,
    /// The row.
    pub row: R,
}

/// Reads the table `file` in `folder`, adding what is wrong to `findings`. Rows that are wrong are
/// left out; `None` where there is no table to speak of.
pub fn read<R: Row>(folder: &Path, file: &str, findings: &mut Findings) -> Option<Vec<Line<R>>> {
    table_of(disk::read(&folder.join(file)), file, findings)
}

/// The table `file` of these bytes, or why they cannot be had; as [`read`].
pub fn table_of<R: Row>(
    bytes: std::io::Result<Vec<u8>>,
    file: &str,
    findings: &mut Findings,
) -> Option<Vec<Line<R>>> {
    match bytes {
        Ok(bytes) => parse(&bytes, file, findings),
        Err(error) => {
            findings.error(Finding::of_file(file, "a table that can be read", &error.to_string()));
            None
        }
    }
}

/// [`read`] of bytes.
pub fn parse<R: Row>(bytes: &[u8], file: &str, findings: &mut Findings) -> Option<Vec<Line<R>>> {
    let (header, records) = read_records(bytes, file, R::COLUMNS, findings)?;
    let mut rows = Vec::new();
    for (line, record) in records {
        let place = Place { file, line, header: &header, columns: R::COLUMNS };
        if !place.has_all_cells(&record, findings) {
            continue;
        }
        match record.deserialize(Some(&header)) {
            Ok(row) => rows.push(Line { line, row }),
            Err(error) => place.tell(&record, &error.to_string(), findings),
        }
    }
    Some(rows)
}

/// Lines of a file by byte offset. (The reader's own count is one behind after CR LF.)
struct LineCounter<'a> {
    bytes: &'a [u8],
    counted: usize,
    line: u64,
}

impl LineCounter<'_> {
    /// The line on which the first character at or after `offset` stands; offsets do not decrease.
    fn line_at(&mut self, offset: u64) -> u64 {
        let mut end = (offset as usize).min(self.bytes.len());
        while end < self.bytes.len() && matches!(self.bytes[end], b'\r' | b'\n') {
            end += 1;
        }
        let passed = &self.bytes[self.counted.min(end)..end];
        self.line += passed.iter().filter(|byte| **byte == b'\n').count() as u64;
        self.counted = end;
        self.line
    }
}

/// Where a record stands.
struct Place<'a> {
    file: &'a str,
    line: u64,
    header: &'a csv::StringRecord,
    columns: &'a [Column],
}

impl Place<'_> {
    /// Whether a record has as many cells as the header.
    fn has_all_cells(&self, record: &csv::StringRecord, findings: &mut Findings) -> bool {
        let right = record.len() == self.header.len();
        if !right {
            let wanted = format!("{} cells", self.header.len());
            findings.error(Finding::of_line(self.file, self.line, &wanted, &record.len().to_string()));
        }
        right
    }

    /// Tells what is wrong with it: its cells, else what the reader says.
    fn tell(&self, record: &csv::StringRecord, error: &str, findings: &mut Findings) {
        let Place { file, line, header, columns } = *self;
        let mut named = false;
        for (name, cell) in header.iter().zip(record) {
            let Some(column) = columns.iter().find(|column| column.name == name) else { continue };
            if let Err(wanted) = fits(column.kind, cell) {
                findings.error(Finding::of_cell(file, line, column.name, wanted, cell));
                named = true;
            }
        }
        if !named {
            findings.error(Finding::of_line(file, line, "a table row", error));
        }
    }
}

/// The header of a table and its other records, each with its line; `None` where a column is missing. What is the
/// same for every table stands here, so that it is compiled once.
fn read_records(
    bytes: &[u8],
    file: &str,
    columns: &[Column],
    findings: &mut Findings,
) -> Option<(csv::StringRecord, Vec<(u64, csv::StringRecord)>)> {
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).trim(csv::Trim::All).from_reader(bytes);
    let mut lines = LineCounter { bytes, counted: 0, line: 1 };
    let mut records = Vec::new();
    let mut record = csv::ByteRecord::new();
    loop {
        let begin = reader.position().byte();
        let read = reader.read_byte_record(&mut record);
        let line = lines.line_at(record.position().map_or(begin, |p| p.byte()));
        let text = match read {
            Ok(false) => break,
            Ok(true) => csv::StringRecord::from_byte_record(record.clone()),
            Err(error) => {
                findings.error(Finding::of_line(file, line, "a table row", &error.to_string()));
                break;
            }
        };
        match text {
            Ok(text) => records.push((line, text)),
            Err(error) => findings.error(Finding::of_line(file, line, "UTF-8 text", &error.to_string())),
        }
    }
    let mut records = records.into_iter();
    let header = records.next().map(|(_, header)| header).unwrap_or_default();
    if !header_is_right(&header, file, columns, findings) {
        return None;
    }
    Some((header, records.collect()))
}

fn header_is_right(
    header: &csv::StringRecord,
    file: &str,
    columns: &[Column],
    findings: &mut Findings,
) -> bool {
    let names: Vec<&str> = header.iter().collect();
    let mut right = true;
    for column in columns {
        let count = names.iter().filter(|name| **name == column.name).count();
        if count == 0 && column.required {
            let found = if names.is_empty() { "an empty file".to_owned() } else { names.join(",") };
            findings.error(Finding::of_cell(file, 1, column.name, "this column", &found));
            right = false;
        } else if count > 1 {
            findings.error(Finding::of_cell(file, 1, column.name, "this column once", &count.to_string()));
            right = false;
        }
    }
    let known: BTreeSet<&str> = columns.iter().map(|c| c.name).collect();
    for name in names.iter().filter(|name| !known.contains(*name)) {
        findings.warn(format!("{file}: column {name:?} is not known and was not read"));
    }
    right
}

/// Whether a cell holds what it must; the error says what was wanted.
fn fits(kind: Kind, cell: &str) -> Result<(), &'static str> {
    let finite = |cell: &str| cell.parse::<f64>().ok().filter(|value| value.is_finite());
    let (right, wanted) = match kind {
        Kind::Integer => (cell.parse::<i64>().is_ok(), "a whole number"),
        Kind::Number => (finite(cell).is_some(), "a finite number"),
        Kind::NumberOrEmpty => (cell.is_empty() || finite(cell).is_some(), "a finite number or nothing"),
        Kind::SigmaOrEmpty => {
            let right = cell.is_empty() || finite(cell).is_some_and(|v| v >= 0.0);
            (right, "a finite number of at least 0, or nothing")
        }
        Kind::SigmaOfResult => {
            let right = cell.is_empty() || cell.parse::<f64>().is_ok_and(|v| v >= 0.0);
            (right, "a number of at least 0, inf, or nothing")
        }
        Kind::Text => (!cell.is_empty(), "a text"),
        Kind::TextOrEmpty => (true, ""),
    };
    if right { Ok(()) } else { Err(wanted) }
}

/// A type that a cell can be read as.
pub trait Cell: Sized {
    /// What such a cell holds.
    const KIND: Kind;

    /// Reads it; what does not fit [`Cell::KIND`] is refused.
    fn read<'de, D: Deserializer<'de>>(cell: D) -> Result<Self, D::Error>;
}

/// A standard deviation, or `None` where it is not known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sigma(pub Option<f64>);

/// A standard deviation of a result: `inf` where nothing determines the quantity.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct ResultSigma(pub Option<f64>);

impl ResultSigma {
    /// The standard deviation of a quantity that is determined.
    pub fn known(self) -> Option<f64> {
        self.0.filter(|sigma| sigma.is_finite())
    }

    /// Whether nothing determines the quantity.
    pub fn is_open(self) -> bool {
        self.0.is_some_and(f64::is_infinite)
    }
}

/// Implements [`Cell`] for a type that is read as `$from` and must be `$right`.
macro_rules! cell {
    ($type:ty, $kind:ident, $from:ty, $right:expr, $into:expr) => {
        impl Cell for $type {
            const KIND: Kind = Kind::$kind;
            fn read<'de, D: Deserializer<'de>>(cell: D) -> Result<Self, D::Error> {
                let value = <$from>::deserialize(cell)?;
                let right: fn(&$from) -> bool = $right;
                if right(&value) { Ok($into(value)) } else { Err(D::Error::custom("does not fit")) }
            }
        }
    };
}

cell!(i64, Integer, i64, |_| true, |v| v);
cell!(f64, Number, f64, |v| v.is_finite(), |v| v);
cell!(Option<f64>, NumberOrEmpty, Option<f64>, |v| v.is_none_or(f64::is_finite), |v| v);
cell!(Sigma, SigmaOrEmpty, Option<f64>, |v| v.is_none_or(|v| v.is_finite() && v >= 0.0), Sigma);
cell!(ResultSigma, SigmaOfResult, Option<f64>, |v| v.is_none_or(|v| v >= 0.0), ResultSigma);
cell!(String, Text, String, |v| !v.is_empty(), |v| v);
cell!(Option<String>, TextOrEmpty, Option<String>, |_| true, |v| v);

/// Declares a struct for the rows of a table: one field for each column, named as it is.
macro_rules! input_row {
    ($(#[$doc:meta])* $name:ident { $($need:ident $column:ident: $type:ty),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Deserialize)]
        pub struct $name {
            $(
                #[doc = concat!("Column `", stringify!($column), "`.")]
                #[serde(default, deserialize_with = "crate::tables::Cell::read")]
                pub $column: $type,
            )*
        }

        impl $crate::tables::Row for $name {
            const COLUMNS: &'static [$crate::tables::Column] = &[
                $($crate::tables::Column::$need(
                    stringify!($column),
                    <$type as $crate::tables::Cell>::KIND,
                )),*
            ];
        }
    };
}
pub(crate) use input_row;

#[cfg(test)]
mod tests {
    use super::*;

    input_row!(Example {
        required frame: i64,
        required id: String,
        required x: f64,
        optional sigma: Sigma,
    });

    fn parsed(text: &[u8]) -> (Vec<Line<Example>>, Vec<String>, Vec<String>) {
        let mut findings = Findings::default();
        let rows = parse(text, "t.csv", &mut findings).unwrap_or_default();
        (rows, findings.errors().map(|f| f.to_string()).collect(), findings.warnings().to_vec())
    }

    fn row(frame: i64, id: &str, x: f64, sigma: Option<f64>) -> Example {
        Example { frame, id: id.to_owned(), x, sigma: Sigma(sigma) }
    }

    #[test]
    fn columns_are_found_by_name_behind_a_mark_and_any_line_end() {
        let (rows, errors, warnings) =
            parsed(b"\xef\xbb\xbfx,more,id,frame\r\n1.5e2,?,a,-3\r\n\r\n 2 ,,\"b,c\",4\r\n");
        assert_eq!(rows[0], Line { line: 2, row: row(-3, "a", 150.0, None) });
        assert_eq!(rows[1], Line { line: 4, row: row(4, "b,c", 2.0, None) });
        assert!(errors.is_empty());
        assert_eq!(warnings, ["t.csv: column \"more\" is not known and was not read"]);
    }

    #[test]
    fn an_empty_sigma_is_not_known() {
        let (rows, errors, _) = parsed(b"frame,id,x,sigma\n1,a,2,\n2,a,2,0\n");
        assert!(errors.is_empty());
        assert_eq!(rows[0].row.sigma, Sigma(None));
        assert_eq!(rows[1].row.sigma, Sigma(Some(0.0)));
    }

    #[test]
    fn everything_that_is_wrong_is_reported_at_once() {
        let (rows, errors, _) =
            parsed(b"frame,id,x,sigma\n1,a,nan,-1\n1.5,,1,\n2,b,1\n3,c,1,0.1\n4,\xff,1,1\n5,e,,inf\n");
        assert_eq!(rows, [Line { line: 5, row: row(3, "c", 1.0, Some(0.1)) }]);
        let wanted = [
            "t.csv:6: expected UTF-8 text, found",
            "t.csv:2: column x: expected a finite number, found \"nan\"",
            "t.csv:2: column sigma: expected a finite number of at least 0, or nothing, found \"-1\"",
            "t.csv:3: column frame: expected a whole number, found \"1.5\"",
            "t.csv:3: column id: expected a text, found \"\"",
            "t.csv:4: expected 4 cells, found \"3\"",
            "t.csv:7: column x: expected a finite number, found \"\"",
            "t.csv:7: column sigma: expected a finite number of at least 0, or nothing, found \"inf\"",
        ];
        assert_eq!(errors.len(), wanted.len(), "{errors:#?}");
        for (found, wanted) in errors.iter().zip(wanted) {
            assert!(found.starts_with(wanted), "{found}");
        }
    }

    #[test]
    fn a_missing_or_doubled_column_is_named() {
        let (_, errors, _) = parsed(b"frame,id,id,sigma\n");
        assert_eq!(errors.len(), 2, "{errors:?}");
        assert!(errors[0].starts_with("t.csv:1: column id: expected this column once"), "{errors:?}");
        assert!(errors[1].starts_with("t.csv:1: column x: expected this column, found"), "{errors:?}");
        let (_, errors, _) = parsed(b"");
        assert_eq!(errors.len(), 3);
        assert!(errors[0].contains("an empty file"));
    }
}
