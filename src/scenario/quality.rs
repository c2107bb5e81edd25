//! `[quality_control]`: how the values of observations are checked.

use super::grid::GridSettings;
use crate::kinds::covariances::Components;
use crate::reader::{Absent, AnyKey, Key, Limits, Read, Section};
use isobar_obs::{Faults, Network, QualityControl};

const GROSS_ERROR_LIMIT: Key<Limits> = Key::absent(
    "gross_error_limit",
    "1",
    Limits::Between(2.0, 1e6),
    Absent::Means(isobar_obs::quality::LIMIT),
    "standard deviations by which an observation may contradict its neighbours",
);

const LENGTH_KM: Key<Limits> = Key::absent(
    "length_km",
    "km",
    Limits::Between(1e-3, 1e5),
    Absent::Explained("the longest length of `[background_error]`"),
    "distance over which forecast errors resemble each other",
);

/// The keys.
pub(super) const KEYS: &[&dyn AnyKey] = &[&GROSS_ERROR_LIMIT, &LENGTH_KM];

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
    let section = field.section_with(KEYS)?;
    Ok(Some(QualityControl {
        limit: section.get(&GROSS_ERROR_LIMIT)?,
        length_m: section.find(&LENGTH_KM)?.map_or(control.length_m, |km| km * 1e3),
    }))
}
