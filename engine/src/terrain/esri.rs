//! ESRI ASCII grids: a header of keys and numbers, then heights, the northernmost row first.
//!
//! ```text
//! ncols         3
//! nrows         2
//! xllcorner     0        x of the left edge of the first cell; or xllcenter, of its centre
//! yllcorner     0        y of the lower edge of the last row; or yllcenter
//! cellsize      2        or dx and dy
//! NODATA_value  -9999    that is also the default
//! 1.0 1.1 1.2
//! 0.9 1.0 -9999
//! ```

use super::{Grid, GridFault};

const KEYS: [&str; 10] = [
    "ncols",
    "nrows",
    "xllcorner",
    "xllcenter",
    "yllcorner",
    "yllcenter",
    "cellsize",
    "dx",
    "dy",
    "nodata_value",
];
const DEFAULT_NO_DATA: f64 = -9999.0;

struct Entry<'t> {
    key: &'static str,
    line: u64,
    text: &'t str,
}

fn fault(line: u64, column: Option<&str>, wanted: &str, found: &str) -> GridFault {
    let (column, wanted, found) = (column.map(str::to_owned), wanted.to_owned(), found.to_owned());
    GridFault { line: Some(line), column, wanted, found }
}

/// The grid of a file; the error is everything that is wrong with it.
pub fn parse(bytes: &[u8]) -> Result<Grid, Vec<GridFault>> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()].iter().filter(|byte| **byte == b'\n').count() as u64;
        vec![fault(line, None, "an ESRI ASCII grid", "bytes that are no text")]
    })?;
    let text = text.trim_start_matches('\u{feff}');
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()).peekable();
    let mut header = Header::default();
    while let Some((line, text)) = lines.next_if(|(_, text)| !begins_with_number(text)) {
        header.read(line, text);
    }
    let end_of_header = lines.peek().map_or(text.lines().count().max(1) as u64, |(line, _)| *line);
    let layout = header.layout(end_of_header)?;
    let heights = read_heights(lines, &layout, text.lines().count() as u64)?;
    // The first height is that of the northernmost row.
    let [columns, rows] = layout.size;
    let north = layout.first_m[1] + layout.step_m[1] * (rows - 1) as f64;
    let step = [layout.step_m[0], -layout.step_m[1]];
    Grid::new([layout.first_m[0], north], step, [columns, rows], heights).map_err(|fault| vec![fault])
}

fn begins_with_number(line: &str) -> bool {
    line.split_whitespace().next().is_some_and(|word| word.parse::<f64>().is_ok())
}

/// Where heights lie.
struct Layout {
    size: [usize; 2],
    /// Centre of the cell in the south-west.
    first_m: [f64; 2],
    step_m: [f64; 2],
    no_data: f64,
}

#[derive(Default)]
struct Header<'t> {
    entries: Vec<Entry<'t>>,
    faults: Vec<GridFault>,
}

impl<'t> Header<'t> {
    fn read(&mut self, line: u64, text: &'t str) {
        let mut words = text.split_whitespace();
        let (word, value) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
        let Some(key) = KEYS.into_iter().find(|key| key.eq_ignore_ascii_case(word)) else {
            let wanted = format!("a key of the header ({}) or a row of heights", KEYS.join(", "));
            return self.faults.push(fault(line, None, &wanted, word));
        };
        if words.next().is_some() {
            self.faults.push(fault(line, Some(key), "one number", text.trim()));
        } else if self.find(key).is_some() {
            self.faults.push(fault(line, Some(key), "a key that is given once", word));
        } else {
            self.entries.push(Entry { key, line, text: value });
        }
    }

