//! XYZ: a point in a line, its coordinates first. They are separated by semicolons, or else by commas,
//! or else by blanks. `#` and `//` start comments, and the first line may name the columns.

use super::{Cloud, Refusal};
use nalgebra::Point3;

pub(super) fn read(bytes: &[u8]) -> Result<Cloud, Refusal> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut points = Vec::new();
    let mut is_first = true;
    for (at, line) in bytes.split(|byte| *byte == b'\n').enumerate() {
        let refused = |found: &str| Refusal { line: Some(at as u64 + 1), found: found.to_owned() };
        let line = std::str::from_utf8(line).map_err(|_| refused(&String::from_utf8_lossy(line)))?;
        let end = [line.find('#'), line.find("//")].into_iter().flatten().min().unwrap_or(line.len());
        let text = line[..end].trim();
        if text.is_empty() {
            continue;
        }
        let (cells, count) = first_three(text);
        let values = cells.map(|cell| cell.parse().ok());
        match values {
            [Some(x), Some(y), Some(z)] if [x, y, z].iter().all(|v: &f64| v.is_finite()) => {
                points.push(Point3::new(x, y, z));
            }
            [None, None, None] if is_first && count >= 3 && are_names(text, &cells) => {}
            _ => {
                let wrong = values.iter().position(|value| !value.is_some_and(f64::is_finite));
                return Err(refused(if count < 3 { text } else { cells[wrong.unwrap_or(0)] }));
            }
        }
        is_first = false;
    }
    Ok(Cloud { points, ..Cloud::default() })
}

/// The first three cells of a line, and how many there were of them.
fn first_three(text: &str) -> ([&str; 3], usize) {
    fn taken<'a>(found: impl Iterator<Item = &'a str>) -> ([&'a str; 3], usize) {
        let (mut cells, mut count) = ([""; 3], 0);
        for cell in found.take(3) {
            cells[count] = cell.trim();
            count += 1;
        }
        (cells, count)
    }
    match [';', ','].into_iter().find(|separator| text.contains(*separator)) {
        Some(separator) => taken(text.split(separator)),
        None => taken(text.split_whitespace()),
    }
}

/// Whether cells are names of columns, and no x, y or z stands at another place than its own.
fn are_names(text: &str, cells: &[&str; 3]) -> bool {
    let is_name = |cell: &str| cell.starts_with(|c: char| c.is_alphabetic() || c == '"' || c == '_');
    let unquoted = |cell: &str| cell.trim_matches('"').to_lowercase();
    let names: Vec<String> = text.split([';', ',', ' ', '\t']).map(unquoted).collect();
    let in_place =
        |(axis, cell): (&&str, &&str)| unquoted(cell) == **axis || !names.iter().any(|name| name == axis);
    cells.iter().all(|cell| is_name(cell)) && ["x", "y", "z"].iter().zip(cells).all(in_place)
}
