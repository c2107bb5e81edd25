//! What goes into an analysis, and what comes out of it beside the covariance.

use crate::block_angular::PartitionReport;
use faer::Mat;
use isobar_obs::SparseRows;

/// The Jacobians by block variables b and shared parameters c.
pub(crate) struct SplitRows {
    pub block: SparseRows,
    pub shared: SparseRows,
}

/// What an analysis adds to the estimate.
pub(crate) struct Increments {
    /// To the block variables: the state's values, then the local parameters.
    pub of_blocks: Vec<f64>,
    /// To the shared parameters.
    pub of_shared: Vec<f64>,
}

/// What an analysis came to beside the covariance.
pub(crate) struct BlockAnalysis {
    pub increments: Increments,
    /// dᵀ Cov(d)⁻¹ d.
    pub chi2: f64,
    pub partition: PartitionReport,
    /// What it says of the amplitudes of free columns, if there are any.
    pub found: Option<Found>,
}

/// The solution of an analysis, before its partition is reported.
pub(super) struct Solved {
    pub increments: Increments,
    pub chi2: f64,
    pub found: Option<Found>,
}

impl Solved {
    pub fn with(self, partition: PartitionReport) -> BlockAnalysis {
        let Self { increments, chi2, found } = self;
        BlockAnalysis { increments, chi2, partition, found }
    }
}

/// What an analysis says of the amplitudes C of free columns: see `free_columns`.
pub(crate) struct Found {
    /// J.
    pub matrix: Mat<f64>,
    /// j.
    pub vector: Vec<f64>,
    /// By how much dᵀ Cov(d)⁻¹ d is larger for C = 0 than with the nominal prior.
    pub chi2_of_zero: f64,
}
