//! The automatic partition of sparse systems, against the dense solution of the same system.

use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, Side};
use isobar_assim::Error;
use isobar_assim::block_angular::{Prior, SparseRegression, SparseSolution, solve_sparse};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{Boundary, Grid, Location};
use isobar_obs::SparseRows;
use isobar_obs::footprint::footprint;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A sparse system with random G and y.
struct System {
    unknowns: usize,
    x: SparseRows,
    g: Mat<f64>,
    y: Vec<f64>,
    variance: Vec<f64>,
}

impl System {
    fn new(random: &mut ChaCha8Rng, unknowns: usize, rows: Vec<Vec<(usize, f64)>>, p: usize) -> Self {
        let n = rows.len();
        let mut x = SparseRows::new();
        rows.into_iter().for_each(|row| x.push_row(row));
        let values = standard_normals(random, n * p);
        Self {
            unknowns,
            x,
            g: Mat::from_fn(n, p, |i, j| values[j * n + i]),
            y: standard_normals(random, n),
            variance: (0..n).map(|_| random.random_range(0.3..2.0)).collect(),
        }
    }

    fn solve(&self, prior: Option<&Prior>, largest_part: usize) -> Result<SparseSolution, Error> {
        let &Self { unknowns, ref x, ref g, ref y, ref variance } = self;
        solve_sparse(&SparseRegression { unknowns, x, g: g.as_ref(), y, variance }, prior, largest_part)
    }

    /// (Z' V⁻¹ Z)⁻¹ Z' V⁻¹ y, its covariance, and the squared norm of the residuals.
    fn dense(&self, prior: Option<&Prior>) -> (Mat<f64>, Mat<f64>, f64) {
        let (n, m, p) = (self.y.len(), self.unknowns, self.g.ncols());
        let mut z = Mat::<f64>::zeros(n, m + p);
        let mut y = Mat::<f64>::zeros(n, 1);
        for row in 0..n {
            let scale = self.variance[row].sqrt().recip();
            self.x.row(row).iter().for_each(|&(column, value)| z[(row, column)] += scale * value);
            (0..p).for_each(|j| z[(row, m + j)] = scale * self.g[(row, j)]);
            y[(row, 0)] = scale * self.y[row];
        }
        let (mut information, mut right) = (z.transpose() * &z, z.transpose() * &y);
        let mut chi2 = (y.transpose() * &y)[(0, 0)];
        if let Some(prior) = prior {
            let inverse = prior.covariance.llt(Side::Lower).unwrap().inverse();
            let mean = Mat::from_fn(p, 1, |i, _| prior.mean[i]);
            let mut corner = information.as_mut().submatrix_mut(m, m, p, p);
            corner += &inverse;
            let mut part = right.as_mut().submatrix_mut(m, 0, p, 1);
            part += &inverse * &mean;
            chi2 += (mean.transpose() * &inverse * &mean)[(0, 0)];
        }
        let covariance = information.llt(Side::Lower).unwrap().inverse();
        let estimate = &covariance * &right;
        chi2 -= (right.transpose() * &estimate)[(0, 0)];
        (estimate, covariance, chi2)
    }

    /// The largest relative difference between the two, in estimates, χ², variances, columns of the covariance and the
    /// covariance of what a row touches.
    fn difference(&self, prior: Option<&Prior>, largest_part: usize) -> f64 {
        let (estimate, covariance, chi2) = self.dense(prior);
        let solution = self.solve(prior, largest_part).unwrap();
        let (m, p) = (self.unknowns, self.g.ncols());
        assert!(solution.partition.largest_part <= largest_part && solution.partition.border == p);
        let mut largest: f64 = (solution.residual_chi2 - chi2).abs() / (1.0 + chi2);
        let mut compare =
            |found: f64, expected: f64, scale: f64| largest = largest.max((found - expected).abs() / scale);
        let found = solution.estimate.iter().chain(&solution.border);
        found.enumerate().for_each(|(i, value)| compare(*value, estimate[(i, 0)], estimate.norm_max()));
        let scale = covariance.norm_max();
        for i in 0..p {
            (0..p).for_each(|j| compare(solution.border_covariance[(i, j)], covariance[(m + i, m + j)], scale));
        }
        let variances = solution.variances();
        (0..m).for_each(|i| compare(variances[i], covariance[(i, i)], scale));
        for column in (0..m).step_by(7) {
            let found = solution.covariance_column(column);
            (0..m + p).for_each(|i| compare(found[i], covariance[(i, column)], scale));
        }
        let touched = |row: usize| {
            let mut group: Vec<usize> = self.x.row(row).iter().map(|entry| entry.0).collect();
            group.sort_unstable();
            group.dedup();
            group
        };
        let groups: Vec<Vec<usize>> = (0..self.y.len()).map(touched).collect();
        let spread = &solution.sensitivity * &solution.border_covariance * solution.sensitivity.transpose();
        for (group, own) in groups.iter().zip(solution.conditional_covariances(&groups)) {
            for (i, &row) in group.iter().enumerate() {
                for (j, &column) in group.iter().enumerate() {
                    compare(own[(i, j)] + spread[(row, column)], covariance[(row, column)], scale);
                }
            }
        }
        largest
    }
}

/// Rows that determine every unknown by itself, and `links` others of up to `width` unknowns.
fn random_rows(random: &mut ChaCha8Rng, unknowns: usize, links: usize, width: usize) -> Vec<Vec<(usize, f64)>> {
    let mut rows: Vec<Vec<(usize, f64)>> =
        (0..unknowns).map(|unknown| vec![(unknown, random.random_range(0.5..1.5))]).collect();
    for _ in 0..links {
        let count = random.random_range(0..=width);
        let near = random.random_range(0..unknowns);
        rows.push(
            (0..count)
                .map(|_| ((near + random.random_range(0..9)) % unknowns, random.random_range(-1.0..1.0)))
                .collect(),
        );
    }
    for _ in 0..links / 8 {
        rows.push((0..2).map(|_| (random.random_range(0..unknowns), random.random_range(-1.0..1.0))).collect());
    }
    rows
}

