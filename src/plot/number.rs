//! Numbers and units as text.

/// A number as short as its first four digits allow.
pub fn number<N: Into<f64>>(value: N) -> String {
    let value = value.into();
    if !value.is_finite() {
        return value.to_string();
    }
    if value != 0.0 && !(1e-4..1e7).contains(&value.abs()) {
        return format!("{value:.3e}");
    }
    let digits = if value == 0.0 { 0 } else { (3 - value.abs().log10().floor() as i32).clamp(0, 9) };
    let text = format!("{value:.*}", digits as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// A number with its unit; without one where that is 1.
pub fn with_unit(number: impl std::fmt::Display, udunits: &str) -> String {
    if udunits == "1" { number.to_string() } else { format!("{number} {}", unit(udunits)) }
}

/// A unit in UDUNITS spelling as it is printed, on one line: `m s⁻¹` for `m s-1`.
pub fn unit(udunits: &str) -> String {
    let power = |text: &str| text.replace("-1", "⁻¹").replace("-2", "⁻²").replace("-3", "⁻³");
    power(udunits).replace(' ', "\u{a0}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_do_not_break() {
        assert_eq!(["m s-1", "m", "kg m-3"].map(unit), ["m\u{a0}s⁻¹", "m", "kg\u{a0}m⁻³"]);
    }

    #[test]
    fn numbers_are_short() {
        let short = [5190.0, 0.25, -40.0, 0.0, 1234.56, 3.0].map(number::<f64>);
        assert_eq!(short, ["5190", "0.25", "-40", "0", "1235", "3"]);
        assert_eq!([1e-30, 4e14, f64::NAN].map(number::<f64>), ["1.000e-30", "4.000e14", "NaN"]);
        assert_eq!(number(0.1_f32), "0.1");
    }
}
