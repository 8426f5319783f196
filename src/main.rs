//! The program `trackbundle`.

use std::process::ExitCode;
use trackbundle::internals::cli::interrupts;

fn main() -> ExitCode {
    interrupts::watch();
    let code = trackbundle::run(std::env::args_os());
    interrupts::settle();
    ExitCode::from(code)
}
