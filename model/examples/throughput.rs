//! How fast increments are advanced: column-cell-steps per second of the tangent-linear and the adjoint of shallow
//! water on 32 × 24 cells with 2304 columns (a full-rank covariance factor), nine steps of fourth order.
//!
//! `cargo run --release -p isobar-model --example throughput`

use isobar_model::initial::{self, RandomConfig};
use isobar_model::random::{standard_normals, stream};
use isobar_model::{
    Adjoint, Boundary, ColumnsMut, Duration, Grid, Model, ShallowWater, ShallowWaterParameters, Stepped, TangentLinear,
    Tendency, TimeScheme, VectorInvariant,
};
use std::time::Instant;

fn main() {
    for (hyperdiffusion_m4_per_s, form) in [
        (0.0, VectorInvariant::PotentialEnstrophy),
        (0.0, VectorInvariant::Energy),
        (1e14, VectorInvariant::PotentialEnstrophy),
    ] {
        let grid = Grid { nx: 32, ny: 24, dx_m: 200e3, dy_m: 200e3, boundary: Boundary::Channel };
        let parameters = ShallowWaterParameters {
            gravity_m_per_s2: 9.81,
            coriolis_per_s: 1e-4,
            beta_per_m_per_s: 1.6e-11,
            hyperdiffusion_m4_per_s,
            ..Default::default()
        };
        let tendency = ShallowWater::new(grid, parameters, form).expect("valid parameters");
        let config = RandomConfig { mean_depth_m: 1000.0, height_standard_deviation_m: 30.0, length_scale_m: 600e3 };
        let start = initial::random_balanced(&tendency, &config, &mut stream(1, "truth")).expect("a thin layer");
        let model = Stepped::new(tendency, Duration::from_seconds(600), TimeScheme::Rk4).expect("a positive time step");
        let (len, cells, steps) = (model.layout().len(), model.tendency().layout().grid.cells(), 9);
        let mut columns = standard_normals(&mut stream(1, "columns"), len * len);
        let work = (steps * len * cells) as f64;
        for adjoint in [false, true] {
            let mut x = start.clone();
            let clock = Instant::now();
            if adjoint {
                for _ in 0..steps {
                    model.step_ad(&x, &mut columns);
                    model.step(&mut x);
                }
            } else {
                model.steps_tl(&x, ColumnsMut::Double(&mut columns), steps);
            }
            let seconds = clock.elapsed().as_secs_f64();
            println!(
                "{form:?}, hyperdiffusion {hyperdiffusion_m4_per_s:e}, {}: {seconds:.3} s, {:.3e} column-cell-steps/s",
                if adjoint { "adjoint" } else { "tangent-linear" },
                work / seconds
            );
        }
    }
}
