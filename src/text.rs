//! Text from files on its way to a terminal or a page.

use std::path::Path;
use strsim::{damerau_levenshtein, jaro_winkler};

/// Whether a terminal or a browser would obey or hide the character instead of showing it, or no text may hold it, as
/// U+FFFE.
pub(crate) fn is_unprintable(character: char) -> bool {
    character.is_control()
        || u32::from(character) & 0xfffe == 0xfffe
        || matches!(
            character,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fdd0}'..='\u{fdef}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}'
        )
}

/// Characters after which [`clean`] cuts a text.
const LONGEST: usize = 500;

/// The text with every unprintable character written as an escape, `\u{1b}`, and cut where it is endless.
pub(crate) fn clean(text: &str) -> String {
    let mut cleaned = String::new();
    for (number, character) in text.chars().enumerate() {
        if number == LONGEST {
            cleaned.push('…');
            break;
        }
        push_printable(&mut cleaned, character, is_unprintable(character));
    }
    cleaned
}

/// A path as a message shows it.
pub(crate) fn shown_path(path: &Path) -> String {
    clean(&path.display().to_string())
}

/// Every line of the text as [`clean`] writes it.
pub(crate) fn clean_lines(text: &str) -> String {
    text.lines().map(clean).collect::<Vec<_>>().join("\n")
}

/// The text with every unprintable character but line feeds written as an escape, however long it is.
pub(crate) fn printable(text: &str) -> String {
    let mut printable = String::with_capacity(text.len());
    for character in text.chars() {
        push_printable(&mut printable, character, is_unprintable(character) && character != '\n');
    }
    printable
}

fn push_printable(text: &mut String, character: char, is_escaped: bool) {
    if is_escaped { text.extend(character.escape_unicode()) } else { text.push(character) }
}

/// The text with every character that a page cannot show written as an escape; line ends and tabs stay.
pub(crate) fn on_page(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for character in text.chars() {
        let is_shown = ['\n', '\r', '\t'].contains(&character) || !is_unprintable(character);
        push_printable(&mut shown, character, !is_shown);
    }
    shown
}

/// The text with question marks for unprintable characters, one for each byte, so that places in it stay the same.
/// Line feeds and tabs stay.
pub(crate) fn same_length(text: &str) -> String {
    let mut printable = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\n' | '\t' => printable.push(character),
            '\r' => printable.push(' '),
            _ if is_unprintable(character) => printable.extend(std::iter::repeat_n('?', character.len_utf8())),
            _ => printable.push(character),
        }
    }
    printable
}

/// The candidate that has all parts of `word` in their order, `rmse_analysis.h` for `rmse.h`; else the one most like it, if one
/// is like it at all; else the shortest with a part that begins with it, or has it as a part.
pub(crate) fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let word: String = word.chars().take(100).collect::<String>().to_lowercase();
    let candidates: Vec<(String, &str)> = candidates.into_iter().map(|it| (it.to_lowercase(), it)).collect();
    let shortest = |fits: &dyn Fn(&str) -> bool| {
        let fitting = candidates.iter().filter(|(lower, _)| fits(lower));
        fitting.min_by_key(|(lower, _)| lower.len()).map(|(_, candidate)| *candidate)
    };
    let like = candidates.iter().map(|(lower, candidate)| (likeness(&word, lower), *candidate));
    let nearest = || like.filter(|&(likeness, _)| likeness >= 0.8).max_by(|a, b| a.0.total_cmp(&b.0)).map(|it| it.1);
    // A part of fewer letters would be one of too many words.
    shortest(&|lower| has_all_parts(&word, lower))
        .or_else(nearest)
        .or_else(|| shortest(&|lower| word.len() >= 3 && parts(lower).any(|part| part.starts_with(&word))))
        .or_else(|| shortest(&|lower| word.len() >= 4 && lower.contains(&word)))
}

/// How alike two words are, from 0 to 1: two letters in the wrong order are one slip.
fn likeness(word: &str, other: &str) -> f64 {
    let is_slip = word.len() >= 3 && damerau_levenshtein(word, other) == 1;
    jaro_winkler(word, other).max(if is_slip { 0.9 } else { 0.0 })
}

fn parts(word: &str) -> impl Iterator<Item = &str> {
    word.split(['_', '.', '-']).filter(|part| !part.is_empty())
}

/// Whether a word of several parts is another one with some of its parts left out.
fn has_all_parts(word: &str, other: &str) -> bool {
    let mut of_other = parts(other);
    parts(word).count() > 1 && parts(word).all(|part| of_other.any(|other| other == part))
}

/// A number of things: `1 cycle`, `2 cycles`.
pub(crate) fn counted(number: usize, noun: &str) -> String {
    format!("{number} {noun}{}", if number == 1 { "" } else { "s" })
}

/// A phrase at the beginning of a sentence.
pub(crate) fn capitalised(phrase: &str) -> String {
    let mut letters = phrase.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// Words as they stand in a sentence: `a, b, c`.
pub(crate) fn listed<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    words.into_iter().collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_cannot_reach_a_terminal() {
        assert_eq!(clean("a\u{1b}[2Jb\u{202e}c"), "a\\u{1b}[2Jb\\u{202e}c");
        assert_eq!(printable("a\n\u{1b}]0;b\u{7}"), "a\n\\u{1b}]0;b\\u{7}");
        assert_eq!(clean(&"x".repeat(10_000)).chars().count(), LONGEST + 1);
        for text in ["plain", "\u{1b}[31m", "ü\u{9b}31m\r\n\tx", "\u{202e}\u{feff}"] {
            let printable = same_length(text);
            assert_eq!(printable.len(), text.len());
            assert!(printable.chars().all(|c| c == '\n' || c == '\t' || !is_unprintable(c)), "{printable:?}");
        }
    }

    #[test]
    fn the_nearest_word_is_found_and_a_strange_one_has_none() {
        let keys = ["nx", "ny", "dx_km", "boundary"];
        assert_eq!(nearest("dx", keys), Some("dx_km"));
        assert_eq!(nearest("bondary", keys), Some("boundary"));
        assert_eq!(nearest("temperature", keys), None);
        assert_eq!(nearest("radius_km", ["members", "localization_radius_km"]), Some("localization_radius_km"));
        assert_eq!(nearest("_km", ["members", "localization_radius_km"]), None);
        let scores = ["rmse_background.h", "rmse_analysis.h", "rmse_analysis.u", "bias_rmse"];
        assert_eq!(nearest("rmse.h", scores), Some("rmse_analysis.h"));
        assert_eq!(nearest("rmse.u", scores), Some("rmse_analysis.u"));
        let grid = ["nx", "boundary", "center_latitude_deg", "center_longitude_deg"];
        assert_eq!([nearest("lat", grid), nearest("lon", grid)], [Some(grid[2]), Some(grid[3])]);
        assert_eq!(nearest("rnu", ["run", "resume", "regress"]), Some("run"));
        assert_eq!([counted(1, "block"), counted(0, "block")], ["1 block", "0 blocks"]);
    }
}
