//! Numbers in messages.

use std::fmt;

/// A number as a message shows it: very large and very small ones with an exponent, not with hundreds of digits.
pub(crate) struct Readable(pub f64);

impl fmt::Display for Readable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if size == 0.0 || !size.is_finite() || (1e-4..1e9).contains(&size) {
            write!(f, "{}", self.0)
        } else {
            write!(f, "{:e}", self.0)
        }
    }
}

/// A positive limit that is to be kept, with four digits or all before the point: rounded down, so that what is shown keeps it.
pub(crate) fn at_most(limit: f64) -> Readable {
    let digits = limit.log10().floor();
    let unit = 10f64.powf((digits - 3.0).min(0.0));
    let rounded = (limit / unit).floor() * unit;
    if !rounded.is_finite() {
        return Readable(limit);
    }
    // The decimals that the unit has, without those that its rounding adds.
    let decimals = (3.0 - digits).clamp(0.0, 300.0) as usize;
    Readable(format!("{rounded:.decimals$}").parse().unwrap_or(rounded))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_as_many_digits_as_can_be_read() {
        let texts = [1e300, -2.5e-7, 0.0, 1800.5, f64::NAN].map(|value| Readable(value).to_string());
        assert_eq!(texts, ["1e300", "-2.5e-7", "0", "1800.5", "NaN"]);
    }

    #[test]
    fn a_limit_is_rounded_down() {
        let texts = [2934.99, 123_456.7, 0.345_678, 12.0, 1e20].map(|limit| at_most(limit).to_string());
        assert_eq!(texts, ["2934", "123456", "0.3456", "12", "1e20"]);
    }
}
