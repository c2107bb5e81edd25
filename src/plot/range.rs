//! Round ranges for colours and axes.

/// The value below which the given part of the finite values lie.
pub fn quantile(mut values: Vec<f32>, part: f32) -> Option<f32> {
    values.retain(|value| value.is_finite());
    let last = values.len().checked_sub(1)?;
    let (_, value, _) = values.select_nth_unstable_by((last as f32 * part) as usize, f32::total_cmp);
    Some(*value)
}

/// 1, 1.5, 2, 3, 4, 5, 6 or 8 times a power of ten, at or above the value.
pub fn round_up(value: Option<f32>) -> f32 {
    let value = value.filter(|&value| value > 0.0).unwrap_or(1.0);
    let power = 10f32.powf(value.log10().floor());
    let steps = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0];
    steps.into_iter().map(|step| step * power).find(|&rounded| rounded >= value * 0.9999).unwrap_or(value)
}

/// A step of 1, 2 or 5 times a power of ten, such that a length has at most six of them.
pub fn tick_step(length: f64) -> f64 {
    let least = if length.is_finite() && length > 0.0 { length / 6.0 } else { 1.0 };
    let power = 10f64.powf(least.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * power >= 0.9999 * least).unwrap_or(10.0);
    step * power
}

/// The multiples of a step between two values, both included.
pub fn multiples(step: f64, [low, high]: [f64; 2]) -> impl Iterator<Item = f64> {
    let first = (low / step).ceil() as i64;
    (first..).map(move |number| number as f64 * step).take_while(move |&value| value <= high)
}

/// Round values at or beyond both ends.
pub fn around(low: f32, high: f32) -> [f32; 2] {
    let unit = round_up(Some((high - low) / 20.0));
    let [from, to] = [(low / unit).floor() * unit, (high / unit).ceil() * unit];
    if from < to { [from, to] } else { [low - 0.5 - low.abs() * 1e-3, high + 0.5 + high.abs() * 1e-3] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_at_round_values() {
        for (length, step) in [(6.0, 1.0), (3.3, 1.0), (5180.0, 1000.0), (0.7, 0.2), (25.0, 5.0), (0.0, 1.0)] {
            assert!((tick_step(length) / step - 1.0).abs() < 1e-9, "{length}: {}", tick_step(length));
        }
    }

    #[test]
    fn limits_are_round_and_large_enough() {
        for (value, expected) in [(0.7, 0.8), (1.0, 1.0), (1.2, 1.5), (37.0, 40.0), (8200.0, 10_000.0), (0.0, 1.0)] {
            assert!((round_up(Some(value)) / expected - 1.0).abs() < 1e-6, "{value}: {}", round_up(Some(value)));
        }
        assert_eq!(around(5212.0, 5648.0), [5190.0, 5670.0]);
        let [from, to] = around(10.0, 10.0);
        assert!(from < 10.0 && to > 10.0);
    }

    #[test]
    fn quantiles_leave_out_what_is_no_number() {
        assert_eq!(quantile(vec![3.0, f32::NAN, 1.0, 2.0, f32::INFINITY], 0.5), Some(2.0));
        assert_eq!(quantile(vec![f32::NAN], 0.5), None);
    }
}