    fn find(&self, key: &str) -> Option<&Entry<'t>> {
        self.entries.iter().find(|entry| entry.key == key)
    }

    /// A number that is `right`, if its key is there.
    fn number(&mut self, key: &str, wanted: &str, right: impl Fn(f64) -> bool) -> Option<f64> {
        let Entry { line, text, .. } = *self.find(key)?;
        let value = text.parse::<f64>().ok().filter(|value| right(*value));
        if value.is_none() {
            self.faults.push(fault(line, Some(key), wanted, text));
        }
        value
    }

    /// One of two keys, with the number it has.
    fn one_of(
        &mut self,
        keys: [&'static str; 2],
        end: u64,
        wanted: &str,
        right: impl Fn(f64) -> bool + Copy,
    ) -> Option<(&'static str, f64)> {
        match keys.map(|key| self.find(key).map(|entry| entry.line)) {
            [None, None] => {
                self.faults.push(fault(end, Some(keys[0]), &format!("{wanted} in the header"), "nothing"));
                None
            }
            [Some(_), Some(line)] if keys[0] != keys[1] => {
                let wanted = format!("one of {} and {}", keys[0], keys[1]);
                self.faults.push(fault(line, Some(keys[1]), &wanted, "both"));
                None
            }
            [first, _] => {
                let key = keys[usize::from(first.is_none())];
                self.number(key, wanted, right).map(|value| (key, value))
            }
        }
    }

    fn layout(mut self, end: u64) -> Result<Layout, Vec<GridFault>> {
        let is_count = |v: f64| v >= 2.0 && v.fract() == 0.0 && v < 4e9;
        let count = |header: &mut Self, key| {
            header.one_of([key, key], end, "a whole number of at least 2", is_count).map(|(_, v)| v as usize)
        };
        let size = (count(&mut self, "ncols"), count(&mut self, "nrows"));
        let corner = |header: &mut Self, keys| header.one_of(keys, end, "a finite number", f64::is_finite);
        let west = corner(&mut self, ["xllcorner", "xllcenter"]);
        let south = corner(&mut self, ["yllcorner", "yllcenter"]);
        let is_step = |v: f64| v > 0.0 && v.is_finite();
        let mut step = |key| self.one_of(["cellsize", key], end, "a finite number above 0", is_step);
        let steps = (step("dx"), step("dy"));
        let no_data = match self.find("nodata_value") {
            None => Some(DEFAULT_NO_DATA),
            Some(_) => self.number("nodata_value", "a number", |_| true),
        };
        // cellsize was asked for twice.
        self.faults.dedup();
        if let ((Some(columns), Some(rows)), Some(west), Some(south), (Some(dx), Some(dy)), Some(no_data)) =
            (size, west, south, steps, no_data)
            && self.faults.is_empty()
        {
            let centre = |(key, at): (&str, f64), step: f64| {
                if key.ends_with("corner") { at + 0.5 * step } else { at }
            };
            let step_m = [dx.1, dy.1];
            let first_m = [centre(west, dx.1), centre(south, dy.1)];
            return Ok(Layout { size: [columns, rows], first_m, step_m, no_data });
        }
        Err(self.faults)
    }
}

