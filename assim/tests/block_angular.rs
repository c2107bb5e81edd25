//! The block-angular solver equals the dense generalised least-squares solution of the same stacked system.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use isobar_assim::Error;
use isobar_assim::block_angular::{Block, Prior, RegressionRows, Solution, UpdateRows, solve};
use isobar_model::random::{standard_normals, stream};
use rand_chacha::ChaCha8Rng;

fn normal(stream: &mut ChaCha8Rng, rows: usize, columns: usize) -> Mat<f64> {
    let values = standard_normals(stream, rows * columns);
    Mat::from_fn(rows, columns, |i, j| values[j * rows + i])
}

/// A symmetric positive definite matrix with condition of a few hundred.
fn covariance(stream: &mut ChaCha8Rng, n: usize) -> Mat<f64> {
    let root = normal(stream, n, n + 2);
    &root * root.transpose() + Mat::<f64>::identity(n, n) * faer::Scale(0.05)
}

struct Dense {
    estimate: Mat<f64>,
    covariance: Mat<f64>,
    chi2: f64,
}

/// (Z' V⁻¹ Z)⁻¹ Z' V⁻¹ z and its covariance, for blocks of rows (X_k, G_k, y_k, V_k) and prior rows.
fn dense(rows: &[RegressionRows], p: usize, prior: Option<&Prior>) -> Dense {
    let m: usize = rows.iter().map(|rows| rows.x.ncols()).sum();
    let extra = if prior.is_some() { p } else { 0 };
    let n: usize = rows.iter().map(|rows| rows.y.len()).sum::<usize>() + extra;
    let (mut z, mut y, mut v) = (Mat::zeros(n, m + p), Mat::zeros(n, 1), Mat::zeros(n, n));
    let (mut row, mut column) = (0, 0);
    for rows in rows {
        let (n_k, m_k) = (rows.x.nrows(), rows.x.ncols());
        z.as_mut().submatrix_mut(row, column, n_k, m_k).copy_from(&rows.x);
        z.as_mut().submatrix_mut(row, m, n_k, p).copy_from(&rows.g);
        v.as_mut().submatrix_mut(row, row, n_k, n_k).copy_from(&rows.v);
        (0..n_k).for_each(|i| y[(row + i, 0)] = rows.y[i]);
        row += n_k;
        column += m_k;
    }
    if let Some(prior) = prior {
        (0..p).for_each(|i| z[(row + i, m + i)] = 1.0);
        (0..p).for_each(|i| y[(row + i, 0)] = prior.mean[i]);
        v.as_mut().submatrix_mut(row, row, p, p).copy_from(&prior.covariance);
    }
    let llt = v.llt(Side::Lower).unwrap();
    let information = z.transpose() * llt.solve(&z);
    let covariance = information.llt(Side::Lower).unwrap().inverse();
    let estimate = &covariance * (z.transpose() * llt.solve(&y));
    let residual = &y - &z * &estimate;
    let chi2 = (residual.transpose() * llt.solve(&residual))[(0, 0)];
    Dense { estimate, covariance, chi2 }
}

/// Estimates and the whole covariance of (b_1 … b_K, c) from the factored form.
fn assemble(solution: &Solution) -> (Mat<f64>, Mat<f64>) {
    let p = solution.border.len();
    let m: usize = solution.blocks.iter().map(|block| block.estimate.len()).sum();
    let mut gamma = Mat::<f64>::zeros(m + p, p);
    let mut covariance = Mat::<f64>::zeros(m + p, m + p);
    let mut estimate = Mat::<f64>::zeros(m + p, 1);
    let mut start = 0;
    for block in &solution.blocks {
        let size = block.estimate.len();
        gamma.as_mut().submatrix_mut(start, 0, size, p).copy_from(-&block.sensitivity);
        covariance.as_mut().submatrix_mut(start, start, size, size).copy_from(&block.covariance);
        (0..size).for_each(|i| estimate[(start + i, 0)] = block.estimate[i]);
        start += size;
    }
    (0..p).for_each(|i| gamma[(m + i, i)] = 1.0);
    (0..p).for_each(|i| estimate[(m + i, 0)] = solution.border[i]);
    covariance += &gamma * &solution.border_covariance * gamma.transpose();
    (estimate, covariance)
}

