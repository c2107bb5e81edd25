//! What each step of a cycle must not change.

use super::*;
use crate::covariance::{Sum, Univariate, White};
use crate::testing::Still;
use faer::Mat;
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, Grid, State};
use isobar_obs::{Calibration, Drift, Parameter, Placement};

fn errors(boundary: Boundary) -> LocalErrors {
    errors_with(boundary, 4)
}

fn errors_with(boundary: Boundary, support_tiles: usize) -> LocalErrors {
    let grid = Grid { nx: 16, ny: 11, dx_m: 1.0, dy_m: 1.0, boundary };
    let layout = isobar_model::shallow_water::layout(grid);
    let covariance = |length: f64| -> Arc<dyn Covariance> {
        let of = |variable| Univariate::new(&layout, variable, 1.0 + variable as f64, length).unwrap();
        let smooth = (0..3).map(|variable| Box::new(of(variable)) as Box<dyn Covariance>);
        let white = (0..3).map(|variable| Box::new(White::new(&layout, variable, 0.1)) as Box<dyn Covariance>);
        Arc::new(Sum::new(layout.len(), smooth.chain(white).collect()))
    };
    let parameter = |number: usize| Parameter {
        name: format!("bias/{number}"),
        unit: "m".into(),
        placement: if number == 1 { Placement::Local { x_m: 3.5, y_m: 4.5 } } else { Placement::Shared },
        sigma_prior: 2.0 + number as f64,
        drift: if number % 2 == 1 {
            Drift::FirstOrder { sigma: 2.0, correlation_time: isobar_model::Duration::from_seconds(86_400) }
        } else {
            Drift::RandomWalk { sigma_per_sqrt_day: 1.0 }
        },
    };
    let calibration = Calibration { parameters: (0..3).map(parameter).collect(), ..Calibration::default() };
    let model: Arc<dyn TangentLinear> = Arc::new(Still(Arc::clone(&layout)));
    let problem = Problem {
        model,
        background: State::zeros(&layout),
        background_error: covariance(1.5),
        model_error: Some(covariance(1.2)),
        calibration,
        bias: crate::problem::BiasTreatment::Estimate,
        memory_limit_bytes: 1 << 30,
        most_observations: 0,
    };
    let settings = LocalFactorSettings {
        blocks: super::super::blocks::BlockShape::Cell,
        per_tile: 4,
        model_error_per_tile: 6,
        tile_m: 2.0,
        support_tiles,
        mixed: 0,
        left_over: LeftOver::Blocks,
        factor_precision: super::super::blocks::Precision::Double,
        largest_component: usize::MAX,
        residual: super::super::blocks::Residual::Persist,
    };
    LocalErrors::new(&problem, settings).unwrap()
}

/// Σ F_j F_jᵀ.
fn of_factors(errors: &LocalErrors) -> Mat<f64> {
    let n = errors.frame.blocks.variables();
    let mut sum = Mat::zeros(n, n);
    for factors in &errors.memory.factors {
        let all: Vec<usize> = (0..n).collect();
        let wide = factors.extended(&all, factors.precision()).to_matrix();
        sum += &wide * wide.transpose();
    }
    sum
}

/// The block diagonal of Cov(b).
fn of_blocks(errors: &LocalErrors) -> Vec<f64> {
    let Frame { blocks, .. } = &*errors.frame;
    let mut own = errors.memory.own.clone();
    add_to_blocks(&mut own, blocks, 1.0, &errors.memory.factors);
    let root = crate::linalg::semidefinite_root(errors.memory.shared.as_ref());
    own.add_columns(blocks, 1.0, (&errors.memory.sensitivity.0 * root).as_ref());
    own.values().to_vec()
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    let largest = b.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    a.iter().zip(b).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs())) / largest
}

fn fill_with_normals(errors: &mut LocalErrors, seed: u64) {
    let random = &mut stream(seed, "factors");
    for factors in &mut errors.memory.factors {
        for j in 0..factors.columns() {
            let normals = standard_normals(random, factors.variables.len());
            factors.edit_column(j, |column| column.copy_from_slice(&normals));
        }
    }
    let rows = errors.memory.sensitivity.nrows();
    for j in 0..errors.memory.sensitivity.ncols() {
        errors.memory.sensitivity.col_as_slice_mut(j).copy_from_slice(&standard_normals(random, rows));
    }
}

