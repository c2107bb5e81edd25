//! Conservation, and states that must not change.

use crate::common::{
    BOUNDARIES, FORMS, SCHEMES, difference, jet, largest, norm, perturbed_jet, shallow_water, stepped, turbulence,
};
use isobar_model::forecast::forecast;
use isobar_model::initial;
use isobar_model::invariants::{mass_m3, potential_enstrophy, total_energy};
use isobar_model::shallow_water::{U, V};
use isobar_model::{
    Boundary, LinearShallowWater, Model, ShallowWater, ShallowWaterParameters, State, TangentLinear, TimeScheme,
    VectorInvariant,
};

/// Relative change of an invariant over twelve hours.
fn drift(
    tendency: &ShallowWater,
    start: &State,
    scheme: TimeScheme,
    step_s: i64,
    invariant: fn(&ShallowWater, &State) -> f64,
) -> f64 {
    let mut x = start.clone();
    forecast(&stepped(tendency.clone(), step_s, scheme), &mut x, (43_200 / step_s) as usize).unwrap();
    assert!(norm(&difference(x.values(), start.values())) > 10.0, "the state must have changed");
    (invariant(tendency, &x) - invariant(tendency, start)) / invariant(tendency, start)
}

#[test]
fn mass_is_conserved_to_rounding_with_and_without_damping() {
    for boundary in BOUNDARIES {
        for form in FORMS {
            let free = shallow_water(16, 14, boundary, form);
            let damped =
                ShallowWaterParameters { drag_per_s: 1e-5, hyperdiffusion_m4_per_s: 5e14, ..*free.parameters() };
            let damped = ShallowWater::new(crate::common::grid(16, 14, boundary), damped, form).unwrap();
            for tendency in [free, damped] {
                let drift = drift(&tendency, &perturbed_jet(&tendency), TimeScheme::Rk4, 240, mass_m3);
                assert!(drift.abs() < 1e-14, "{boundary:?} {form:?}: {drift:e}");
            }
        }
    }
}

/// The drift of Runge–Kutta schemes falls at least with their order in Δt.
fn assert_drift_is_of_the_scheme(tendency: &ShallowWater, start: &State, invariant: fn(&ShallowWater, &State) -> f64) {
    for scheme in SCHEMES {
        let drifts = [200, 100, 50].map(|step_s| drift(tendency, start, scheme, step_s, invariant).abs());
        // Below that it is rounding.
        for pair in drifts.windows(2).filter(|pair| pair[1] > 1e-12 || pair[0] > 1e-11) {
            let order = (pair[0] / pair[1]).log2();
            assert!(order > f64::from(scheme.order()) - 0.2, "{scheme:?}: order {order:.2} of {drifts:?}");
        }
        assert!(drifts[2] < 1e-4, "{scheme:?}: {drifts:?}");
    }
}

#[test]
fn the_energy_form_conserves_energy_but_for_the_time_scheme() {
    for boundary in BOUNDARIES {
        let tendency = shallow_water(16, 14, boundary, VectorInvariant::Energy);
        assert_drift_is_of_the_scheme(&tendency, &turbulence(&tendency), total_energy);
    }
}

#[test]
fn the_potential_enstrophy_form_conserves_potential_enstrophy_but_for_the_time_scheme() {
    let tendency = shallow_water(16, 14, Boundary::Periodic, VectorInvariant::PotentialEnstrophy);
    assert_drift_is_of_the_scheme(&tendency, &turbulence(&tendency), potential_enstrophy);
}

/// d(invariant)/dt along the exact tendency, by a centred difference, relative to the invariant, per day.
fn rate_per_day(form: VectorInvariant, boundary: Boundary, invariant: fn(&ShallowWater, &State) -> f64) -> f64 {
    use isobar_model::Tendency;
    let tendency = shallow_water(16, 14, boundary, form);
    let at = turbulence(&tendency);
    let mut slope = vec![0.0; at.values().len()];
    tendency.tendency(at.values(), &mut slope, &mut vec![0.0; tendency.scratch_len()]);
    let [later, earlier] = [10.0, -10.0].map(|seconds| {
        let mut x = at.clone();
        x.values_mut().iter_mut().zip(&slope).for_each(|(x, slope)| *x += seconds * slope);
        invariant(&tendency, &x)
    });
    (later - earlier) / 20.0 / invariant(&tendency, &at) * 86_400.0
}

#[test]
fn each_form_conserves_its_own_invariant_and_not_the_other() {
    use VectorInvariant::{Energy, PotentialEnstrophy};
    for boundary in BOUNDARIES {
        let (own, other) =
            (rate_per_day(Energy, boundary, total_energy), rate_per_day(PotentialEnstrophy, boundary, total_energy));
        assert!(own.abs() < 1e-3 * other.abs(), "energy, {boundary:?}: {own:e} {other:e}");
    }
    let own = rate_per_day(PotentialEnstrophy, Boundary::Periodic, potential_enstrophy);
    let other = rate_per_day(Energy, Boundary::Periodic, potential_enstrophy);
    assert!(own.abs() < 1e-3 * other.abs(), "potential enstrophy: {own:e} {other:e}");
}

#[test]
fn rest_stays_exactly_at_rest() {
    for boundary in BOUNDARIES {
        for form in FORMS {
            for scheme in SCHEMES {
                let free = shallow_water(8, 9, boundary, form);
                let parameters =
                    ShallowWaterParameters { hyperdiffusion_m4_per_s: 5e14, drag_per_s: 1e-5, ..*free.parameters() };
                let tendency = ShallowWater::new(crate::common::grid(8, 9, boundary), parameters, form).unwrap();
                let start = initial::rest(&tendency, 750.0).unwrap();
                let mut x = start.clone();
                forecast(&stepped(tendency, 200, scheme), &mut x, 50).unwrap();
                assert_eq!(x, start);
            }
        }
    }
}

