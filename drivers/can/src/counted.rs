//! Numbers with their nouns, for the messages of all crates.

use std::fmt::Display;

/// A number with its noun in the singular or in the plural: `1 axis`, `2 axes`, `0 entries`. Only the
/// last word of the noun changes in the plural.
pub fn counted<N: Copy + Display + From<u8> + PartialEq>(number: N, noun: &str) -> String {
    let plural = |(one, many)| noun.strip_suffix(one).map(|stem| format!("{stem}{many}"));
    let odd = [("axis", "axes"), ("matrix", "matrices"), ("entry", "entries")];
    let plural = odd.into_iter().find_map(plural);
    counted_as(number, noun, &plural.unwrap_or_else(|| format!("{noun}s")))
}

/// A number with one of two texts: `1 record was lost`, `2 records were lost`.
pub fn counted_as<N: Copy + Display + From<u8> + PartialEq>(number: N, one: &str, many: &str) -> String {
    format!("{number} {}", if number == N::from(1) { one } else { many })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_told_in_the_singular_and_any_other_number_in_the_plural() {
        for (number, noun, told) in [
            (1_u64, "frame", "1 frame"),
            (0, "frame", "0 frames"),
            (2, "set-point", "2 set-points"),
            (1, "axis", "1 axis"),
            (5, "axis", "5 axes"),
            (0, "entry", "0 entries"),
            (3, "ultrasonic matrix", "3 ultrasonic matrices"),
            (2, "key", "2 keys"),
        ] {
            assert_eq!(counted(number, noun), told);
        }
        assert_eq!(counted_as(1_u64, "record was lost", "records were lost"), "1 record was lost");
        assert_eq!(counted_as(2_u64, "record was lost", "records were lost"), "2 records were lost");
    }
}