/// tr Σ_j F_jᵀ N |x − x_j|² F_j, where x_j is the middle of tile j, along x.
fn spread_along_x(errors: &LocalErrors) -> f64 {
    let Frame { cells, scales, layout, .. } = &*errors.frame;
    let (nx, count) = (layout.grid.nx as f64, 8.0);
    let mut sum = 0.0;
    for (tile, factors) in errors.memory.factors.iter().enumerate() {
        let middle = ((tile % 8) as f64 + 0.5) * nx / count;
        for j in 0..factors.columns() {
            for (&variable, value) in factors.variables.iter().zip(&*factors.column(j)) {
                let x = (cells[variable] % layout.grid.nx) as f64 + 0.5;
                let apart = (x - middle + 0.5 * nx).rem_euclid(nx) - 0.5 * nx;
                sum += (value * apart / scales[variable]).powi(2);
            }
        }
    }
    sum
}

/// With supports without limit there is nothing to cut off, and the covariance stays as it is; else the blocks do.
#[test]
fn rotations_change_no_covariance_and_bring_directions_nearer_to_their_tiles() {
    for (boundary, support_tiles) in
        [Boundary::Periodic, Boundary::Channel].into_iter().flat_map(|boundary| [(boundary, 20), (boundary, 4)])
    {
        let mut errors = errors_with(boundary, support_tiles);
        for seed in [0, 3] {
            if seed > 0 {
                fill_with_normals(&mut errors, seed);
            }
            let (before, blocks, spread) = (of_factors(&errors), of_blocks(&errors), spread_along_x(&errors));
            let mut left = vec![0.0; before.nrows()];
            errors.localize(None, &mut left);
            assert!(left.iter().all(|left| *left == 0.0), "it is in the blocks");
            let change = (of_factors(&errors) - &before).norm_max() / before.norm_max();
            if support_tiles == 20 {
                assert!(change < 1e-12, "{boundary:?}: {change:e}");
                assert!(spread_along_x(&errors) <= spread * (1.0 + 1e-12), "{boundary:?}");
            } else {
                assert!(change > 1e-6, "nothing is cut off");
                let supports = errors.memory.factors.iter().zip(&errors.frame.supports);
                assert!(supports.into_iter().all(|(factors, support)| factors.variables == *support));
            }
            assert!(difference(&of_blocks(&errors), &blocks) < 1e-12, "{boundary:?}");
        }
    }
}

#[test]
fn compression_keeps_the_covariance_of_each_block_or_the_variance_of_each_variable() {
    for (boundary, left_over) in [Boundary::Periodic, Boundary::Channel]
        .into_iter()
        .flat_map(|boundary| [(boundary, LeftOver::Blocks), (boundary, LeftOver::Factors)])
    {
        let mut errors = errors(boundary);
        fill_with_normals(&mut errors, 5);
        let mut left = vec![0.0; errors.frame.blocks.variables()];
        let before = of_blocks(&errors);
        let variances = errors.variances();
        let fewer = LocalFactorSettings { per_tile: 2, left_over, ..errors.frame.settings };
        Arc::get_mut(&mut errors.frame).unwrap().settings = fewer;
        errors.reduce(None, &mut left);
        assert!(errors.memory.factors.iter().all(|factors| factors.columns() == 3));
        errors.localize(None, &mut left);
        errors.compress(None, left);
        let pairs = || errors.memory.factors.iter().zip(&errors.frame.supports);
        assert!(pairs().all(|(factors, support)| factors.columns() == 2 && factors.variables == *support));
        assert!(difference(&errors.variances(), &variances) < 1e-13, "{boundary:?}, {left_over:?}");
        match left_over {
            LeftOver::Blocks => assert!(difference(&of_blocks(&errors), &before) < 1e-13, "{boundary:?}"),
            LeftOver::Factors => {
                assert!(difference(&of_blocks(&errors), &before) > 1e-3, "nothing joins the factors");
            }
        }
    }
}

