//! What is wrong with an input, and what is only odd.

use std::collections::BTreeMap;
use std::fmt;

/// Of errors of one kind the first are told one by one, the others by their number.
const TOLD: usize = 10;
/// Kinds of errors of a file are told apart as long as there are no more in all.
const MOST_KINDS: usize = 1000;
/// Warnings are told as long as there are no more.
const MOST_WARNINGS: usize = 1000;
/// A value that stands somewhere is told up to this length \[character\].
const MOST_FOUND: usize = 200;

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
        write!(f, ": expected {}, found ", self.wanted)?;
        match self.found.char_indices().nth(MOST_FOUND) {
            None => write!(f, "{:?}", self.found),
            Some((end, _)) => write!(f, "{:?} and more", &self.found[..end]),
        }
    }
}

/// A kind of errors: the file, the column, and what was wanted.
type Kind = (String, Option<String>, String);

/// Everything that is wrong or odd, in the order in which it was found; of many alike the first, and how many more.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    errors: Vec<Finding>,
    counts: BTreeMap<Kind, usize>,
    warnings: Vec<String>,
    more_warnings: usize,
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
        let mut kind = (finding.file.clone(), finding.column.clone(), finding.wanted.clone());
        if self.counts.len() >= MOST_KINDS && !self.counts.contains_key(&kind) {
            kind = (finding.file.clone(), None, String::new());
        }
        let count = self.counts.entry(kind).or_default();
        *count += 1;
        if *count <= TOLD {
            self.errors.push(finding);
        }
    }

    /// Adds something that is odd but does no harm.
    pub fn warn(&mut self, warning: String) {
        if self.warnings.len() < MOST_WARNINGS {
            self.warnings.push(warning);
        } else {
            self.warn_of_more(1);
        }
    }

    /// What makes the input invalid; of many alike the first.
    pub fn errors(&self) -> impl ExactSizeIterator<Item = &Finding> {
        self.errors.iter()
    }

    /// How many errors there are in all.
    pub fn count(&self) -> usize {
        self.counts.values().sum()
    }

    /// What is only odd; of very many the first, and how many more.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Whether the input is invalid.
    pub fn is_invalid(&self) -> bool {
        !self.errors.is_empty()
    }

    /// Adds the findings of another part of the input.
    pub fn append(&mut self, other: Findings) {
        let Findings { errors, mut counts, warnings, more_warnings } = other;
        for finding in errors {
            let own = (finding.file.clone(), finding.column.clone(), finding.wanted.clone());
            let kind = if counts.contains_key(&own) { own } else { (own.0, None, String::new()) };
            if let Some(count) = counts.get_mut(&kind) {
                *count -= 1;
            }
            self.error(finding);
        }
        for (kind, count) in counts {
            *self.counts.entry(kind).or_default() += count;
        }
        warnings.into_iter().take(MOST_WARNINGS).for_each(|warning| self.warn(warning));
        self.warn_of_more(more_warnings);
    }

    fn warn_of_more(&mut self, more: usize) {
        self.more_warnings += more;
        if self.more_warnings > 0 {
            self.warnings.truncate(MOST_WARNINGS);
            self.warnings.push(format!("{} more warnings", self.more_warnings));
        }
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
            for ((of, column, wanted), count) in &self.counts {
                if of != file || *count <= TOLD {
                    continue;
                }
                let column = column.as_ref().map_or_else(String::new, |column| format!(" column {column}:"));
                let wanted = if wanted.is_empty() { "other values" } else { wanted };
                writeln!(f, "{of}:{column} expected {wanted}, {} more times", count - TOLD)?;
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
    fn findings_are_listed_file_by_file_and_many_alike_are_counted() {
        let of_file = |file: &str| {
            let mut findings = Findings::default();
            for line in 0..60 {
                findings.error(Finding::of_line(file, line, "x", "y"));
                findings.error(Finding::of_cell(file, line, "u", "z", "y"));
            }
            findings
        };
        let mut findings = of_file("a.csv");
        findings.append(of_file("b.csv"));
        findings.append(of_file("a.csv"));
        assert_eq!((findings.count(), findings.errors().len()), (360, 40));
        let text = findings.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 44, "{lines:#?}");
        assert!(lines[19].starts_with("a.csv:9: column u") && lines[22].starts_with("b.csv:0"), "{lines:#?}");
        assert_eq!(lines[20], "a.csv: expected x, 110 more times");
        assert_eq!(lines[43], "b.csv: column u: expected z, 50 more times");
    }

    #[test]
    fn there_is_a_bound_to_what_is_told() {
        let mut findings = Findings::default();
        for at in 0..3000 {
            findings.error(Finding::of_file("a.csv", &format!("kind {at}"), "y"));
            findings.warn(format!("warning {at}"));
        }
        findings.append(findings.clone());
        assert_eq!(findings.count(), 6000);
        assert!(findings.to_string().lines().count() < 2020, "{}", findings.to_string().lines().count());
        assert_eq!(findings.warnings().len(), 1001);
        assert_eq!(findings.warnings()[1000], "5000 more warnings");
        let long = Finding::of_file("a.csv", "short", &"\u{e4}".repeat(10_000)).to_string();
        assert!(long.ends_with("\u{e4}\" and more") && long.chars().count() < 300, "{long}");
    }
}
