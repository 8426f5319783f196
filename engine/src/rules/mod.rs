//! Constants of a stage: numbers with a name, a unit, a default and a reason, declared in one place.
//!
//! `rules!` makes of such a declaration a struct with these defaults, and the table from which
//! `docs/constants.md` is made ([`page`]).

/// One constant of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    /// Its name.
    pub name: &'static str,
    /// Its unit, or what it is a share or a number of.
    pub unit: &'static str,
    /// Its default, as it is written in the source.
    pub default: &'static str,
    /// What it decides.
    pub meaning: &'static str,
}

/// The constants of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// The name of their type.
    pub name: &'static str,
    /// The module of their type.
    pub module: &'static str,
    /// What they are for.
    pub purpose: &'static str,
    /// One for each constant, in the order of declaration.
    pub rules: &'static [Rule],
}

/// Declares the constants of a stage:
///
/// ```text
/// rules! {
///     /// What they are for.
///     pub struct ResectionRules {
///         /// What it decides.
///         least_targets: usize = 3, "targets";
///     }
/// }
/// ```
#[macro_export]
macro_rules! rules {
    ($(#[doc = $purpose:literal])* $visibility:vis struct $name:ident {
        $($(#[doc = $meaning:literal])* $field:ident: $type:ty = $default:expr, $unit:literal;)*
    }) => {
        $(#[doc = $purpose])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        $visibility struct $name {
            $($(#[doc = $meaning])* #[doc = concat!("\\[", $unit, "\\]")] pub $field: $type,)*
        }

        impl $name {
            /// All as they are unless somebody wants them otherwise.
            pub const DEFAULT: $name = $name { $($field: $default,)* };

            /// Their page.
            pub const PAGE: $crate::rules::Rules = $crate::rules::Rules {
                name: stringify!($name),
                module: module_path!(),
                purpose: concat!($($purpose),*),
                rules: &[$($crate::rules::Rule {
                    name: stringify!($field),
                    unit: $unit,
                    default: stringify!($default),
                    meaning: concat!($($meaning),*),
                }),*],
            };
        }

        impl Default for $name {
            fn default() -> Self {
                $name::DEFAULT
            }
        }
    };
}

pub use rules;

/// The tables of these constants in Markdown.
pub fn page(all: &[Rules]) -> String {
    let mut page = String::new();
    for rules in all {
        // Of whichever package, as the floor plan has it.
        let path = rules.module.split_once("::").map_or(rules.module, |(_, path)| path);
        let module = path.strip_prefix("internals::").unwrap_or(path);
        page +=
            &format!("\n## `{}` ({})\n\n{}\n\n", rules.name, module.replace("::", "/"), plain(rules.purpose));
        page += "| constant | default | unit | what it decides |\n|---|---|---|---|\n";
        for rule in rules.rules {
            let meaning = plain(rule.meaning);
            let default = rule.default.replace("std::f64::consts::", "");
            page += &format!("| `{}` | {default} | {} | {meaning} |\n", rule.name, rule.unit);
        }
    }
    page
}

/// A documentation text without links to the source and signs that Markdown tables read otherwise.
fn plain(text: &str) -> String {
    text.trim().replace("[`", "`").replace("`]", "`").replace('|', "\\|")
}

#[cfg(test)]
mod tests {
    use super::*;

    rules! {
        /// Made for
        /// the test.
        struct Few {
            /// How many
            /// [`Rule`]s | or none.
            most_rules: usize = 3, "rules";
            /// How long.
            length_m: f64 = 1e-3, "m";
        }
    }

    #[test]
    fn a_declaration_is_a_type_and_a_page() {
        assert_eq!(Few::default(), Few { most_rules: 3, length_m: 0.001 });
        let page = page(&[Few::PAGE]);
        let wanted = "\n## `Few` (rules/tests)\n\nMade for the test.\n\n\
            | constant | default | unit | what it decides |\n|---|---|---|---|\n\
            | `most_rules` | 3 | rules | How many `Rule`s \\| or none. |\n\
            | `length_m` | 1e-3 | m | How long. |\n";
        assert_eq!(page, wanted);
    }
}
