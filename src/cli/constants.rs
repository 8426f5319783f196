//! `docs/constants.md` is made of the constants that the program runs with. After a change of one, write it anew:
//!
//! ```text
//! WRITE_DOCS=1 cargo test --no-default-features --features program --lib cli::constants
//! ```

use crate::rules::page;
use crate::{diagnose, evaluate, initialise, refine, terrain};

const HEAD: &str = "# Constants

What decides between two ways, and where something ends. Nobody has to set any of them; they are listed for those who want
to know, or to change the program. Options of the commands are in `trackbundle COMMAND --help`.

This page is made from the types in the sources and held against them by a test. After a change, write it anew:

    WRITE_DOCS=1 cargo test --no-default-features --features program --lib cli::constants
";

#[test]
fn the_page_of_constants_is_what_the_types_say() {
    let all = [
        terrain::constants(),
        initialise::constants(),
        refine::constants(),
        diagnose::constants(),
        evaluate::constants(),
    ];
    let wanted = format!("{HEAD}{}", page(&all.concat()));
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/constants.md");
    if std::env::var_os("WRITE_DOCS").is_some() {
        std::fs::write(&file, &wanted).unwrap();
    }
    let found = std::fs::read_to_string(&file).unwrap();
    let differs = found.lines().zip(wanted.lines()).find(|(found, wanted)| found != wanted);
    assert!(found == wanted, "docs/constants.md is not what the types say: {differs:?}");
}
