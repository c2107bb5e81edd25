//! The perturbations in some rows of cells, before and after the analyses.

use super::batch::Batch;

/// Perturbations that become analysed deviations: of the state's values, variable by variable, of local parameters, and of
/// shared ones in the analyses of each row; then those of the earlier ensembles.
pub(super) struct Perturbations {
    /// Rows of one ensemble.
    pub rows: usize,
    pub ensembles: usize,
    /// From one member to the next: an odd number of cache lines, so that the members of one row are in different sets of the
    /// cache.
    pub stride: usize,
    /// `[N, stride]`.
    pub before: Vec<f64>,
    /// `[N + 1, stride]`, with the shift of the mean last.
    pub after: Vec<f64>,
}

impl Perturbations {
    /// Analyses the rows of some places, each row with a weight, and the same rows of earlier ensembles; adds the results, times
    /// their weights.
    pub fn analyse(
        &mut self,
        batch: &mut Batch<'_>,
        here: &[(f64, f64)],
        factors: &mut [f64],
        rows: &[Vec<(usize, f64)>],
    ) {
        let (lanes, most) = (rows.len(), rows.iter().map(Vec::len).max().unwrap_or(0));
        let members = self.before.len() / self.stride;
        // Places with fewer rows than `most` are filled up with rows of weight 0.
        let of_lanes = |vector: usize| {
            let (first, vector) = (vector / most * self.rows, vector % most);
            rows.iter().map(move |rows| rows.get(vector).map_or((0, 0.0), |&(row, weight)| (first + row, weight)))
        };
        let x = batch.perturbations(self.ensembles * most);
        for (vector, x) in x.chunks_exact_mut(members * lanes).enumerate() {
            for (x, values) in x.chunks_exact_mut(lanes).zip(self.before.chunks_exact(self.stride)) {
                x.iter_mut().zip(of_lanes(vector)).for_each(|(x, (row, _))| *x = values[row]);
            }
        }
        let analysed = batch.analyse(here, factors, most);
        for (vector, analysed) in analysed.chunks_exact((members + 1) * lanes).enumerate() {
            for (analysed, values) in analysed.chunks_exact(lanes).zip(self.after.chunks_exact_mut(self.stride)) {
                analysed.iter().zip(of_lanes(vector)).for_each(|(value, (row, weight))| values[row] += weight * value);
            }
        }
    }
}
