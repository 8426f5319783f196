//! A table of a TOML file, read key by key so that everything wrong with it is reported at once.

use crate::tables::{Finding, Findings};
use serde::Deserialize;
use serde::de::{DeserializeOwned, IntoDeserializer};
use std::cell::RefCell;
use std::collections::{BTreeSet, HashSet};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The text of a TOML file and what was found wrong with it.
pub struct Document<'a> {
    file: &'a str,
    text: &'a str,
    findings: RefCell<Findings>,
    is_strict: bool,
    /// Where each line ends.
    line_ends: Vec<usize>,
}

/// One table of it.
pub struct Section<'d, 't> {
    document: &'d Document<'d>,
    table: &'t DeTable<'d>,
    /// `camera`, say; empty at the top.
    path: String,
    line: u64,
    asked: RefCell<BTreeSet<&'static str>>,
}

impl<'a> Document<'a> {
    /// The document `file` (relative to its folder) of this text, which may begin with a byte-order mark.
    pub fn new(file: &'a str, text: &'a str) -> Self {
        let text = text.trim_start_matches('\u{feff}');
        let line_ends =
            text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect();
        Document { file, text, findings: RefCell::default(), is_strict: false, line_ends }
    }

    /// Makes a key that is not known a finding, not a warning.
    pub fn strict(mut self) -> Self {
        self.is_strict = true;
        self
    }

    /// Reads the whole document with `read`; `None`, with findings, where it is not TOML.
    pub fn read<T>(self, read: impl FnOnce(&Section) -> T) -> (Option<T>, Findings) {
        let (table, syntax_errors) = DeTable::parse_recoverable(self.text);
        for error in &syntax_errors {
            let line = self.line_of(error.span().map_or(0, |span| span.start));
            let shown = self.text.lines().nth(line as usize - 1).unwrap_or_default();
            let wanted = format!("valid TOML ({})", error.message().replace('\n', " "));
            self.error(Finding::of_line(self.file, line, &wanted, shown));
        }
        let result = syntax_errors.is_empty().then(|| {
            let section = Section {
                document: &self,
                table: table.get_ref(),
                path: String::new(),
                line: 1,
                asked: RefCell::default(),
            };
            let result = read(&section);
            section.warn_of_unknown_keys();
            result
        });
        (result, self.findings.into_inner())
    }

    fn line_of(&self, offset: usize) -> u64 {
        1 + self.line_ends.partition_point(|end| *end < offset) as u64
    }

    fn error(&self, finding: Finding) {
        self.findings.borrow_mut().error(finding);
    }
}

impl<'d, 't> Section<'d, 't> {
    fn value(&self, key: &'static str) -> Option<&'t Spanned<DeValue<'d>>> {
        self.asked.borrow_mut().insert(key);
        self.table.get(key)
    }

