//! A sounding as tables and as a page with figures.

use super::Sounding;
use crate::calendar::utc;
use crate::output::report::page::{Figure, Page, PageError, Section, render};
use crate::plot::colors::of_method_on_paper;
use crate::plot::{Curve, CurvePlot};
use crate::tables::{Cell, Table, figure};
use isobar_assim::wind_finding::Motion;

/// Columns of a table of fixes: the wind is that between the fix and the next one.
const COLUMNS: [&str; 13] = [
    "time",
    "x_m",
    "y_m",
    "z_m",
    "sigma_x_m",
    "sigma_y_m",
    "sigma_z_m",
    "u_m_per_s",
    "v_m_per_s",
    "w_m_per_s",
    "sigma_u_m_per_s",
    "sigma_v_m_per_s",
    "sigma_w_m_per_s",
];

/// The widest points of a curve: more are not seen.
const MOST_POINTS: usize = 2000;

impl Sounding {
    /// What was found, in a sentence for each thing.
    pub fn sentences(&self, motion: Option<Motion>) -> Vec<String> {
        let (fixes, flight) = (self.readings.fixes.len(), &self.flight);
        let mut sentences = vec![format!(
            "{fixes} fixes by {} trackers from {} to {}",
            self.trackers,
            utc(self.readings.begin),
            utc(self.readings.end())
        )];
        if let Some(Motion { sigma_change_m_per_s }) = motion {
            sentences
                .push(format!("The wind is assumed to change by {} m/s within a minute", figure(sigma_change_m_per_s)));
        }
        if self.known > 0 {
            sentences.push(format!("{} of {} offsets were known before", self.known, self.calibration.len()));
        }
        let chi2 = flight.chi2_per_degree;
        let verdict = match chi2 {
            0.0 => "No more readings than unknowns: nothing says whether the assumed errors are right".to_string(),
            _ => format!("χ² per degree of freedom: {}", figure(chi2)),
        };
        sentences.push(verdict);
        sentences
    }

    /// The offsets of trackers, before and after the flight.
    pub fn offsets(&self) -> Table {
        let rows = (0..self.calibration.len()).map(|i| {
            let parameter = &self.calibration.parameters[i];
            let mean = self.prior_mean.as_ref().map(|mean| mean[i]);
            let before = mean.map(|_| parameter.sigma_prior);
            let figures = [mean, before, Some(self.offset(i)), Some(self.sigma_offset(i))].map(Cell::figure);
            [Cell::from(parameter.name.as_str()), parameter.unit.as_str().into()].into_iter().chain(figures).collect()
        });
        Table::new(&["offset", "unit", "before", "sigma\nbefore", "found", "sigma"], rows.collect())
    }

    /// The numbers of a fix, in the order of the columns after the time; the last fix has no wind.
    fn numbers(&self, fix: usize) -> Vec<Option<f64>> {
        let flight = &self.flight;
        let all = |values: Option<&[f64; 3]>| [0, 1, 2].map(|i| values.map(|values| values[i]));
        [
            all(flight.positions_m.get(fix)),
            all(flight.sigma_positions_m.get(fix)),
            all(flight.winds_m_per_s.get(fix)),
            all(flight.sigma_winds_m_per_s.get(fix)),
        ]
        .concat()
    }

    /// All fixes: position, wind up to the next fix, and standard deviations, with all digits.
    pub fn fixes(&self) -> Table {
        let row = |fix: usize| {
            let numbers = self.numbers(fix).into_iter().map(Cell::in_full);
            std::iter::once(Cell::from(utc(self.time(fix)))).chain(numbers).collect()
        };
        Table::new(&COLUMNS, (0..self.readings.fixes.len()).map(row).collect())
    }

    /// At most this number of fixes, evenly spread, in three digits.
    pub fn levels(&self, most: usize) -> Table {
        let winds = self.flight.winds_m_per_s.len();
        let row = |fix: usize| {
            let numbers = self.numbers(fix);
            let shown = [2, 5, 6, 9, 7, 10, 8, 11].map(|column| Cell::figure(numbers[column]));
            std::iter::once(Cell::from(utc(self.time(fix)))).chain(shown).collect()
        };
        let header =
            ["time", "height\nm", "sigma\nm", "u\nm/s", "sigma\nm/s", "v\nm/s", "sigma\nm/s", "w\nm/s", "sigma\nm/s"];
        Table::new(&header, evenly(winds, most).map(row).collect())
    }

