//! Where a spectrum is cut.

/// Directions that stand out of the first one left out by less than this share of its eigenvalue are damped.
const MARGIN: f64 = 1e-2;

/// By what each of the `count` leading directions is multiplied that are kept of a spectrum, given its eigenvalues λ in
/// descending order:
///
/// ```text
/// w_i = min(1, (λ_i / λ_(count+1) − 1) / MARGIN)
/// ```
///
/// so that of a group of equal eigenvalues, such as the sine and cosine of a wave on a periodic plane, either all directions
/// are kept or none of them. Kept alone, a part of the group would be whatever direction rounding has picked: the covariance
/// that is kept, f(A) with f(λ) = λ w², would jump with the last bit of A. With these weights f is Lipschitz continuous, and
/// so are f(A) and its root (Bhatia 1997, Matrix Analysis, section X.3). Since w ≤ 1, what is left of A stays positive
/// semidefinite.
pub(crate) fn weights(descending: &[f64], count: usize) -> Vec<f64> {
    let left_out = descending.get(count).copied().unwrap_or(0.0);
    let weight = |value: &f64| {
        if left_out > 0.0 { ((value - left_out) / (MARGIN * left_out)).clamp(0.0, 1.0) } else { 1.0 }
    };
    descending.iter().take(count).map(weight).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_equal_eigenvalues_all_are_kept_or_none() {
        let spectrum = [9.0, 4.0, 4.0, 1.0, 1.0, 1.0 - 1e-15];
        assert_eq!(weights(&spectrum, 1), [1.0]);
        let cut = weights(&spectrum, 2);
        assert_eq!(cut, [1.0, 0.0]);
        assert_eq!(weights(&spectrum, 3), [1.0; 3]);
        let cut = weights(&spectrum, 5);
        assert!(cut[..3] == [1.0; 3] && cut[3..].iter().all(|&weight| weight < 1e-12), "{cut:?}");
        assert_eq!(weights(&spectrum, 6), [1.0; 6]);
        assert_eq!(weights(&[0.0, 0.0], 1), [1.0]);
        assert!((weights(&[1.005, 1.0], 1)[0] - 0.5).abs() < 1e-9);
    }
}
