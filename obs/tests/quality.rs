//! Quality control: what is no observation never reaches a method, and good observations do.

use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, Duration, Grid, Layout, Location, State, Time, Variable};
use isobar_obs::quality::Reference;
use isobar_obs::{
    Faults, Network, ObservationFile, ObservedVariable, ObservingSystem, QualityControl, RadiosondeSettings,
    RecordedSettings, Rejection, SatelliteSettings, StationSource,
};
use std::sync::Arc;

const CONTROL: QualityControl = QualityControl { length_m: 800e3, limit: isobar_obs::quality::LIMIT };

/// A reference of which nothing is known but itself.
fn unbounded(state: &State) -> Reference<'_> {
    Reference { states: state.into(), sigma: &[] }
}

fn layout() -> Arc<Layout> {
    let grid = Grid { nx: 28, ny: 20, dx_m: 185e3, dy_m: 185e3, boundary: Boundary::Channel };
    let variable = |name, unit, location| Variable { name, long_name: name, standard_name: None, unit, location };
    let variables = vec![
        variable("h", "m", Location::Center),
        variable("u", "m s-1", Location::XFace),
        variable("v", "m s-1", Location::YFace),
    ];
    Arc::new(Layout { grid, variables })
}

/// A jet, and waves of this size upon it.
fn state(layout: &Arc<Layout>, size: f64, seed: u64) -> State {
    let mut state = State::zeros(layout);
    let draws = standard_normals(&mut stream(seed, "waves"), 48);
    for (number, unit) in [30.0, 4.0, 4.0].into_iter().enumerate() {
        for j in 0..20 {
            for i in 0..28 {
                let waves: f64 = (0..8)
                    .map(|k| {
                        let (x, y) = (i as f64 / 28.0, j as f64 / 20.0);
                        let (kx, ky) = (1.0 + f64::from(k % 3), 0.5 * f64::from(1 + k / 3));
                        let phase = std::f64::consts::TAU * (kx * x + ky * y + draws[16 * number + 2 * k as usize]);
                        draws[16 * number + 2 * k as usize + 1] * phase.sin()
                    })
                    .sum();
                let jet = if number == 0 { 1000.0 - 100.0 * (j as f64 / 10.0 - 1.0).tanh() } else { 10.0 };
                state.field_mut(number)[j * 28 + i] = jet + size * unit * 0.5 * waves;
            }
        }
    }
    state
}

fn system(faults: Faults, seed: u64) -> ObservingSystem {
    let layout = layout();
    let sondes = RadiosondeSettings::new(StationSource::Random { count: 90, groups: Vec::new() });
    let mut polar = SatelliteSettings::default();
    (polar.scan_positions, polar.along_track_spacing_m, polar.footprint_sigma_m) = (10, 185e3, 100e3);
    polar.swath_width_m = 1600e3;
    polar.variable = ObservedVariable::new("h", 30.0);
    let with_faults = |network: Network| Network { faults, ..network };
    let networks = [Network::new("sondes", sondes), Network::new("polar", polar)].map(with_faults);
    let window = Duration::from_seconds(6 * 3600);
    ObservingSystem::new(&layout, None, &networks, seed, window, Time::from_seconds(0)).unwrap()
}

#[test]
fn good_observations_pass_whatever_the_reference_is_worth() {
    for size in [0.0, 0.3, 1.0, 2.0] {
        let layout = layout();
        let (mut rejected, mut used) = (0, 0);
        for seed in 0..20 {
            let (truth, reference) = (state(&layout, size, seed), state(&layout, 0.0, 0));
            let window = system(Faults::NONE, seed)
                .observe_checked(Some((&truth).into()), Some((&CONTROL, unbounded(&reference))));
            (rejected, used) = (rejected + window.aside.rejected().count(), used + window.len());
        }
        println!("waves × {size}: {rejected} of {} rejected", used + rejected);
        // A reference that is worth nothing at all (waves × 2) costs 11 of 9400; any better one at most 1.
        let one_of = if size > 1.0 { 500 } else { 2000 };
        assert!(rejected * one_of <= used, "waves × {size}: {rejected} of {}", used + rejected);
    }
}

