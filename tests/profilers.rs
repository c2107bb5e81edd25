//! What Cohn and Parrish (1991, Mon. Wea. Rev. 119, 1757–1785) found of wind profilers among radiosondes, with covariances
//! alone: scenario `wind_profilers` without and with its networks, eleven hours after the last radiosondes.

use isobar::run::experiment::{Ground, ground, method};
use isobar::scenario::Scenario;
use isobar_assim::{Assimilator, Unknown};
use isobar_model::Grid;
use std::path::Path;

const CYCLES: usize = 47;

/// A Kalman filter that has seen some of the networks.
struct Filtered {
    filter: Box<dyn Assimilator>,
    /// Standard deviations of the analysis, `[variable, y, x]`.
    spread: Vec<f64>,
    grid: Grid,
    /// x and y of the profilers' outermost columns and rows.
    block: [[usize; 2]; 2],
}

fn filtered(networks: &[&str]) -> Filtered {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
    let mut scenario = Scenario::load(&folder.join("wind_profilers.toml")).unwrap();
    let grid = scenario.grid.grid.clone();
    let everywhere = ground(&scenario, 1, 1).unwrap();
    let profilers = everywhere.observing.stations().iter().filter(|station| &*station.network == "profilers");
    let cells: Vec<usize> = profilers.map(|station| grid.cell_at(station.x_m, station.y_m)).collect();
    assert_eq!(cells.len(), 31);
    let range = |of: &dyn Fn(usize) -> usize| {
        let all = || cells.iter().map(|&cell| of(cell));
        [all().min().unwrap(), all().max().unwrap()]
    };
    let block = [range(&|cell| cell % grid.nx), range(&|cell| cell / grid.nx)];
    scenario.networks.retain(|network| networks.contains(&network.name.as_str()));
    let Ground { problem, mut observing, .. } = ground(&scenario, 1, CYCLES).unwrap();
    let mut filter = method(&problem, "kf", &scenario, scenario.start).unwrap();
    let mut spread = Vec::new();
    for _ in 0..CYCLES {
        let from_filter = filter.forecast(scenario.cycle.window).unwrap();
        // No covariance depends on what is observed.
        let observed = observing.observe(&problem.background);
        spread = filter.analyse(&from_filter, &observed).unwrap().estimate.state_spread.unwrap();
    }
    Filtered { filter, spread, grid, block }
}

impl Filtered {
    /// Root of the mean variance of a variable over columns and rows, the columns counted around the domain.
    fn spread(&self, variable: usize, columns: [usize; 2], rows: [usize; 2]) -> f64 {
        let cells = (rows[0]..=rows[1]).flat_map(|j| (columns[0]..=columns[1]).map(move |i| (i, j)));
        let own = cells.map(|(i, j)| self.spread[self.index(variable, i as i64, j)].powi(2));
        let (sum, count) = own.fold((0.0, 0), |(sum, count), square| (sum + square, count + 1));
        (sum / f64::from(count)).sqrt()
    }

    fn index(&self, variable: usize, column: i64, row: usize) -> usize {
        let column = column.rem_euclid(self.grid.nx as i64) as usize;
        variable * self.grid.cells() + row * self.grid.nx + column
    }

    /// The correlations of the error of h at a place with those of a variable in its row, so many columns to the east.
    fn correlations(&self, place: (i64, usize), variable: usize, lags: &[i64]) -> Vec<f64> {
        let own = self.index(0, place.0, place.1);
        let column = self.filter.can().joint_errors.unwrap().covariance_column(Unknown::Value(own)).unwrap();
        let with = |lag: &i64| {
            let other = self.index(variable, place.0 + lag, place.1);
            column.state[other] / (self.spread[own] * self.spread[other])
        };
        lags.iter().map(with).collect()
    }
}

/// Σ |c(k) + c(−k)| over Σ (|c(k)| + |c(−k)|) of the correlations of h with v: 0 where they are antisymmetric.
fn asymmetry(own: &Filtered, place: (i64, usize)) -> f64 {
    let (east, west) = (own.correlations(place, 2, &[1, 2, 3]), own.correlations(place, 2, &[-1, -2, -3]));
    let pairs = || east.iter().zip(&west);
    let sum: f64 = pairs().map(|(east, west)| (east + west).abs()).sum();
    sum / pairs().map(|(east, west)| east.abs() + west.abs()).sum::<f64>()
}

#[test]
fn hourly_winds_and_five_heights_do_what_cohn_and_parrish_found() {
    let sondes = filtered(&["sondes"]);
    let profilers = filtered(&["sondes", "profilers"]);
    let all = filtered(&["sondes", "profilers", "radiometers"]);
    let [[west, east], rows] = sondes.block;
    let (inside, upstream, downstream) = ([west, east], [west - 4, west - 1], [east + 1, east + 4]);
    let ratio = |columns| profilers.spread(0, columns, rows) / sondes.spread(0, columns, rows);
    // Winds alone reduce the errors of height over the network (0.64), and more to its lee than to its windward (0.73, 0.82).
    assert!(ratio(inside) < 0.7, "{}", ratio(inside));
    assert!(ratio(downstream) < 0.8 && ratio(downstream) < ratio(upstream) - 0.05, "{}", ratio(downstream));
    // What is left of them is broad: 1000 km away the correlation is 0.15, where radiosondes alone leave none.
    let row = (rows[0] + rows[1]) / 2;
    let middle = ((west + east) as i64 / 2, row);
    let far = |own: &Filtered| own.correlations(middle, 0, &[-5, -4, 4, 5]).iter().sum::<f64>() / 4.0;
    assert!(far(&profilers) > 0.1 && far(&sondes) < 0.05, "{} {}", far(&profilers), far(&sondes));
    // At the western edge the correlation of h with v is antisymmetric no more (0.29; 0.06 without profilers).
    let edge = (west as i64, row);
    let (with, without) = (asymmetry(&profilers, edge), asymmetry(&sondes, edge));
    assert!(with > 0.2 && without < 0.1, "{with} {without}");
    // Five heights take off what is broad, and with it a further part of the errors (0.76; downstream 0.92).
    let ratio = |columns| all.spread(0, columns, rows) / profilers.spread(0, columns, rows);
    assert!(ratio(inside) < 0.8 && ratio(downstream) < 0.95, "{} {}", ratio(inside), ratio(downstream));
    assert!(far(&all) < 0.0, "{}", far(&all));
}
