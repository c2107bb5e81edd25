//! `kind = "members"`.

use super::component::{CovarianceSettings, VARIABLE};
use crate::kinds::{Domain, Kind};
use crate::reader::{Absent, Described, Form, Key, Limits, fields};
use faer::Mat;
use isobar_assim::covariance::LocalizedEnsemble;
use isobar_assim::{Covariance, Error};
use isobar_model::Layout;

/// The most members in a file.
const MOST_MEMBERS: usize = 1000;

const FILE: Key<Described> = Key::required(
    "file",
    "",
    Described("a CSV file with a column for each of 2 to 1000 members and a row for each cell", Form::text),
    "the members, fields of the variable",
);

const LOCALIZATION_RADIUS_KM: Key<Limits> = Key::absent(
    "localization_radius_km",
    "km",
    Limits::Between(1e-3, 1e6),
    Absent::Explained("no taper"),
    "distance at which the taper of the correlations ends",
);

pub(super) const KIND: Kind<dyn CovarianceSettings, Domain> = Kind::new(
    "members",
    "One variable alone, with the covariance of the members of an ensemble",
    &[&[&VARIABLE, &FILE, &LOCALIZATION_RADIUS_KM]],
    |section, domain| {
        let file = section.required(FILE.name)?;
        let members = fields::read(&file, &domain.grid, MOST_MEMBERS)?.columns;
        if members.len() < 2 {
            return Err(file.invalid("one member has no covariance".into(), "needs two columns or more"));
        }
        let localization_radius_m = section.find(&LOCALIZATION_RADIUS_KM)?.map(|km| km * 1e3);
        let variable = domain.variable(&section.required(VARIABLE.name)?)?;
        Ok(Box::new(MembersSettings { variable, members, localization_radius_m }))
    },
);

#[derive(Debug)]
struct MembersSettings {
    /// The variable's number.
    variable: usize,
    /// A field `[y, x]` for each member.
    members: Vec<Vec<f64>>,
    /// Where the taper of correlations ends, if they are tapered \[m\].
    localization_radius_m: Option<f64>,
}

impl CovarianceSettings for MembersSettings {
    fn build(&self, layout: &Layout) -> Result<Box<dyn Covariance>, Error> {
        let (cells, count) = (layout.grid.cells(), self.members.len());
        let mut perturbations = Mat::zeros(layout.len(), count);
        for (cell, index) in (self.variable * cells..(self.variable + 1) * cells).enumerate() {
            let mean = self.members.iter().map(|member| member[cell]).sum::<f64>() / count as f64;
            for (k, member) in self.members.iter().enumerate() {
                perturbations[(index, k)] = member[cell] - mean;
            }
        }
        let radius_m = self.localization_radius_m.unwrap_or(f64::INFINITY);
        Ok(Box::new(LocalizedEnsemble::new(layout, &perturbations, radius_m)?))
    }

    fn length_m(&self) -> Option<f64> {
        // A Gaussian of this length is about as wide as the taper.
        self.localization_radius_m.map(|radius| 0.25 * radius)
    }
}
