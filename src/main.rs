//! The program `trackbundle`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(trackbundle::run(std::env::args_os()))
}
