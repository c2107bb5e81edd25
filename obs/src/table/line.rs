//! Lines of a text, and the fields of a line.

use std::borrow::Cow;

/// The lines with their numbers from 1, without empty ones and remarks. A line ends with a line feed, a carriage return, or
/// both.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    // The search for one character is much faster than that for either.
    let lines = text.split('\n').flat_map(|piece| piece.strip_suffix('\r').unwrap_or(piece).split('\r'));
    let numbered = lines.zip(1..).map(|(line, number)| (number, line.trim()));
    numbered.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// What separates the fields of a line, if it is not the comma.
pub(super) fn separator(line: &str) -> Option<&'static str> {
    let mut quoted = false;
    let mut outside = line.chars().filter(|&c| {
        quoted ^= c == '"';
        !quoted
    });
    outside.find_map(|c| match c {
        ';' => Some("semicolons"),
        '\t' => Some("tabs"),
        '|' => Some("vertical bars"),
        _ => None,
    })
}

/// Appends the fields of one line of CSV, without the blanks around them.
///
/// # Errors
/// What is wrong with the quotation marks.
pub(super) fn split<'a>(line: &'a str, fields: &mut Vec<Cow<'a, str>>) -> Result<(), String> {
    let mut rest = line;
    loop {
        let (field, after) = match rest.trim_start().strip_prefix('"') {
            Some(quoted) => {
                let (field, after) = unquote(quoted)?;
                (Cow::Owned(field), after)
            }
            None => {
                let (field, after) = rest.split_once(',').map_or((rest, None), |(field, after)| (field, Some(after)));
                if field.contains('"') {
                    return Err(match line.matches('"').count() % 2 {
                        1 => "a quotation mark is not closed on its line".to_owned(),
                        _ => "a quotation mark stands within a field that does not begin with one".to_owned(),
                    });
                }
                (Cow::Borrowed(field.trim()), after)
            }
        };
        fields.push(field);
        match after {
            Some(after) => rest = after,
            None => return Ok(()),
        }
    }
}

/// The field behind a quotation mark, and what follows the comma behind its end. Two quotation marks mean one.
fn unquote(quoted: &str) -> Result<(String, Option<&str>), String> {
    let (mut field, mut rest) = (String::new(), quoted);
    loop {
        let Some((part, after)) = rest.split_once('"') else {
            return Err("a quotation mark is not closed on its line".to_owned());
        };
        field.push_str(part);
        match after.strip_prefix('"') {
            Some(after) => {
                field.push('"');
                rest = after;
            }
            None => {
                let after = after.trim_start();
                let field = field.trim().to_owned();
                return match after.strip_prefix(',') {
                    Some(after) => Ok((field, Some(after))),
                    None if after.is_empty() => Ok((field, None)),
                    None => Err("a field goes on behind its closing quotation mark".to_owned()),
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_as_on_any_system() {
        for text in ["a\n\n  # b\nc\n", "\u{feff}a\r\n\r\n#\r\nc", "a\r\r# x\rc\r", "a\r\n\r# x\nc\r\n"] {
            assert_eq!(lines(text).collect::<Vec<_>>(), [(1, "a"), (4, "c")], "{text:?}");
        }
    }

    fn split(line: &str) -> Result<Vec<Cow<'_, str>>, String> {
        let mut fields = Vec::new();
        super::split(line, &mut fields).map(|()| fields)
    }

    #[test]
    fn fields_may_be_quoted() {
        assert_eq!(split("a, \"b, \"\"c\"\"\" ,,d ").unwrap(), ["a", "b, \"c\"", "", "d"]);
        assert_eq!(split("\"\"").unwrap(), [""]);
        for wrong in ["\"a", "a\"b\"", "a\"", "\"a\" b,c"] {
            assert!(split(wrong).is_err(), "{wrong}");
        }
        assert_eq!(separator("\"a;b\",c"), None);
        assert_eq!(separator("\"a\";c"), Some("semicolons"));
    }
}