fn relative_difference(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    (a - b).norm_max() / b.norm_max()
}

fn random_rows(stream: &mut ChaCha8Rng, n: usize, m: usize, p: usize) -> RegressionRows {
    RegressionRows {
        x: normal(stream, n, m),
        g: normal(stream, n, p),
        y: standard_normals(stream, n),
        v: covariance(stream, n),
    }
}

/// The regression form \[H; I\], diag(R, P) of update rows with the given H, P, R, and the update rows themselves.
fn random_update(stream: &mut ChaCha8Rng, n: usize, m: usize, p: usize) -> (RegressionRows, UpdateRows) {
    let (h, prior, r) = (normal(stream, n, m), covariance(stream, m), covariance(stream, n));
    let (g, d) = (normal(stream, n, p), standard_normals(stream, n));
    let x = Mat::from_fn(n + m, m, |i, j| if i < n { h[(i, j)] } else { f64::from(i - n == j) });
    let wide_g = Mat::from_fn(n + m, p, |i, j| if i < n { g[(i, j)] } else { 0.0 });
    let y = d.iter().copied().chain((0..m).map(|_| 0.0)).collect();
    let mut v = Mat::zeros(n + m, n + m);
    v.as_mut().submatrix_mut(0, 0, n, n).copy_from(&r);
    v.as_mut().submatrix_mut(n, n, m, m).copy_from(&prior);
    let cross = &prior * h.transpose();
    let innovation = &h * &cross + &r;
    (RegressionRows { x, g: wide_g, y, v }, UpdateRows { prior, cross, innovation, g, d })
}