    /// The page.
    ///
    /// # Errors
    /// As [`render`].
    pub fn html(&self, motion: Option<Motion>) -> Result<String, PageError> {
        let sentences = self.sentences(motion);
        let figures = self.curves().into_iter().enumerate();
        let figures = figures.filter_map(|(number, (plot, caption))| Figure::of_curves(&plot, number, caption.into()));
        render(&Page {
            title: format!("Winds of {}", self.name),
            subtitle: sentences[0].clone(),
            headline: sentences[1..].to_vec(),
            facts: vec![("version".into(), format!("isobar {}", crate::VERSION))],
            sections: vec![
                Section {
                    title: "Wind and track".into(),
                    text: "Bands: twice the claimed standard deviation on either side, the uncertainty of the offsets \
                           included."
                        .into(),
                    figures: figures.collect(),
                    ..Section::default()
                },
                Section {
                    title: "Offsets of trackers".into(),
                    text: "To be subtracted from readings; before: what was assumed or known before the flight.".into(),
                    tables: vec![self.offsets()],
                    ..Section::default()
                },
                Section { title: "Levels".into(), tables: vec![self.levels(40)], ..Section::default() },
            ],
            ..Page::default()
        })
    }

    fn curves(&self) -> Vec<(CurvePlot, &'static str)> {
        let (flight, fixes) = (&self.flight, self.readings.fixes.len());
        let height_km = |fix: usize| flight.positions_m[fix][2] / 1e3;
        let minutes = |fix: usize| self.readings.fixes[fix].seconds / 60.0;
        let of_winds = |i: usize, name: &str| {
            let numbers = || evenly(flight.winds_m_per_s.len(), MOST_POINTS);
            let points = numbers().map(|k| [(height_km(k) + height_km(k + 1)) / 2.0, flight.winds_m_per_s[k][i]]);
            let band = numbers().map(|k| {
                let (value, sigma) = (flight.winds_m_per_s[k][i], flight.sigma_winds_m_per_s[k][i]);
                [value - 2.0 * sigma, value + 2.0 * sigma]
            });
            Curve::new(name, of_method_on_paper(i), points.collect()).with_band(band.collect())
        };
        let mut wind = CurvePlot::new(
            "wind by height".into(),
            "height [km]".into(),
            "wind [m/s]".into(),
            vec![of_winds(0, "u, eastward"), of_winds(1, "v, northward")],
        );
        wind.from_zero = false;
        let track = evenly(fixes, MOST_POINTS).map(|k| [0, 1].map(|i| flight.positions_m[k][i] / 1e3)).collect();
        let mut plan = CurvePlot::new(
            "track".into(),
            "x, eastward [km]".into(),
            "y, northward [km]".into(),
            vec![Curve::new("balloon", of_method_on_paper(0), track)],
        );
        (plan.from_zero, plan.legend) = (false, false);
        let accuracy = ["x", "y", "height"].into_iter().enumerate().map(|(i, name)| {
            let points = evenly(fixes, MOST_POINTS).map(|k| [minutes(k), flight.sigma_positions_m[k][i]]).collect();
            Curve::new(name, of_method_on_paper(i), points)
        });
        let accuracy = CurvePlot::new(
            "accuracy of positions".into(),
            "time of flight [min]".into(),
            "standard deviation [m]".into(),
            accuracy.collect(),
        );
        vec![
            (wind, "The wind between fixes at their mean height."),
            (plan, "The track from above; the scales of x and y differ."),
            (accuracy, "Claimed standard deviations of the positions' coordinates."),
        ]
    }
}

/// At most `most` of the numbers below `count`, evenly spread, the first and the last among them.
fn evenly(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let shown = count.min(most);
    (0..shown).map(move |k| if shown < 2 { 0 } else { k * (count - 1) / (shown - 1) })
}
