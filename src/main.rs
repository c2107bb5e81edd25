//! The program.

use peak_alloc::PeakAlloc;
use std::process::ExitCode;

/// Counts the memory of each method.
#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

fn main() -> ExitCode {
    isobar::cli::main()
}
