//! Why there is no sounding.

use crate::sensors::SensorError;

/// Why there is no sounding.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SoundingError {
    /// A table is not what it should be.
    #[error("{0}")]
    Table(#[from] isobar_obs::table::TableError),
    /// A file cannot be read, or a flight does not determine what is asked.
    #[error("{file}: {reason}")]
    File {
        /// The file, as shown.
        file: String,
        /// Why not.
        reason: String,
    },
    /// The database.
    #[error(transparent)]
    Sensors(#[from] SensorError),
}
