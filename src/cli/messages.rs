//! How errors look on a terminal: nothing in them that it would obey, and no command that they propose broken over lines.

use crate::text::printable;
use miette::{Diagnostic, LabeledSpan, MietteHandler, MietteHandlerOpts, ReportHandler, Severity, SourceCode};
use std::error::Error;
use std::fmt::{self, Display, Formatter};
use textwrap::core::Word;
use textwrap::{WordSeparator, WordSplitter};

/// Where lines are broken \[characters\].
const WIDTH: usize = 100;

/// Shows errors with their places, causes and help.
pub struct Messages(MietteHandler);

impl Messages {
    /// As for a terminal of usual width.
    pub fn new() -> Self {
        let options = MietteHandlerOpts::new().width(WIDTH).context_lines(1).terminal_links(false);
        let options = options.word_separator(WordSeparator::Custom(words)).word_splitter(WordSplitter::NoHyphenation);
        Self(options.break_words(false).build())
    }
}

impl ReportHandler for Messages {
    fn debug(&self, error: &dyn Diagnostic, formatter: &mut Formatter<'_>) -> fmt::Result {
        self.0.debug(&Shown::of(error), formatter)
    }
}

/// The words of a line: what stands between backquotes is one, however many blanks it has.
fn words(line: &str) -> Box<dyn Iterator<Item = Word<'_>> + '_> {
    let (mut begin, mut quoted, mut after_blank) = (0, false, false);
    let mut words = Vec::new();
    for (place, character) in line.char_indices() {
        if after_blank && character != ' ' {
            words.push(Word::from(&line[begin..place]));
            begin = place;
        }
        quoted ^= character == '`';
        after_blank = character == ' ' && !quoted;
    }
    words.push(Word::from(&line[begin..]));
    Box::new(words.into_iter())
}

/// An error in words that can be shown, with its place in a file.
#[derive(Debug)]
struct Shown<'a> {
    message: String,
    help: Option<String>,
    original: &'a dyn Diagnostic,
    cause: Option<Box<Shown<'a>>>,
    related: Vec<Shown<'a>>,
    /// If the cause has neither a place nor help.
    plain_cause: Option<Cause>,
}

impl<'a> Shown<'a> {
    fn of(original: &'a dyn Diagnostic) -> Self {
        let cause = original.diagnostic_source().map(|cause| Box::new(Self::of(cause)));
        Self {
            message: printable(&original.to_string()),
            help: original.help().map(|help| printable(&help.to_string())),
            plain_cause: original.source().filter(|_| cause.is_none()).map(Cause::of),
            cause,
            related: original.related().map_or(Vec::new(), |others| others.map(Self::of).collect()),
            original,
        }
    }
}

impl Display for Shown<'_> {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.message)
    }
}

impl Error for Shown<'_> {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.plain_cause.as_ref().map(|cause| cause as &(dyn Error + 'static))
    }
}

impl Diagnostic for Shown<'_> {
    fn severity(&self) -> Option<Severity> {
        self.original.severity()
    }

    fn help<'b>(&'b self) -> Option<Box<dyn Display + 'b>> {
        self.help.as_ref().map(|help| Box::new(help) as Box<dyn Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.original.source_code()
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        self.original.labels()
    }

    fn related<'b>(&'b self) -> Option<Box<dyn Iterator<Item = &'b dyn Diagnostic> + 'b>> {
        let others =
            || Box::new(self.related.iter().map(|other| other as &dyn Diagnostic)) as Box<dyn Iterator<Item = _>>;
        (!self.related.is_empty()).then(others)
    }

    fn diagnostic_source(&self) -> Option<&dyn Diagnostic> {
        self.cause.as_deref().map(|cause| cause as &dyn Diagnostic)
    }
}

/// A cause that is nothing but a sentence, and its own.
#[derive(Debug)]
struct Cause {
    message: String,
    cause: Option<Box<Cause>>,
}

impl Cause {
    fn of(error: &(dyn Error + 'static)) -> Self {
        let cause = error.source().map(|cause| Box::new(Self::of(cause)));
        Self { message: printable(&error.to_string()), cause }
    }
}

impl Display for Cause {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.message)
    }
}

impl Error for Cause {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.cause.as_deref().map(|cause| cause as &(dyn Error + 'static))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use miette::{Report, miette};

    struct Rendered<'a>(&'a Report);

    impl fmt::Debug for Rendered<'_> {
        fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
            Messages::new().debug(&**self.0, formatter)
        }
    }

    #[test]
    fn a_command_stays_on_one_line_however_long_it_is() {
        let command = format!("`isobar resume 'out put/{}'`", "a-b/c d ".repeat(30));
        let report = miette!(help = format!("some words before it: {command} and behind it"), "{command} {command}");
        let text = format!("{:?}", Rendered(&report));
        assert_eq!(text.lines().filter(|line| line.contains(&command)).count(), 3, "{text}");
        assert_eq!(text.lines().filter(|line| line.trim() == "and behind it").count(), 1, "{text}");
    }

    #[test]
    fn no_part_of_a_message_reaches_a_terminal_raw() {
        let raw = "\u{1b}[31mred\u{7}";
        let inner = miette!(help = format!("help {raw}"), "inner {raw}");
        let plain: Report = miette!("plain {raw}");
        let io = std::io::Error::other(format!("io {raw}"));
        for report in [inner.wrap_err(format!("outer {raw}")), plain, Report::msg(io.to_string()).wrap_err("x")] {
            // Colours are the handler's own; what was in the texts is not among them.
            let text = format!("{:?}", Rendered(&report));
            assert!(!text.contains('\u{7}') && text.contains("\\u{1b}[31mred\\u{7}"), "{text:?}");
        }
    }
}
