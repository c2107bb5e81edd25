//! Choices among values that may be equal.

/// Values that differ by less than this share of the largest are equal but for rounding.
const ROUNDING: f64 = 1e-9;

/// The index of the largest of some values that are not negative: of those that are equal to it but for rounding, the
/// first. `None` if there are no values.
pub(crate) fn first_largest(mut values: impl Iterator<Item = f64> + Clone) -> Option<usize> {
    let largest = values.clone().fold(0.0, f64::max);
    values.position(|value| value >= largest * (1.0 - ROUNDING))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_equals_the_first_is_chosen_whatever_their_last_bits() {
        let chosen = |values: &[f64]| first_largest(values.iter().copied());
        assert_eq!(chosen(&[1.0, 2.0, 2.0 + 1e-15, 1.5]), Some(1));
        assert_eq!(chosen(&[1.0, 2.0, 2.0 - 1e-15]), Some(1));
        assert_eq!(chosen(&[1.0, 2.0, 2.1]), Some(2));
        assert_eq!(chosen(&[0.0, 0.0]), Some(0));
        assert_eq!(chosen(&[]), None);
    }
}
