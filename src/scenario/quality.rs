//! `[quality_control]`, and the faults of an instrument that it is there for.

use super::grid::GridSettings;
use super::network::Network;
use crate::kinds::covariances::Components;
use crate::reader::{Limits, Read, Section};
use indexmap::IndexMap;
use isobar_obs::{Faults, QualityControl};

/// Reads `[quality_control]`: how the values of observations are checked; `None` if that is not asked for, and no network has
/// faults.
///
/// The length is that of the background error unless it is given, the limit that of [`isobar_obs::quality::LIMIT`].
pub(super) fn read(
    root: &Section<'_>,
    background_error: &Components,
    grid: &GridSettings,
    networks: &IndexMap<String, Network>,
) -> Read<Option<QualityControl>> {
    let lengths = background_error.iter().filter_map(|component| component.length_m());
    let cell_m = grid.grid.dx_m.max(grid.grid.dy_m);
    let control = QualityControl { length_m: lengths.fold(cell_m, f64::max), limit: isobar_obs::quality::LIMIT };
    let Some(field) = root.optional("quality_control") else {
        let has_faults = networks.values().any(|network| network.faults != Faults::NONE);
        return Ok(has_faults.then_some(control));
    };
    let section = field.section(&["gross_error_limit", "length_km"])?;
    Ok(Some(QualityControl {
        limit: section.number_or("gross_error_limit", control.limit, Limits::Between(2.0, 1e6))?,
        length_m: section.number_or("length_km", control.length_m / 1e3, Limits::Between(1e-3, 1e5))? * 1e3,
    }))
}

/// Reads the faults of an instrument.
pub(super) fn faults(section: &Section<'_>) -> Read<Faults> {
    let none = Faults::NONE;
    let Some(field) = section.optional("faults") else { return Ok(none) };
    let keys =
        ["gross_error_rate", "gross_error_factor", "not_finite_rate", "duplicate_rate", "misplaced_rate", "late_rate"];
    let section = field.section(&keys)?;
    let rate = |key| section.number_or(key, 0.0, Limits::Fraction);
    Ok(Faults {
        gross_error_rate: rate("gross_error_rate")?,
        gross_error_factor: section.number_or("gross_error_factor", none.gross_error_factor, Limits::Positive)?,
        not_finite_rate: rate("not_finite_rate")?,
        duplicate_rate: rate("duplicate_rate")?,
        misplaced_rate: rate("misplaced_rate")?,
        late_rate: rate("late_rate")?,
    })
}