    fn key_path(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// Adds a finding about a key of this section.
    pub fn error(&self, key: &'static str, wanted: &str) {
        let document = self.document;
        let (line, found) = match self.value(key) {
            Some(value) => {
                let span = value.span();
                let found = document.text.get(span.clone()).unwrap_or_default();
                (document.line_of(span.start), found.lines().next().unwrap_or_default())
            }
            None => (self.line, "nothing"),
        };
        document.error(Finding::of_cell(document.file, line, &self.key_path(key), wanted, found));
    }

    /// Adds a warning.
    pub fn warn(&self, key: &str, text: &str) {
        let value = self.table.get(key);
        let line = value.map_or(self.line, |value| self.document.line_of(value.span().start));
        let warning = format!("{}:{line}: {} {text}", self.document.file, self.key_path(key));
        self.document.findings.borrow_mut().warn(warning);
    }

    /// A value of a type; a finding where it is there and is not of this type.
    fn get<T: DeserializeOwned>(&self, key: &'static str, wanted: &str) -> Option<T> {
        let value = self.value(key)?;
        let read = T::deserialize(value.clone().into_deserializer());
        read.map_err(|_| self.error(key, wanted)).ok()
    }

    /// A text.
    pub fn text(&self, key: &'static str) -> Option<String> {
        let text: String = self.get(key, "a text")?;
        if text.is_empty() {
            self.error(key, "a text that is not empty");
        }
        Some(text)
    }

    /// A text or a number; neither, without a finding, where it is something else.
    pub fn text_or_number(&self, key: &'static str) -> (Option<String>, Option<f64>) {
        let Some(value) = self.value(key) else { return (None, None) };
        let text = String::deserialize(value.clone().into_deserializer()).ok();
        (text, f64::deserialize(value.clone().into_deserializer()).ok())
    }

    /// Values of any kind, one at least.
    pub fn values(&self, key: &'static str) -> Option<Vec<toml::Value>> {
        let wanted = "an array of one value or more";
        let values: Vec<toml::Value> = self.get(key, wanted)?;
        if values.is_empty() {
            self.error(key, wanted);
        }
        Some(values)
    }

    /// Texts, one at least.
    pub fn texts(&self, key: &'static str) -> Option<Vec<String>> {
        let wanted = "an array of one text or more";
        let texts: Vec<String> = self.get(key, wanted)?;
        if texts.is_empty() {
            self.error(key, wanted);
        }
        Some(texts)
    }

    /// A table of values of any kind.
    pub fn free_table(&self, key: &'static str) -> Option<toml::Table> {
        self.get(key, "a table")
    }

    /// Checks that `format` is there and is 1.
    pub fn check_format(&self) {
        let format = self.required("format", "1", || self.integer("format"));
        if format.is_some_and(|format| format != 1) {
            self.error("format", "1");
        }
    }

    /// Yes or no.
    pub fn flag(&self, key: &'static str) -> Option<bool> {
        self.get(key, "true or false")
    }

    /// A whole number.
    pub fn integer(&self, key: &'static str) -> Option<i64> {
        self.get(key, "a whole number")
    }

    /// A finite number that is `right`.
    pub fn number(&self, key: &'static str, wanted: &str, right: impl Fn(f64) -> bool) -> Option<f64> {
        let value: f64 = self.get(key, wanted)?;
        if value.is_finite() && right(value) {
            Some(value)
        } else {
            self.error(key, wanted);
            None
        }
    }

    /// Any finite number.
    pub fn any_number(&self, key: &'static str) -> Option<f64> {
        self.number(key, "a finite number", |_| true)
    }

    /// A finite number above zero.
    pub fn positive(&self, key: &'static str) -> Option<f64> {
        self.number(key, "a finite number above 0", |v| v > 0.0)
    }

    /// A finite number of at least zero.
    pub fn not_negative(&self, key: &'static str) -> Option<f64> {
        self.number(key, "a finite number of at least 0", |v| v >= 0.0)
    }

    /// A value that must be there.
    pub fn required<T>(
        &self,
        key: &'static str,
        wanted: &str,
        read: impl FnOnce() -> Option<T>,
    ) -> Option<T> {
        if self.value(key).is_none() {
            self.error(key, wanted);
            return None;
        }
        read()
    }

    /// The line on which the value of a key stands.
    pub fn line(&self, key: &'static str) -> u64 {
        self.value(key).map_or(self.line, |value| self.document.line_of(value.span().start))
    }

    /// Whether a key is there.
    pub fn has(&self, key: &'static str) -> bool {
        self.value(key).is_some()
    }

    /// Reads a table within this one, if it is there.
    pub fn table<T>(&self, key: &'static str, read: impl FnOnce(&Section) -> T) -> Option<T> {
        let value = self.value(key)?;
        let path = self.key_path(key);
        self.read_table(value, path, read).or_else(|| {
            self.error(key, "a table");
            None
        })
    }

    /// Reads each table of an array of tables; none where it is not there.
    pub fn tables<T>(&self, key: &'static str, mut read: impl FnMut(&Section) -> T) -> Vec<T> {
        let Some(value) = self.value(key) else { return Vec::new() };
        let read_all = value.get_ref().as_array().and_then(|array| {
            let one = |value| self.read_table(value, self.key_path(key), &mut read);
            array.iter().map(one).collect::<Option<Vec<T>>>()
        });
        read_all.unwrap_or_else(|| {
            self.error(key, "an array of tables");
            Vec::new()
        })
    }

    /// Reads the tables of things that have an id, one at least; `kind` says what such a table looks like.
    pub fn things<T>(
        &self,
        key: &'static str,
        kind: &str,
        mut read: impl FnMut(&Section) -> Option<T>,
        id: impl Fn(&T) -> &str,
    ) -> Vec<T> {
        let mut things: Vec<T> = Vec::new();
        let mut ids = HashSet::new();
        let found = self.tables(key, |section| {
            let thing = read(section)?;
            if !ids.insert(id(&thing).to_owned()) {
                section.error("id", &format!("an id that no other {key} has"));
            }
            things.push(thing);
            Some(())
        });
        if found.is_empty() {
            self.error(key, &format!("at least one table {kind}"));
        }
        things
    }

    fn read_table<T>(
        &self,
        value: &Spanned<DeValue<'d>>,
        path: String,
        read: impl FnOnce(&Section) -> T,
    ) -> Option<T> {
        let section = Section {
            document: self.document,
            table: value.get_ref().as_table()?,
            path,
            line: self.document.line_of(value.span().start),
            asked: RefCell::default(),
        };
        let result = read(&section);
        section.warn_of_unknown_keys();
        Some(result)
    }

    fn warn_of_unknown_keys(&self) {
        let asked = self.asked.borrow().clone();
        for key in self.table.keys().map(|key| key.get_ref()) {
            if asked.contains(key.as_ref()) {
                continue;
            }
            if self.document.is_strict {
                let value = self.table.get(key.as_ref()).map_or(0, |value| value.span().start);
                let (file, line) = (self.document.file, self.document.line_of(value));
                self.document.error(Finding::of_cell(
                    file,
                    line,
                    &self.key_path(key),
                    "a key that is known",
                    key,
                ));
            } else {
                self.warn(key, "is not known and was not read");
            }
        }
    }
}