#[test]
fn regression_equals_dense_least_squares_with_and_without_prior_rows() {
    for seed in 0..20 {
        let random = &mut stream(seed, "regression");
        let p = 1 + seed as usize % 5;
        // Blocks of unequal size; some barely determined by their own rows, one with as many rows as unknowns.
        let sizes = [(4, 1), (9, 3), (7, 6), (12, 2), (5, 5), (20, 7)];
        let rows: Vec<RegressionRows> = sizes.iter().map(|&(n, m)| random_rows(random, n, m, p)).collect();
        let prior = Prior { mean: standard_normals(random, p), covariance: covariance(random, p) };
        let blocks: Vec<Block> = rows.iter().cloned().map(Block::Regression).collect();
        for prior in [None, Some(&prior)] {
            let expected = dense(&rows, p, prior);
            let solution = solve(&blocks, p, prior).unwrap();
            let (estimate, covariance) = assemble(&solution);
            assert!(relative_difference(&estimate, &expected.estimate) < 1e-10);
            assert!(relative_difference(&covariance, &expected.covariance) < 1e-10);
            assert!((solution.residual_chi2 / expected.chi2 - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn covariance_form_equals_regression_form() {
    for seed in 0..20 {
        let random = &mut stream(seed, "update");
        let p = seed as usize % 4;
        let pairs: Vec<_> =
            [(1, 3), (6, 2), (4, 9), (3, 3)].iter().map(|&(n, m)| random_update(random, n, m, p)).collect();
        let prior = Prior { mean: standard_normals(random, p), covariance: covariance(random, p) };
        let rows: Vec<RegressionRows> = pairs.iter().map(|pair| pair.0.clone()).collect();
        // Both forms side by side in one system.
        let blocks: Vec<Block> = pairs
            .into_iter()
            .enumerate()
            .map(|(k, (rows, update))| if k == 1 { Block::Regression(rows) } else { Block::Update(update) })
            .collect();
        let expected = dense(&rows, p, Some(&prior));
        let solution = solve(&blocks, p, Some(&prior)).unwrap();
        let (estimate, covariance) = assemble(&solution);
        assert!(relative_difference(&estimate, &expected.estimate) < 1e-10);
        assert!(relative_difference(&covariance, &expected.covariance) < 1e-10);
        assert!((solution.residual_chi2 / expected.chi2 - 1.0).abs() < 1e-9);
    }
}

#[test]
fn a_singular_prior_of_a_block_is_no_obstacle() {
    let random = &mut stream(7, "singular");
    // P of rank 2 on 4 unknowns: b = F a, a ~ N(0, I), so the dense problem in a is regular.
    let (f, h, g) = (normal(random, 4, 2), normal(random, 5, 4), normal(random, 5, 3));
    let (d, r) = (standard_normals(random, 5), covariance(random, 5));
    let prior = Prior { mean: vec![0.0; 3], covariance: covariance(random, 3) };
    let p = &f * f.transpose();
    let cross = &p * h.transpose();
    let innovation = &h * &cross + &r;
    let block = Block::Update(UpdateRows { prior: p, cross, innovation, g: g.clone(), d: d.clone() });
    let solution = solve(&[block], 3, Some(&prior)).unwrap();
    let reduced = &h * &f;
    let x = Mat::from_fn(7, 2, |i, j| if i < 5 { reduced[(i, j)] } else { f64::from(i - 5 == j) });
    let wide_g = Mat::from_fn(7, 3, |i, j| if i < 5 { g[(i, j)] } else { 0.0 });
    let mut v = Mat::<f64>::identity(7, 7);
    v.as_mut().submatrix_mut(0, 0, 5, 5).copy_from(&r);
    let rows = RegressionRows { x, g: wide_g, y: d.into_iter().chain([0.0, 0.0]).collect(), v };
    let expected = dense(&[rows], 3, Some(&prior));
    let (_, covariance) = assemble(&solution);
    let lift = Mat::from_fn(7, 5, |i, j| {
        if i < 4 && j < 2 {
            f[(i, j)]
        } else if i >= 4 && j >= 2 {
            f64::from(i - 4 == j - 2)
        } else {
            0.0
        }
    });
    assert!(relative_difference(&covariance, &(&lift * &expected.covariance * lift.transpose())) < 1e-10);
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let random = &mut stream(3, "threads");
    let blocks: Vec<Block> = (0..50).map(|k| Block::Update(random_update(random, 1 + k % 7, 3, 6).1)).collect();
    let prior = Prior { mean: vec![0.5; 6], covariance: covariance(random, 6) };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (estimate, covariance) = pool.install(|| assemble(&solve(&blocks, 6, Some(&prior)).unwrap()));
        estimate.col_as_slice(0).iter().chain(covariance.col_as_slice(0)).map(|x| x.to_bits()).collect::<Vec<_>>()
    };
    assert_eq!(run(1), run(2));
    assert_eq!(run(1), run(8));
}

#[test]
fn what_the_rows_do_not_determine_is_named() {
    let random = &mut stream(1, "deficient");
    let mut rows = random_rows(random, 6, 3, 2);
    for i in 0..6 {
        rows.x[(i, 2)] = rows.x[(i, 0)] - 2.0 * rows.x[(i, 1)];
    }
    let good = Block::Regression(random_rows(random, 9, 3, 2));
    let bad = Block::Regression(rows);
    assert_eq!(
        solve(&[good.clone(), bad], 2, None).unwrap_err(),
        Error::RankDeficient { what: "block 1".into(), rank: 2, size: 3 }
    );
    // Three rows less three unknowns leave nothing for the border.
    let empty = Block::Regression(random_rows(random, 3, 3, 2));
    assert_eq!(
        solve(&[empty], 2, None).unwrap_err(),
        Error::RankDeficient { what: "the border".into(), rank: 0, size: 2 }
    );
    let mut indefinite = random_rows(random, 5, 2, 2);
    indefinite.v[(3, 3)] = -1.0;
    let error = solve(&[good, Block::Regression(indefinite)], 2, None).unwrap_err();
    assert!(error.to_string().contains("error covariance V of block 1 is not positive definite"), "{error}");
}
