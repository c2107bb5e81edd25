//! The contract battery over every model, boundary, form, scheme and kind of linearisation point.

use crate::common::{BOUNDARIES, FORMS, SCHEMES, grid, jet, parameters, perturbed_jet, stepped, turbulence};
use isobar_model::initial::{self, GaussianHill};
use isobar_model::testing::check_contract;
use isobar_model::{
    Adjoint, Advection, AdvectionScheme, Boundary, Duration, ExactShift, LinearShallowWater, Model, ShallowWater,
    ShallowWaterParameters, State, Tendency, Wind,
};

/// Without damping, with drag, and with hyperdiffusion as well.
fn dampings(boundary: Boundary) -> [ShallowWaterParameters; 3] {
    let dragged = ShallowWaterParameters { drag_per_s: 1e-6, ..parameters(boundary) };
    let damped = ShallowWaterParameters { hyperdiffusion_m4_per_s: 5e14, ..dragged };
    [parameters(boundary), dragged, damped]
}

#[test]
fn nonlinear_shallow_water_keeps_the_contract() {
    for boundary in BOUNDARIES {
        for (form, scheme) in FORMS.into_iter().flat_map(|form| SCHEMES.map(|scheme| (form, scheme))) {
            for parameters in dampings(boundary) {
                let tendency = ShallowWater::new(grid(14, 11, boundary), parameters, form).unwrap();
                for at in [perturbed_jet(&tendency), turbulence(&tendency)] {
                    let contract = check_contract(&stepped(tendency.clone(), 200, scheme), &at);
                    assert!(contract.taylor_decades >= Some(4), "a nonlinear model: {contract:?}");
                }
            }
        }
    }
}

#[test]
fn linear_shallow_water_keeps_the_contract_and_is_linear() {
    for boundary in BOUNDARIES {
        for (form, scheme) in FORMS.into_iter().flat_map(|form| SCHEMES.map(|scheme| (form, scheme))) {
            for parameters in dampings(boundary) {
                let nonlinear = ShallowWater::new(grid(14, 11, boundary), parameters, form).unwrap();
                let at = perturbed_jet(&nonlinear);
                let basic_state = initial::geostrophic_jet(&nonlinear, &jet(&nonlinear)).unwrap();
                let uniform = LinearShallowWater::about_uniform_flow(nonlinear.clone(), 1000.0, 15.0).unwrap();
                let zonal = LinearShallowWater::about_steady_flow(nonlinear, basic_state).unwrap();
                for tendency in [uniform, zonal] {
                    let contract = check_contract(&stepped(tendency, 200, scheme), &at);
                    assert_eq!(contract.taylor_decades, None, "a linear model");
                }
            }
        }
    }
}

fn hill(grid: &isobar_model::Grid) -> State {
    let hill = GaussianHill { center_x_m: 400e3, center_y_m: 500e3, amplitude: 2.0, radius_m: 250e3 };
    initial::gaussian_hills(&isobar_model::advection::layout(grid.clone()), 1.0, &[hill]).unwrap()
}

#[test]
fn advection_keeps_the_contract_and_is_linear() {
    use AdvectionScheme::{FirstOrderUpwind, FourthOrderCentred, ThirdOrderUpwind};
    for boundary in BOUNDARIES {
        let v_m_per_s = if boundary == Boundary::Channel { 0.0 } else { -20.0 };
        let jet = Wind::Jet { u_m_per_s: 10.0, jet_m_per_s: 20.0, center_y_m: 3e5, half_width_m: 4e5 };
        for wind in [Wind::Uniform { u_m_per_s: 30.0, v_m_per_s }, Wind::Vortex { speed_m_per_s: 40.0 }, jet] {
            for kind in [FirstOrderUpwind, ThirdOrderUpwind, FourthOrderCentred] {
                for scheme in SCHEMES {
                    let grid = grid(9, 12, boundary);
                    let model = stepped(Advection::new(grid.clone(), &wind, kind).unwrap(), 600, scheme);
                    assert_eq!(check_contract(&model, &hill(&grid)).taylor_decades, None);
                }
            }
        }
    }
}

#[test]
fn the_exact_shift_keeps_the_contract_and_is_linear() {
    let grid = grid(9, 12, Boundary::Periodic);
    for (columns, rows) in [(1, 0), (-2, 5), (0, 0), (31, -14)] {
        let model = ExactShift::new(grid.clone(), columns, rows, Duration::from_seconds(60)).unwrap();
        assert_eq!(check_contract(&model, &hill(&grid)).taylor_decades, None);
    }
}

/// A model with one thing broken, to see the battery catch it.
struct Broken<M> {
    model: M,
    in_tangent_linear: f64,
    in_adjoint: f64,
}

impl<M: Model> Model for Broken<M> {
    fn layout(&self) -> &std::sync::Arc<isobar_model::Layout> {
        self.model.layout()
    }
    fn time_step(&self) -> Duration {
        self.model.time_step()
    }
    fn largest_time_step_s(&self, x: &State) -> f64 {
        self.model.largest_time_step_s(x)
    }
    fn step(&self, x: &mut State) {
        self.model.step(x);
    }
}

impl<M: isobar_model::TangentLinear> isobar_model::TangentLinear for Broken<M> {
    fn step_tl(&self, at: &State, columns: &mut [f64]) {
        self.model.step_tl(at, columns);
        columns.chunks_exact_mut(self.layout().len()).for_each(|column| column[3] *= 1.0 + self.in_tangent_linear);
    }
}

impl<M: Adjoint> Adjoint for Broken<M> {
    fn step_ad(&self, at: &State, columns: &mut [f64]) {
        columns.chunks_exact_mut(self.layout().len()).for_each(|column| column[3] *= 1.0 + self.in_adjoint);
        self.model.step_ad(at, columns);
    }
}

fn outcome(in_tangent_linear: f64, in_adjoint: f64) -> std::thread::Result<()> {
    std::panic::catch_unwind(|| {
        let tendency = crate::common::shallow_water(8, 8, Boundary::Periodic, FORMS[0]);
        let at = turbulence(&tendency);
        assert_eq!(tendency.layout().len(), at.values().len());
        let model = stepped(tendency, 200, SCHEMES[0]);
        check_contract(&Broken { model, in_tangent_linear, in_adjoint }, &at);
    })
}

#[test]
fn the_battery_catches_an_error_of_a_millionth_in_one_value() {
    assert!(outcome(0.0, 0.0).is_ok());
    assert!(outcome(0.0, 1e-6).is_err(), "a wrong adjoint");
    assert!(outcome(1e-4, 1e-4).is_err(), "a wrong tangent-linear with the adjoint to match");
}
