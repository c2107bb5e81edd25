//! The tests of what needs the SDK of the rerun viewer: `cargo test --release --features rerun --test viewer`.

#[path = "../common/mod.rs"]
#[allow(dead_code, reason = "shared with the other tests")]
mod common;
mod live;
mod recording;
#[path = "../synthetic_run/mod.rs"]
#[allow(dead_code, reason = "shared with the other tests")]
mod synthetic_run;
