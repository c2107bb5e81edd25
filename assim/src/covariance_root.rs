//! The columns by which a method carries the covariance of its errors.

/// What the columns of a [`CovarianceRoot`] are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RootKind {
    /// The members of an ensemble: with x̄ their mean, P = Σ (xⱼ − x̄)(xⱼ − x̄)ᵀ/(N − 1).
    Members,
    /// Common factors: P = Φ Φᵀ + a part within the blocks (Lange, WO 97/18442).
    Factors,
}

/// A method that carries the covariance of its errors, or what blocks have in common of it, as columns over (x, c).
pub trait CovarianceRoot {
    /// What the columns are.
    fn kind(&self) -> RootKind;

    /// Their number N.
    fn columns(&self) -> usize;

    /// A column after the last forecast or analysis: its state `[m]`, each value in its variable's unit, and its calibration
    /// parameters `[p]` in theirs; none of a method that does not estimate them.
    ///
    /// # Panics
    /// If there is no column of this number.
    fn column(&self, number: usize) -> (Vec<f64>, Vec<f64>);
}
