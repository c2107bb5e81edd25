//! One balloon flight tracked by three sensors with unknown offsets: positions, winds and calibration at once.
//!
//! ```sh
//! cargo run --release -p isobar-assim --example wind_finding -- 100000
//! ```
//!
//! The argument is the number of fixes, 3600 if there is none. The example simulates the flight, prints the offsets that
//! are found beside the true ones, and what a hundredth and a tenth of the flight would have cost.

use isobar_assim::wind_finding::{Fix, Reading, Tracker, find_winds, offset_names, reading_of};
use isobar_model::random::{standard_normals, stream};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let count = match std::env::args().nth(1) {
        None => 3600,
        Some(text) => text.parse().ok().filter(|count| (300..=10_000_000).contains(count)).ok_or_else(|| {
            format!("the number of fixes cannot be \"{text}\": it must be a whole number from 300 to 10000000")
        })?,
    };
    let tracker = |name: &str, place_m, sigma_range_m| Tracker {
        name: name.into(),
        place_m,
        sigma_range_m: Some(sigma_range_m),
        sigma_azimuth_rad: Some(1e-3),
        sigma_elevation_rad: Some(1e-3),
    };
    let trackers = [
        tracker("radar", [0.0, 0.0, 20.0], 20.0),
        tracker("second radar", [30_000.0, 5_000.0, 150.0], 20.0),
        tracker("radiotheodolite", [8_000.0, 25_000.0, 60.0], 500.0),
    ];
    let truth = [25.0, 3e-3, -2e-3, -40.0, -1e-3, 1.5e-3, 300.0, 5e-3, 1e-3];
    let (fixes, _) = simulate(&trackers, &truth, count);
    let flight = find_winds(&trackers, &fixes, None, None)?;
    println!("{count} fixes, {} linearisations, χ²/n {:.4}\n", flight.iterations, flight.chi2_per_degree);
    println!("{:<28}{:>12}{:>12}{:>12}{:>8}", "offset (m, mrad)", "true", "found", "sigma", "z");
    for (i, name) in offset_names(&trackers).iter().enumerate() {
        let unit = if i % 3 == 0 { 1.0 } else { 1e3 };
        let (value, sigma) = (flight.offsets[i], flight.offsets_covariance[(i, i)].sqrt());
        let z = (value - truth[i]) / sigma;
        println!("{name:<28}{:>12.4}{:>12.4}{:>12.4}{z:>8.2}", unit * truth[i], unit * value, unit * sigma);
    }
    println!("\nfixes        seconds   per fix, of that of all");
    let mut seconds = Vec::new();
    for part in [count / 100, count / 10, count] {
        let began = Instant::now();
        find_winds(&trackers, &fixes[..part], None, None)?;
        seconds.push((part, began.elapsed().as_secs_f64()));
    }
    let of_all = seconds[2].1 / seconds[2].0 as f64;
    for (part, seconds) in seconds {
        println!("{part:<10}{seconds:>10.4}{:>10.2}", seconds / part as f64 / of_all);
    }
    Ok(())
}

/// A balloon that rises by 5 m/s for an hour and a half in a wind that turns and grows with height, and the readings.
fn simulate(trackers: &[Tracker], offsets: &[f64], count: usize) -> (Vec<Fix>, Vec<[f64; 3]>) {
    let mut random = stream(1, "wind finding");
    let step = 5400.0 / count as f64;
    let mut position = [5_000.0, -12_000.0, 300.0];
    let mut flown = Vec::with_capacity(count);
    let mut fixes = Vec::with_capacity(count);
    for k in 0..count {
        let angle = 0.3 + position[2] / 20_000.0;
        let speed = 4.0 + position[2] / 2_000.0;
        position[0] += step * speed * angle.cos();
        position[1] += step * speed * angle.sin();
        position[2] += 5.0 * step;
        let reading = |(j, tracker): (usize, &Tracker)| {
            let (exact, errors) = (reading_of(tracker, position).values(), standard_normals(&mut random, 3));
            let read = |i: usize| Some(exact[i]? + offsets[3 * j + i] + tracker.sigmas()[i]? * errors[i]);
            Reading { range_m: read(0), azimuth_rad: read(1), elevation_rad: read(2) }
        };
        fixes.push(Fix { seconds: step * k as f64, readings: trackers.iter().enumerate().map(reading).collect() });
        flown.push(position);
    }
    (fixes, flown)
}
