//! What is wrong with an input, and what is only odd.

use std::fmt;

/// Something that makes an input invalid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The file, relative to the problem folder.
    pub file: String,
    /// The line in it, from 1.
    pub line: Option<u64>,
    /// The column of a table, or the key of a setting.
    pub column: Option<String>,
    /// What was wanted.
    pub wanted: String,
    /// What stands there.
    pub found: String,
}

impl Finding {
    /// About a file as a whole.
    pub fn of_file(file: &str, wanted: &str, found: &str) -> Self {
        let (line, column) = (None, None);
        Finding { file: file.to_owned(), line, column, wanted: wanted.to_owned(), found: found.to_owned() }
    }

    /// About a line.
    pub fn of_line(file: &str, line: u64, wanted: &str, found: &str) -> Self {
        Finding { line: Some(line), ..Finding::of_file(file, wanted, found) }
    }

    /// About a cell of a table or a setting.
    pub fn of_cell(file: &str, line: u64, column: &str, wanted: &str, found: &str) -> Self {
        Finding { column: Some(column.to_owned()), ..Finding::of_line(file, line, wanted, found) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if let Some(column) = &self.column {
            write!(f, ": column {column}")?;
        }
        write!(f, ": expected {}, found {:?}", self.wanted, self.found)
    }
}

/// Everything that is wrong or odd, in the order in which it was found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    errors: Vec<Finding>,
    warnings: Vec<String>,
}

impl From<Finding> for Findings {
    fn from(finding: Finding) -> Self {
        let mut findings = Findings::default();
        findings.error(finding);
        findings
    }
}

impl Findings {
    /// Adds something that makes the input invalid.
    pub fn error(&mut self, finding: Finding) {
        self.errors.push(finding);
    }

    /// Adds something that is odd but does no harm.
    pub fn warn(&mut self, warning: String) {
        self.warnings.push(warning);
    }

    /// What makes the input invalid.
    pub fn errors(&self) -> impl ExactSizeIterator<Item = &Finding> {
        self.errors.iter()
    }

    /// What is only odd.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Whether the input is invalid.
    pub fn is_invalid(&self) -> bool {
        !self.errors.is_empty()
    }

    /// Adds the findings of another part of the input.
    pub fn append(&mut self, mut other: Findings) {
        self.errors.append(&mut other.errors);
        self.warnings.append(&mut other.warnings);
    }
}

impl fmt::Display for Findings {
    /// One line for each error, file by file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut files: Vec<&str> = Vec::new();
        for finding in &self.errors {
            if !files.contains(&finding.file.as_str()) {
                files.push(&finding.file);
            }
        }
        for file in files {
            for finding in self.errors.iter().filter(|e| e.file == file) {
                writeln!(f, "{finding}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finding_names_the_place_the_wish_and_the_value() {
        let finding = Finding::of_cell("a.csv", 7, "u", "a finite number", "nan");
        assert_eq!(finding.to_string(), "a.csv:7: column u: expected a finite number, found \"nan\"");
    }

    #[test]
    fn findings_are_listed_file_by_file() {
        let mut findings = Findings::default();
        for line in 0..60 {
            findings.error(Finding::of_line("a.csv", line, "x", "y"));
            findings.error(Finding::of_line("b.csv", line, "x", "y"));
        }
        let text = findings.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 120);
        assert!(lines[59].starts_with("a.csv:59") && lines[60].starts_with("b.csv:0"), "{lines:?}");
    }
}
