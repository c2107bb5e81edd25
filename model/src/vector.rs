//! Arithmetic on vectors that are plain slices, each loop once. Sums run from the first element to the last.
//!
//! The operations panic if the lengths of their vectors differ.

/// y += a x.
#[inline(always)]
pub fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    assert_eq!(x.len(), y.len(), "the vectors have different lengths");
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}

/// y += x.
#[inline(always)]
pub fn add(y: &mut [f64], x: &[f64]) {
    assert_eq!(x.len(), y.len(), "the vectors have different lengths");
    y.iter_mut().zip(x).for_each(|(y, x)| *y += x);
}

/// y −= x.
#[inline(always)]
pub fn subtract(y: &mut [f64], x: &[f64]) {
    assert_eq!(x.len(), y.len(), "the vectors have different lengths");
    y.iter_mut().zip(x).for_each(|(y, x)| *y -= x);
}

/// x − y.
pub fn difference(x: &[f64], y: &[f64]) -> Vec<f64> {
    assert_eq!(x.len(), y.len(), "the vectors have different lengths");
    x.iter().zip(y).map(|(x, y)| x - y).collect()
}

/// y ← a y.
#[inline(always)]
pub fn scale(y: &mut [f64], a: f64) {
    y.iter_mut().for_each(|y| *y *= a);
}

/// y ← x y, element by element.
#[inline(always)]
pub fn multiply(y: &mut [f64], x: &[f64]) {
    assert_eq!(x.len(), y.len(), "the vectors have different lengths");
    y.iter_mut().zip(x).for_each(|(y, x)| *y *= x);
}

/// y ← y / x, element by element.
#[inline(always)]
pub fn divide(y: &mut [f64], x: &[f64]) {
    assert_eq!(x.len(), y.len(), "the vectors have different lengths");
    y.iter_mut().zip(x).for_each(|(y, x)| *y /= x);
}

/// The inner product xᵀ y.
#[inline(always)]
pub fn dot(x: &[f64], y: &[f64]) -> f64 {
    assert_eq!(x.len(), y.len(), "the vectors have different lengths");
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

/// The inner product hᵀ x with a sparse row h of (index, value).
pub fn sparse_dot(h: &[(usize, f64)], x: &[f64]) -> f64 {
    h.iter().map(|&(index, value)| value * x[index]).sum()
}

/// The Euclidean norm √(xᵀ x).
pub fn norm(x: &[f64]) -> f64 {
    dot(x, x).sqrt()
}