#[test]
fn gross_errors_are_found_by_their_neighbours() {
    let faults = Faults { gross_error_rate: 0.05, ..Faults::NONE };
    let layout = layout();
    let (mut large, mut missed, mut wrong, mut all) = (0, 0, 0, 0);
    for seed in 0..20 {
        let (truth, reference) = (state(&layout, 1.0, seed), state(&layout, 0.0, 0));
        let clean = system(Faults::NONE, seed).observe(&truth);
        let checked =
            system(faults, seed).observe_checked(Some((&truth).into()), Some((&CONTROL, unbounded(&reference))));
        let value_of = |network: &str, platform: &str, variable: usize| {
            let same = |it: &isobar_obs::Report| {
                &*it.network == network && &*it.platform == platform && it.variable == variable
            };
            clean.values[clean.reports.iter().position(same).unwrap()]
        };
        let error = |report: &isobar_obs::Report, value: f64, sigma: f64| {
            (value - value_of(&report.network, &report.platform, report.variable)).abs() / sigma
        };
        for (number, report) in checked.reports.iter().enumerate() {
            let error = error(report, checked.values[number], checked.sigma[number]);
            (large, missed) = (large + usize::from(error > 15.0), missed + usize::from(error > 15.0));
        }
        for (it, rejection) in checked.aside.rejected() {
            let error = error(&it.report, it.value, it.sigma);
            (large, wrong) = (large + usize::from(error > 15.0), wrong + usize::from(error == 0.0));
            let known = [Rejection::GrossError, Rejection::Absurd].contains(&rejection);
            assert!(known, "{rejection:?}");
        }
        all += checked.len() + checked.aside.rejected().count();
    }
    println!("{large} errors above 15 σ, {missed} missed; {wrong} of {all} observations rejected wrongly");
    assert!(large > 100 && missed * 20 <= large, "{missed} of {large} missed");
    assert!(wrong * 500 <= all, "{wrong} of {all} rejected wrongly");
}

#[test]
fn what_a_report_says_of_itself_is_enough_for_these() {
    let faults =
        Faults { not_finite_rate: 0.1, duplicate_rate: 0.1, misplaced_rate: 0.1, late_rate: 0.1, ..Faults::NONE };
    let layout = layout();
    let (truth, reference) = (state(&layout, 1.0, 1), state(&layout, 0.0, 0));
    let clean = system(Faults::NONE, 1).observe(&truth);
    let window = system(faults, 1).observe_checked(Some((&truth).into()), Some((&CONTROL, unbounded(&reference))));
    let count = |rejection| window.aside.rejected().filter(|it| it.1 == rejection).count();
    for rejection in [Rejection::NotFinite, Rejection::Outside, Rejection::Late, Rejection::Duplicate] {
        let share = count(rejection) as f64 / clean.len() as f64;
        assert!((0.05..0.15).contains(&share), "{rejection:?}: {share}");
    }
    // Every observation is there once, used or not, and those that are used are as they were.
    let lost = [Rejection::NotFinite, Rejection::Outside, Rejection::Late].map(count).iter().sum::<usize>();
    assert_eq!(window.len() + lost, clean.len());
    assert!(window.values.iter().all(|value| clean.values.contains(value)));
    assert_eq!(window.operator.simulate(&truth, &[0.0; 3]).len(), window.len());
    // A second look at the same cycle gives the same.
    let again = system(faults, 1).observe_checked(Some((&truth).into()), Some((&CONTROL, unbounded(&reference))));
    assert_eq!(again.values, window.values);
    assert_eq!(again.aside.rejected().count(), window.aside.rejected().count());
}

#[test]
fn absurd_values_are_rejected_before_they_can_disturb_the_statistics() {
    let faults = Faults { gross_error_rate: 0.3, gross_error_factor: 1e9, ..Faults::NONE };
    let layout = layout();
    let (truth, reference) = (state(&layout, 1.0, 1), state(&layout, 0.0, 0));
    let window = system(faults, 1).observe_checked(Some((&truth).into()), Some((&CONTROL, unbounded(&reference))));
    let absurd = window.aside.rejected().filter(|it| it.1 == Rejection::Absurd).count();
    assert!(
        absurd * 10 > 9 * window.aside.rejected().count() && absurd > 50,
        "{absurd} of {}",
        window.aside.rejected().count()
    );
    assert!(window.values.iter().all(|value| value.abs() < 1e4));
}

