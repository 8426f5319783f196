//! The program `trackbundle`.

use std::process::ExitCode;

fn main() -> ExitCode {
    trackbundle::cli::run()
}
