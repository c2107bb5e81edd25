//! How much memory work takes, in a program whose global allocator is [`PeakAlloc`], as that of `main.rs`.
//!
//! ```text
//! #[global_allocator]
//! static MEMORY: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;
//! ```

use peak_alloc::PeakAlloc;
use sysinfo::{CGroupLimits, System};

/// Memory beyond what was in use before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Memory {
    /// The most that was in use at one time \[bytes\].
    pub peak_bytes: i64,
    /// What is still in use afterwards; negative if memory was freed \[bytes\].
    pub left_bytes: i64,
}

/// Whether memory is counted: whether the program has installed the allocator that counts it. Without it every
/// [`Memory`] is zero.
pub fn is_counted() -> bool {
    // No program comes as far as this without a single allocation.
    PeakAlloc.current_usage() > 0
}

/// The result of `work`, and the memory that it took. What other threads allocate at the same time is counted as well.
pub fn measured<T>(work: impl FnOnce() -> T) -> (T, Memory) {
    PeakAlloc.reset_peak_usage();
    let before = PeakAlloc.current_usage() as i64;
    let result = work();
    let memory = Memory {
        peak_bytes: PeakAlloc.peak_usage() as i64 - before,
        left_bytes: PeakAlloc.current_usage() as i64 - before,
    };
    (result, memory)
}

/// Memory that can be had without swapping, also within the limits of a container; `None` where the system does not report it
/// \[bytes\].
pub fn available_bytes() -> Option<u64> {
    of_system(System::available_memory, |limits| limits.free_memory)
}

/// All memory of the machine, or of the container; `None` where the system does not report it \[bytes\].
pub fn total_bytes() -> Option<u64> {
    of_system(System::total_memory, |limits| limits.total_memory)
}

/// The lesser of what the machine and its container have; `None` where the system does not report it \[bytes\].
fn of_system(of_machine: impl Fn(&System) -> u64, of_container: impl Fn(&CGroupLimits) -> u64) -> Option<u64> {
    let mut system = System::new().ok()?;
    system.refresh_memory();
    let of_machine = of_machine(&system);
    Some(system.cgroup_limits().map_or(of_machine, |limits| of_container(&limits).min(of_machine)))
}

/// A number of bytes with three digits and a unit: `22.5 TB`.
pub fn in_words(bytes: f64) -> String {
    let units = [(1e15, "PB"), (1e12, "TB"), (1e9, "GB"), (1e6, "MB")];
    let (size, unit) = units.into_iter().find(|(size, _)| bytes >= *size).unwrap_or((1e3, "kB"));
    let value = bytes / size;
    let decimals = if value < 9.995 { 2 } else { usize::from(value < 99.95) };
    format!("{value:.decimals$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_three_digits_and_a_unit() {
        for (bytes, words) in [(22.5e12, "22.5 TB"), (1.234e9, "1.23 GB"), (123.4e6, "123 MB"), (8e2, "0.80 kB")] {
            assert_eq!(in_words(bytes), words);
        }
    }
}