#[test]
fn rates_that_are_not_probabilities_are_refused() {
    let sondes = RadiosondeSettings::new(StationSource::Random { count: 3, groups: Vec::new() });
    for (faults, wanted) in [
        (Faults { late_rate: 1.5, ..Faults::NONE }, "faults.late_rate is 1.5"),
        (Faults { late_rate: 0.6, duplicate_rate: 0.6, ..Faults::NONE }, "faults is 1.2"),
        (Faults { gross_error_factor: 0.0, ..Faults::NONE }, "faults.gross_error_factor is 0"),
        (Faults { gross_error_rate: f64::NAN, ..Faults::NONE }, "faults.gross_error_rate is NaN"),
    ] {
        let networks = [Network { faults, ..Network::new("sondes", sondes.clone()) }];
        let window = Duration::from_seconds(60);
        let Err(error) = ObservingSystem::new(&layout(), None, &networks, 1, window, Time::from_seconds(0)) else {
            panic!("{wanted}")
        };
        assert!(error.to_string().contains(wanted), "{error}");
    }
}

/// Where half of the observations or more are gross, their median is no scale: what is assumed of the forecast is.
#[test]
fn few_observations_are_not_their_own_scale() {
    let layout = layout();
    let (truth, reference) = (state(&layout, 0.0, 0), state(&layout, 0.0, 0));
    // Good departures are of the order of σ_x = 30 m and the random error, 12 m.
    let good = [8.0, -31.0, 22.0, -17.0, 40.0, 3.0, -25.0, 12.0, -9.0, 33.0];
    let rejected = |departures: &[f64]| {
        let rows: Vec<String> = departures
            .iter()
            .enumerate()
            .map(|(i, d)| {
                let (column, row) = (2 + 5 * (i % 5), 3 + 4 * (i / 5));
                let value = reference.values()[row * 28 + column] + d;
                format!("1,{column},{row},h,{value},12,S{i:02}")
            })
            .collect();
        let text = format!("cycle,column,row,variable,value,sigma,id\n{}\n", rows.join("\n"));
        let observations = ObservationFile::parse(&text, "file.csv", None).unwrap();
        let configs = [Network::new("file", RecordedSettings::new(observations))];
        let window = Duration::from_seconds(6 * 3600);
        let mut system = ObservingSystem::new(&layout, None, &configs, 1, window, Time::from_seconds(0)).unwrap();
        let sigma = [30.0, 3.0, 3.0];
        let checked = Reference { states: (&reference).into(), sigma: &sigma };
        let control = QualityControl { length_m: 300e3, ..CONTROL };
        let window = system.observe_checked(Some((&truth).into()), Some((&control, checked)));
        let mut rejected: Vec<String> = window.aside.rejected().map(|it| it.0.report.platform.to_string()).collect();
        rejected.sort();
        rejected
    };
    for count in 1..=good.len() {
        assert!(rejected(&good[..count]).is_empty(), "{count}: {:?}", rejected(&good[..count]));
    }
    assert_eq!(rejected(&[1e3]), ["S00"]);
    for gross in [1e4, -1e6, 1e15] {
        assert_eq!(rejected(&[gross]), ["S00"], "alone: {gross}");
        assert_eq!(rejected(&[8.0, gross]), ["S01"], "one of two: {gross}");
        assert_eq!(rejected(&[gross, gross]), ["S00", "S01"], "both: {gross}");
        assert_eq!(rejected(&[8.0, gross, -31.0]), ["S01"], "one of three: {gross}");
        let half: Vec<f64> =
            (0..10).map(|i| if i % 2 == 0 { good[i] } else { gross * (1.0 + 0.1 * i as f64) }).collect();
        assert_eq!(rejected(&half), ["S01", "S03", "S05", "S07", "S09"], "half: {gross}");
    }
}
