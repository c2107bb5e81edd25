//! How much memory work takes, in a program whose global allocator is [`PeakAlloc`], as that of `main.rs`.
//!
//! ```text
//! #[global_allocator]
//! static MEMORY: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;
//! ```

use peak_alloc::PeakAlloc;

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
