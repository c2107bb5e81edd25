//! `[quality_control]`: how the values of observations are checked.

use super::grid::GridSettings;
use crate::kinds::covariances::Components;
use crate::reader::{Limits, Read, Section};
use isobar_obs::{Faults, Network, QualityControl};

/// Reads `[quality_control]`: how the values of observations are checked; `None` if it is absent and no network
/// has faults.
///
/// The length is that of the background error unless it is given, the limit that of [`isobar_obs::quality::LIMIT`].
pub(super) fn read(
    root: &Section<'_>,
    background_error: &Components,
    grid: &GridSettings,
    networks: &[Network],
) -> Read<Option<QualityControl>> {
    let lengths = background_error.iter().filter_map(|component| component.length_m());
    let cell_m = grid.grid.dx_m.max(grid.grid.dy_m);
    let control = QualityControl { length_m: lengths.fold(cell_m, f64::max), limit: isobar_obs::quality::LIMIT };
    let Some(field) = root.optional("quality_control") else {
        let has_faults = networks.iter().any(|network| network.faults != Faults::NONE);
        return Ok(has_faults.then_some(control));
    };
    let section = field.section(&["gross_error_limit", "length_km"])?;
    Ok(Some(QualityControl {
        limit: section.number_or("gross_error_limit", control.limit, Limits::Between(2.0, 1e6))?,
        length_m: section.number_or("length_km", control.length_m / 1e3, Limits::Between(1e-3, 1e5))? * 1e3,
    }))
}