/// Heights row by row, NaN where there is none. Rows may be broken into several lines, unless there
/// are as many lines as rows.
fn read_heights<'t>(
    lines: impl Iterator<Item = (u64, &'t str)>,
    layout: &Layout,
    last_line: u64,
) -> Result<Vec<f64>, Vec<GridFault>> {
    let [columns, rows] = layout.size;
    let mut faults = Vec::new();
    let mut heights = Vec::new();
    // Line and how many values it has.
    let mut counts = Vec::new();
    for (line, text) in lines {
        let mut count = 0;
        for word in text.split_whitespace() {
            count += 1;
            match word.parse::<f64>() {
                Ok(value) if value == layout.no_data => heights.push(f64::NAN),
                Ok(value) if value.is_nan() && layout.no_data.is_nan() => heights.push(f64::NAN),
                Ok(value) if value.is_finite() => heights.push(value),
                _ => {
                    heights.push(f64::NAN);
                    faults.push(fault(line, Some(&count.to_string()), "a finite number", word));
                }
            }
        }
        counts.push((line, count));
    }
    if counts.len() == rows {
        let wanted = format!("{columns} heights (ncols)");
        let wrong = counts.iter().filter(|(_, count)| *count != columns);
        faults.extend(wrong.map(|(line, count)| fault(*line, None, &wanted, &count.to_string())));
    } else if columns.checked_mul(rows) != Some(heights.len()) {
        let wanted = format!("{columns} x {rows} heights (ncols x nrows)");
        let found = format!("{} on {} lines", heights.len(), counts.len());
        faults.push(fault(counts.last().map_or(last_line, |(line, _)| *line), None, &wanted, &found));
    }
    if faults.is_empty() { Ok(heights) } else { Err(faults) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: &str = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 2\nNODATA_value -1\n\
                         1.0 1.5 2.0\n3.0 -1 5.0\n";

    fn faults(text: &str) -> Vec<(u64, Option<String>)> {
        let faults = parse(text.as_bytes()).unwrap_err();
        faults.into_iter().map(|fault| (fault.line.unwrap(), fault.column)).collect()
    }

    #[test]
    fn heights_stand_at_cell_centres_the_north_first() {
        let wanted = Grid::new([11.0, 21.0], [2.0, 2.0], [3, 2], vec![3.0, f64::NAN, 5.0, 1.0, 1.5, 2.0]);
        // No-data is not equal to itself.
        let same = |text: &str| {
            format!("{:?}", parse(text.as_bytes())) == format!("{:?}", wanted.clone().map_err(|f| vec![f]))
        };
        for text in [
            WHOLE.to_owned(),
            WHOLE.to_uppercase().replace('\n', "\r\n"),
            WHOLE.replace("xllcorner 10\nyllcorner 20", "yllcenter 21\n  XLLCENTER\t11"),
            WHOLE.replace("cellsize 2", "dx 2\ndy 2.0"),
            WHOLE.replace("NODATA_value -1\n", "").replace("-1 ", "-9999 "),
            WHOLE.replace("NODATA_value -1\n", "nodata_value nan\n").replace("-1 ", "nan "),
            WHOLE.replace("1.5 2.0\n3.0", "1.5\n2.0 3.0\n\n"),
            format!("\u{feff}{WHOLE}"),
        ] {
            assert!(same(&text), "{text} {:?}", parse(text.as_bytes()));
        }
        let oblong = parse(WHOLE.replace("cellsize 2", "dx 2\ndy 1").as_bytes()).unwrap();
        assert_eq!(oblong.corners_m(), [[11.0, 20.5], [15.0, 21.5]]);
    }

    #[test]
    fn what_is_wrong_is_shown_where_it_stands() {
        let column = |name: &str| Some(name.to_owned());
        let damaged = |from: &str, to: &str| faults(&WHOLE.replacen(from, to, 1));
        assert_eq!(damaged("ncols 3", "ncols three"), [(1, column("ncols"))]);
        assert_eq!(damaged("nrows 2", "nrows 2.5"), [(2, column("nrows"))]);
        assert_eq!(damaged("nrows 2", "nrows 1e300"), [(2, column("nrows"))]);
        assert_eq!(damaged("nrows 2\n", ""), [(6, column("nrows"))]);
        assert_eq!(damaged("cellsize 2", "cellsize 0"), [(5, column("cellsize"))]);
        assert_eq!(damaged("cellsize 2", "cellsize"), [(5, column("cellsize"))]);
        assert_eq!(damaged("cellsize 2\n", ""), [(6, column("cellsize"))]);
        assert_eq!(damaged("yllcorner 20", "yllcorner 20\nyllcenter 21"), [(5, column("yllcenter"))]);
        assert_eq!(damaged("cellsize 2", "cellsize 2\ncellsize 2"), [(6, column("cellsize"))]);
        assert_eq!(damaged("cellsize 2", "cellsize 2 2"), [(5, column("cellsize")), (7, column("cellsize"))]);
        assert_eq!(damaged("NODATA_value -1", "nodata -1"), [(6, None)]);
        assert_eq!(damaged("1.5", "high"), [(7, column("2"))]);
        assert_eq!(damaged("1.5", "1,5"), [(7, column("2"))]);
        assert_eq!(damaged("1.5", "inf"), [(7, column("2"))]);
        assert_eq!(damaged("1.5 ", ""), [(7, None)]);
        assert_eq!(damaged("5.0", "5.0 6.0"), [(8, None)]);
        assert_eq!(damaged("3.0 -1 5.0\n", ""), [(7, None)]);
        assert_eq!(faults("ncols 3\n").len(), 4);
        assert_eq!(faults("").len(), 5);
        assert_eq!(faults("a,b\n1,2\n")[0], (1, None));
        assert_eq!(parse(b"ncols 3\n\xff").unwrap_err()[0].line, Some(2));
    }
}
