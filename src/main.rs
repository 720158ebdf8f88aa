//! The program `leafbench`: it runs the command line of the library and ends with its exit code.

use std::process::ExitCode;

fn main() -> ExitCode {
    leafbench::main()
}