fn prior(random: &mut ChaCha8Rng, p: usize) -> Prior {
    let values = standard_normals(random, p * (p + 2));
    let root = Mat::from_fn(p, p + 2, |i, j| values[j * p + i]);
    Prior { mean: standard_normals(random, p), covariance: &root * root.transpose() + Mat::<f64>::identity(p, p) }
}

#[test]
fn random_patterns_equal_the_dense_solution_with_and_without_prior_rows() {
    let mut nested = 0;
    for seed in 0..30 {
        let random = &mut stream(seed, "sparse");
        let unknowns = random.random_range(25..220_usize);
        let rows = random_rows(random, unknowns, unknowns, 4);
        let p = seed as usize % 4;
        let system = System::new(random, unknowns, rows, p);
        let prior = prior(random, p);
        for largest_part in [3, 20, 1000] {
            for prior in [None, Some(&prior)] {
                let found = system.difference(prior, largest_part);
                assert!(found < 1e-10, "seed {seed}, parts of {largest_part}, prior {}: {found:e}", prior.is_some());
            }
            nested += usize::from(system.solve(Some(&prior), largest_part).unwrap().partition.separators > 2);
        }
    }
    assert!(nested > 10, "{nested}");
}

/// Unknown values of a grid with a prior of their own each, and overlapping footprints over a swath of it.
fn footprints(random: &mut ChaCha8Rng, nx: usize, ny: usize, sigma: f64, p: usize) -> System {
    let grid = Grid { nx, ny, dx_m: 1.0, dy_m: 1.0, boundary: Boundary::Channel };
    let mut rows: Vec<Vec<(usize, f64)>> = (0..nx * ny).map(|cell| vec![(cell, 1.0)]).collect();
    for line in 0..ny {
        for scan in 0..nx / 2 {
            let x = (nx / 4 + scan) as f64 + 0.3 * random.random_range(0.0..1.0);
            rows.push(footprint(&grid, Location::Center, x, line as f64 + 0.4, sigma));
        }
    }
    System::new(random, nx * ny, rows, p)
}

#[test]
fn satellite_footprints_over_many_cells_equal_the_dense_solution() {
    let random = &mut stream(1, "footprints");
    for (sigma, p) in [(0.5, 0), (0.7, 3), (1.0, 5)] {
        let system = footprints(random, 24, 20, sigma, p);
        let prior = prior(random, p);
        for largest_part in [30, 100, 480] {
            for prior in [None, Some(&prior)] {
                let found = system.difference(prior, largest_part);
                assert!(found < 1e-10, "σ {sigma}, parts of {largest_part}: {found:e}");
            }
        }
        let partition = system.solve(Some(&prior), 30).unwrap().partition;
        assert!(partition.separators > 5 && partition.separator_unknowns < 300, "{partition:?}");
        assert_eq!(system.solve(Some(&prior), 480).unwrap().partition.separators, 0);
    }
}

#[test]
fn large_sparse_parts_equal_the_dense_solution() {
    // A five-point Laplacian and a prior for each value: parts of hundreds of unknowns, with few entries.
    let random = &mut stream(2, "large");
    let (nx, ny) = (30, 28);
    let mut rows: Vec<Vec<(usize, f64)>> = (0..nx * ny).map(|cell| vec![(cell, 0.7)]).collect();
    for cell in 0..nx * ny {
        if cell % nx + 1 < nx {
            rows.push(vec![(cell, 1.0), (cell + 1, -1.0)]);
        }
        if cell + nx < nx * ny {
            rows.push(vec![(cell, 1.0), (cell + nx, -1.0)]);
        }
    }
    let system = System::new(random, nx * ny, rows, 3);
    let prior = prior(random, 3);
    for largest_part in [250, 450, 840] {
        for prior in [None, Some(&prior)] {
            let found = system.difference(prior, largest_part);
            assert!(found < 1e-10, "parts of {largest_part}: {found:e}");
        }
    }
}

#[test]
fn what_the_rows_do_not_determine_is_named() {
    let random = &mut stream(3, "deficient");
    let mut rows = random_rows(random, 40, 60, 3);
    rows.retain(|row| row.iter().all(|entry| entry.0 != 17));
    let system = System::new(random, 40, rows.clone(), 2);
    let error = system.solve(None, 10).err().unwrap();
    assert_eq!(error, Error::RankDeficient { what: "a part of 1 unknowns".into(), rank: 0, size: 1 });
    // Two columns of G that are one and the same.
    rows.push(vec![(17, 1.0)]);
    let mut system = System::new(random, 40, rows, 2);
    for i in 0..system.y.len() {
        system.g[(i, 1)] = system.g[(i, 0)];
    }
    let error = system.solve(None, 10).err().unwrap();
    assert_eq!(error, Error::RankDeficient { what: "the border".into(), rank: 1, size: 2 });
    let known = prior(random, 2);
    assert!(system.difference(Some(&known), 10) < 1e-10);
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let system = footprints(&mut stream(5, "threads"), 24, 20, 0.7, 3);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let solution = pool.install(|| system.solve(None, 40).unwrap());
        let values =
            solution.estimate.iter().chain(&solution.border).copied().chain(pool.install(|| solution.variances()));
        values.map(f64::to_bits).collect::<Vec<_>>()
    };
    assert_eq!(run(1), run(2));
    assert_eq!(run(1), run(8));
}
