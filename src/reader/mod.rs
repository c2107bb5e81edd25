//! Typed reading of a TOML file in which every fault is shown with its place.
//!
//! A [`Section`] is a table, a [`Field`] a key of it with its value, and a [`Key`] says once what a key means, what it may
//! be and what holds without it: the reader checks by it, and the reference of keys is written from it.

mod error;
mod faults;
mod field;
pub(crate) mod fields;
pub(crate) mod files;
mod form;
mod key;
mod netcdf;
mod section;

pub use error::ScenarioError;
pub(crate) use error::{FileName, SourceFile};
pub(crate) use faults::{Faults, of_keys, read_all};
pub(crate) use field::{Field, Limits};
pub(crate) use form::{Form, KIND, KindForm};
pub(crate) use key::{Absent, AnyKey, Choice, Described, Integer, Key, OrTable, OrWord, Table, Value, Whole, YesNo};
pub(crate) use netcdf::{Plane, StateFile, observations};
pub(crate) use section::{Section, parse};

/// Result of reading a part of a scenario.
pub(crate) type Read<T> = Result<T, ScenarioError>;
