//! Scenarios that differ from one by some of their values.

use toml::{Table, Value as TomlValue};

/// A value of a scenario.
pub type Value = TomlValue;

/// What stands for a key that is taken out.
pub const ABSENT: &str = "absent";

/// The text of a scenario with other values: `vehicle.speed_mps` is that key of every `[[vehicle]]`. The text
/// [`ABSENT`] takes a key out. The error says what is not there to be changed.
pub fn vary(text: &str, changes: &[(&str, &Value)]) -> Result<String, String> {
    let mut table: Table = text.parse().map_err(|error: toml::de::Error| error.message().to_owned())?;
    for (path, value) in changes {
        let keys: Vec<&str> = path.split('.').collect();
        set(&mut table, &keys, value).map_err(|why| format!("{path}: {why}"))?;
    }
    Ok(table.to_string())
}

fn set(table: &mut Table, keys: &[&str], value: &Value) -> Result<(), String> {
    match keys {
        [] => Err("a key is wanted".to_owned()),
        [key] => {
            if value.as_str() == Some(ABSENT) {
                table.remove(*key);
            } else {
                table.insert((*key).to_owned(), value.clone());
            }
            Ok(())
        }
        [key, rest @ ..] => {
            let inner = table.entry((*key).to_owned()).or_insert_with(|| Value::Table(Table::new()));
            match inner {
                Value::Table(inner) => set(inner, rest, value),
                Value::Array(all) => all.iter_mut().try_for_each(|one| match one {
                    Value::Table(inner) => set(inner, rest, value),
                    _ => Err(format!("{key} is no table")),
                }),
                _ => Err(format!("{key} is no table")),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_set_in_tables_and_in_all_of_an_array() {
        let text = "a = 1\n[t]\nx = 1\n[[v]]\ns = 1\n[[v]]\ns = 2\nh = 3\n";
        let five = Value::Integer(5);
        let absent = Value::String(ABSENT.to_owned());
        let changed =
            vary(text, &[("t.x", &five), ("v.s", &five), ("v.h", &absent), ("n.k", &five)]).unwrap();
        let wanted: Table = "a = 1\n[t]\nx = 5\n[[v]]\ns = 5\n[[v]]\ns = 5\n[n]\nk = 5\n".parse().unwrap();
        assert_eq!(changed.parse::<Table>().unwrap(), wanted);
        assert!(vary(text, &[("a.b", &five)]).is_err());
    }
}