#[test]
fn the_wall_stays_closed_even_if_a_state_or_an_increment_says_otherwise() {
    for form in FORMS {
        let tendency = shallow_water(10, 8, Boundary::Channel, form);
        let mut x = turbulence(&tendency);
        x.field_mut(V)[3] = 5.0;
        let mut dx = vec![0.1; x.values().len()];
        let model = stepped(tendency, 200, TimeScheme::Rk4);
        model.step_tl(&x, &mut dx);
        model.step(&mut x);
        assert!(x.field(V).row(0).iter().all(|&v| v == 0.0));
        assert!(dx[2 * 80..2 * 80 + 10].iter().all(|&v| v == 0.0));
        assert!(x.field(V).row(1).iter().all(|&v| v != 0.0));
    }
}

#[test]
fn the_jet_is_steady_to_rounding() {
    for boundary in BOUNDARIES {
        for form in FORMS {
            let tendency = shallow_water(12, 24, boundary, form);
            let start = initial::geostrophic_jet(&tendency, &jet(&tendency)).unwrap();
            assert!(largest(&start.values()[U * 288..V * 288]) > 20.0);
            let h = start.field(0);
            assert!((h.mean().unwrap() - 1000.0).abs() < 1e-9, "{:?}", h.mean());
            assert!(h[[0, 0]] - h[[23, 0]] > if boundary == Boundary::Channel { 100.0 } else { -100.0 });
            let mut x = start.clone();
            forecast(&stepped(tendency, 200, TimeScheme::Rk4), &mut x, 36).unwrap();
            let change = difference(x.values(), start.values());
            assert!(largest(&change[..288]) < 1e-9, "{boundary:?} h: {:e}", largest(&change[..288]));
            assert!(largest(&change[288..]) < 1e-10, "{boundary:?} winds: {:e}", largest(&change[288..]));
        }
    }
}

#[test]
fn a_linear_model_keeps_its_basic_state_exactly() {
    let nonlinear = shallow_water(12, 16, Boundary::Channel, VectorInvariant::PotentialEnstrophy);
    let jet = initial::geostrophic_jet(&nonlinear, &jet(&nonlinear)).unwrap();
    let linear = LinearShallowWater::about_steady_flow(nonlinear.clone(), jet.clone()).unwrap();
    let model = stepped(linear, 200, TimeScheme::SspRk3);
    let mut x = jet.clone();
    model.step(&mut x);
    assert_eq!(x, jet);
    let unsteady = LinearShallowWater::about_steady_flow(nonlinear.clone(), perturbed_jet(&nonlinear));
    assert!(matches!(unsteady, Err(isobar_model::ModelError::NotSteady { .. })), "{unsteady:?}");
}

#[test]
fn damping_takes_energy_away() {
    let free = shallow_water(16, 14, Boundary::Periodic, VectorInvariant::Energy);
    let start = turbulence(&free);
    for damping in [(1e-5, 0.0), (0.0, 5e15)] {
        let parameters =
            ShallowWaterParameters { drag_per_s: damping.0, hyperdiffusion_m4_per_s: damping.1, ..*free.parameters() };
        let damped =
            ShallowWater::new(crate::common::grid(16, 14, Boundary::Periodic), parameters, VectorInvariant::Energy)
                .unwrap();
        let mut x = start.clone();
        forecast(&stepped(damped, 200, TimeScheme::Rk4), &mut x, 100).unwrap();
        let kinetic = |x: &State| norm(&x.values()[224..]);
        assert!(kinetic(&x) < 0.95 * kinetic(&start), "{damping:?}: {} {}", kinetic(&x), kinetic(&start));
    }
}

#[test]
fn the_invariants_of_rest_are_those_of_the_formula() {
    for boundary in BOUNDARIES {
        let plane = ShallowWaterParameters { beta_per_m_per_s: 0.0, ..crate::common::parameters(boundary) };
        let grid = crate::common::grid(8, 9, boundary);
        let tendency = ShallowWater::new(grid.clone(), plane, VectorInvariant::Energy).unwrap();
        let rest = initial::rest(&tendency, 750.0).unwrap();
        let area_m2 = grid.width_m() * grid.height_m();
        let close = |value: f64, expected: f64| (value / expected - 1.0).abs() < 1e-13;
        assert!(close(mass_m3(&tendency, &rest), 750.0 * area_m2));
        assert!(close(total_energy(&tendency, &rest), 0.5 * 9.81 * 750.0 * 750.0 * area_m2));
        assert!(close(potential_enstrophy(&tendency, &rest), 0.5 * 1e-8 / 750.0 * area_m2), "{boundary:?}");
    }
}

#[test]
fn the_coriolis_parameter_is_f0_in_the_middle_of_the_channel() {
    let tendency = shallow_water(8, 10, Boundary::Channel, VectorInvariant::Energy);
    assert_eq!(tendency.coriolis_per_s(5), 1e-4);
    assert!((tendency.coriolis_per_s(10) - (1e-4 + 1.6e-11 * 400e3)).abs() < 1e-18);
    assert!((tendency.coriolis_per_s(0) - (1e-4 - 1.6e-11 * 400e3)).abs() < 1e-18);
}
