//! `kind = "satellite"`: a polar-orbiting satellite with a cross-track scanner.

use super::common::COMMON;
use super::{bias, correlation};
use crate::kinds::{Domain, Kind, Kinds, choose_by, forms};
use crate::reader::{Absent, Choice, Described, Form, Key, Limits, Read, Section, Whole};
use isobar_obs::{AirMassBias, Heading, InstrumentSettings, ObservedVariable, SatelliteSettings, ScanBias, ScanTerm};

const VARIABLE: Key<Described> =
    Key::required("variable", "", Described("a variable of the model", Form::text), "the observed variable");

const SIGMA: Key<Limits> =
    Key::required("sigma", "of the variable", Limits::Positive, "standard deviation of the random error");

/// A length in a scenario \[km\].
const LENGTH: Limits = Limits::Between(1e-3, 1e5);

const SWATH_WIDTH_KM: Key<Limits> = Key::required(
    "swath_width_km",
    "km",
    LENGTH,
    "distance between the centres of the outermost footprints of a scan line; narrower than the domain",
);

const SCAN_POSITIONS: Key<Whole> =
    Key::required("scan_positions", "", Whole(1, 1000), "number of footprints in a scan line");

const ALONG_TRACK_SPACING_KM: Key<Limits> =
    Key::required("along_track_spacing_km", "km", LENGTH, "distance between scan lines");

const FOOTPRINT_SIGMA_KM: Key<Limits> = Key::required(
    "footprint_sigma_km",
    "km",
    Limits::Between(0.0, 1e5),
    "standard deviation of the Gaussian footprint: 0 for a point, else at least half of a cell",
);

const START_X_FRACTION: Key<Limits> = Key::absent(
    "start_x_fraction",
    "1",
    Limits::Between(0.0, 1.0),
    Absent::Means(0.0),
    "where the track of cycle 1 crosses the middle row of the domain, as a fraction of its width",
);

const SHIFT_PER_CYCLE_KM: Key<Limits> = Key::absent(
    "shift_per_cycle_km",
    "km",
    Limits::Between(-1e5, 1e5),
    Absent::Means(0.0),
    "eastward shift of the track from cycle to cycle",
);

const HEADING: Key<Choice<Heading>> = Key::absent(
    "heading",
    "",
    Choice(&[
        ("northward", Heading::Northward),
        ("southward", Heading::Southward),
        ("alternating", Heading::Alternating),
    ]),
    Absent::Means(Heading::Northward),
    "which way it flies",
);

const TRACK_ANGLE_DEG: Key<Limits> = Key::absent(
    "track_angle_deg",
    "degrees",
    Limits::Between(-60.0, 60.0),
    Absent::Means(0.0),
    "angle of the track to the y axis, positive when the satellite moves to the east",
);

const BIAS: Key<Described> = Key::absent(
    "bias",
    "",
    Described("a list of tables", || Form::list(Form::Kinds(TERM, forms(TERMS)))),
    Absent::Explained("no biases"),
    "biases, each with a coefficient to estimate",
);

pub(super) const KIND: Kind<dyn InstrumentSettings, Domain> = Kind::new(
    "satellite",
    "A swath of footprints along a track that moves from cycle to cycle",
    &[
        &[
            &VARIABLE,
            &SIGMA,
            &SWATH_WIDTH_KM,
            &SCAN_POSITIONS,
            &ALONG_TRACK_SPACING_KM,
            &FOOTPRINT_SIGMA_KM,
            &START_X_FRACTION,
            &SHIFT_PER_CYCLE_KM,
            &HEADING,
            &TRACK_ANGLE_DEG,
            &BIAS,
            &correlation::SATELLITE,
        ],
        COMMON,
    ],
    |section, domain| {
        let variable = domain.variable(&section.required(VARIABLE.name)?)?;
        let mut settings = SatelliteSettings {
            variable: ObservedVariable::new(domain.model.variables()[variable].0, section.get(&SIGMA)?),
            swath_width_m: section.get(&SWATH_WIDTH_KM)? * 1e3,
            scan_positions: section.get(&SCAN_POSITIONS)?,
            along_track_spacing_m: section.get(&ALONG_TRACK_SPACING_KM)? * 1e3,
            footprint_sigma_m: section.get(&FOOTPRINT_SIGMA_KM)? * 1e3,
            crossing_x_m: section.get(&START_X_FRACTION)? * domain.grid.width_m(),
            shift_per_cycle_m: section.get(&SHIFT_PER_CYCLE_KM)? * 1e3,
            heading: section.get(&HEADING)?,
            track_angle_deg: section.get(&TRACK_ANGLE_DEG)?,
            biases: Vec::new(),
            air_mass_biases: Vec::new(),
        };
        read_biases(section, domain, &mut settings)?;
        Ok(Box::new(settings))
    },
);

/// The key of a bias that says what it depends on.
const TERM: &str = "term";

const PREDICTOR: Key<Described> = Key::required(
    "variable",
    "",
    Described("a variable of the model", Form::text),
    "the variable to which the bias is proportional, as the satellite sees it",
);

const MEAN: Key<Limits> =
    Key::required("mean", "of that variable", Limits::Any, "the value at which there is no such bias");

const SCALE: Key<Limits> = Key::required(
    "scale",
    "of that variable",
    Limits::Positive,
    "the change of the variable over which the bias changes by its coefficient",
);

/// What a bias depends on: the scan position, or, if `None`, the air.
const TERMS: &Kinds<Option<ScanTerm>, ()> = &[
    &Kind::new("offset", "The same everywhere", &[bias::KEYS], |_, ()| Ok(Box::new(Some(ScanTerm::Offset)))),
    &Kind::new("scan_linear", "Linear in the scan position", &[bias::KEYS], |_, ()| {
        Ok(Box::new(Some(ScanTerm::Linear)))
    }),
    &Kind::new("scan_quadratic", "Quadratic in the scan position", &[bias::KEYS], |_, ()| {
        Ok(Box::new(Some(ScanTerm::Quadratic)))
    }),
    &Kind::new(
        "air_mass",
        "Proportional to (variable − mean) / scale",
        &[&[&PREDICTOR, &MEAN, &SCALE], bias::KEYS],
        |_, ()| Ok(Box::new(None)),
    ),
];

fn read_biases(section: &Section<'_>, domain: &Domain, settings: &mut SatelliteSettings) -> Read<()> {
    for element in section.optional(BIAS.name).map_or(Ok(Vec::new()), |field| field.elements(bias::MOST_BIASES))? {
        let (kind, section) = choose_by(TERM, &element, TERMS, &())?;
        if let Some(term) = *(kind.read)(&section, &())? {
            settings.biases.push(ScanBias { term, process: bias::read(&section)? });
        } else {
            let variable = domain.variable(&section.required(PREDICTOR.name)?)?;
            settings.air_mass_biases.push(AirMassBias {
                variable: domain.model.variables()[variable].0.to_string(),
                mean: section.get(&MEAN)?,
                scale: section.get(&SCALE)?,
                process: bias::read(&section)?,
            });
        }
    }
    Ok(())
}