/// No variance is lost: a variable has its own and what was left over. Where that is more than the factors hold, the surplus is in
/// the blocks.
#[test]
fn longer_factors_hold_what_is_left_over() {
    let mut errors = errors(Boundary::Channel);
    fill_with_normals(&mut errors, 6);
    let mut of_factors = vec![0.0; errors.frame.blocks.variables()];
    errors.memory.factors.iter().for_each(|factors| factors.add_squared_rows(&mut of_factors));
    let times = |variable: usize| if variable.is_multiple_of(7) { 3.0 } else { 0.5 };
    let left: Vec<f64> = of_factors.iter().enumerate().map(|(variable, k)| times(variable) * k).collect();
    let before = errors.memory.own.clone();
    errors.lengthen(&left);
    let Frame { blocks, .. } = &*errors.frame;
    let mut now = vec![0.0; left.len()];
    errors.memory.factors.iter().for_each(|factors| factors.add_squared_rows(&mut now));
    for (variable, &k) in of_factors.iter().enumerate() {
        assert!((now[variable] - (1.0 + times(variable).min(1.0)) * k).abs() < 1e-12 * k, "{variable}");
        let (block, place) = blocks.place(variable);
        let grown =
            errors.memory.own.block(blocks, block)[(place, place)] - before.block(blocks, block)[(place, place)];
        assert!((grown - (times(variable) - 1.0).max(0.0) * k).abs() < 1e-12 * k, "{variable}: {grown}");
    }
}

#[test]
fn a_drift_of_the_parameters_is_exact_but_between_blocks() {
    let mut errors = errors(Boundary::Periodic);
    fill_with_normals(&mut errors, 11);
    let (p, before) = (3, of_blocks(&errors));
    let seeds = standard_normals(&mut stream(2, "added"), p * p);
    let root = Mat::from_fn(p, p, |i, j| seeds[3 * i + j]);
    let added = &root * root.transpose();
    let of_shared_before = errors.memory.shared.0.clone();
    let joint_before = &errors.memory.sensitivity.0 * &of_shared_before;
    let kept = [0.7, 0.4, 1.0];
    errors.change_calibration(&kept, added.as_ref()).unwrap();
    let Frame { shared, local, blocks, layout, .. } = &*errors.frame;
    let expected = Mat::from_fn(2, 2, |i, j| {
        kept[shared[i]] * of_shared_before[(i, j)] * kept[shared[j]] + added[(shared[i], shared[j])]
    });
    assert!((&errors.memory.shared.0 - &expected).norm_max() < 1e-12);
    let mut expected = joint_before;
    for j in 0..2 {
        (0..expected.nrows()).for_each(|i| expected[(i, j)] *= kept[shared[j]]);
        expected[(layout.len(), j)] *= kept[local[0]];
        expected[(layout.len(), j)] += added[(local[0], shared[j])];
    }
    let joint = &errors.memory.sensitivity.0 * &errors.memory.shared.0;
    assert!((&joint - &expected).norm_max() < 1e-11 * expected.norm_max());
    let mut expected = before;
    let (block, position) = blocks.place(layout.len());
    let (first, size) = (blocks.matrix(block).start, blocks.size(block));
    for other in 0..size {
        expected[first + position * size + other] *= kept[local[0]];
        expected[first + other * size + position] *= kept[local[0]];
    }
    expected[first + position * (size + 1)] += added[(local[0], local[0])];
    assert!(difference(&of_blocks(&errors), &expected) < 1e-12);
}

/// With all directions of each tile, and supports without limit, nothing of B and Q is left to the blocks.
#[test]
fn all_directions_of_all_tiles_make_the_whole_covariance() {
    for boundary in [Boundary::Periodic, Boundary::Channel] {
        let grid = Grid { nx: 6, ny: 5, dx_m: 1.0, dy_m: 1.0, boundary };
        let layout = isobar_model::shallow_water::layout(grid.clone());
        let terms: Vec<Box<dyn Covariance>> = vec![
            Box::new(Univariate::new(&layout, 0, 2.0, 1.5).unwrap()),
            Box::new(Univariate::new(&layout, 2, 1.0, 0.8).unwrap()),
            Box::new(White::new(&layout, 1, 0.3)),
        ];
        let covariance = Sum::new(layout.len(), terms);
        let tiles = Tiles::new(&grid, 2.0, 9);
        let supports: Vec<Vec<usize>> = vec![(0..layout.len()).collect(); tiles.count()];
        let scales = middle_deviations(&covariance, &layout);
        let random = &mut stream(1, "roots");
        let factors = roots::leading_local_factors(&covariance, &tiles, &supports, &scales, 1000, random).unwrap();
        let mut sum = Mat::zeros(layout.len(), layout.len());
        for factors in &factors {
            let values = factors.to_matrix();
            sum += &values * values.transpose();
        }
        let dense = crate::covariance::dense(&covariance);
        assert!((&sum - &dense).norm_max() < 1e-12 * dense.norm_max(), "{boundary:?}");
    }
}
