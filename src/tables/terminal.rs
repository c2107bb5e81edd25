//! Tables and sentences on a terminal: within its width, and broken between words alone.

use super::{Table, is_figure};
use textwrap::core::display_width;
use textwrap::{Options, WordSeparator, WordSplitter, WrapAlgorithm};

/// The most columns with notes that are easy to read.
const MOST_WITH_NOTES: usize = 7;

/// A column of a table.
struct Column<'a> {
    heading: &'a str,
    cells: Vec<String>,
    is_of_figures: bool,
    /// The least width that breaks no word, and no figure.
    least: usize,
    /// The width with which nothing is broken.
    most: usize,
}

impl Table {
    /// The table without lines for a terminal of this width. Columns of figures are aligned on the right. Columns that do not
    /// fit beside each other follow below, again beside the first, which names the rows; those of one variable stay
    /// together if they can. A line is longer than the width only if the first column and a single word are.
    pub fn terminal(&self, width: usize) -> String {
        self.shown(width, false)
    }

    /// As [`Table::terminal`], with the notes of the cells if the columns are few.
    pub fn terminal_with_notes(&self, width: usize) -> String {
        self.shown(width, self.header.len() <= MOST_WITH_NOTES)
    }

    fn shown(&self, width: usize, with_notes: bool) -> String {
        let mut columns: Vec<Column<'_>> = (0..self.header.len()).map(|it| self.column(it, with_notes)).collect();
        let Some((names, others)) = columns.split_first_mut() else { return String::new() };
        // They are to be found and copied: they never break.
        names.least = names.most;
        let room = width.saturating_sub(names.most);
        let need = |columns: &[Column<'_>]| columns.iter().map(|it| it.least + 1).sum::<usize>();
        let mut groups: Vec<Vec<&Column<'_>>> = vec![Vec::new()];
        let mut used = 0;
        for variable in others.chunk_by(|a, b| a.subject().is_some() && a.subject() == b.subject()) {
            for part in variable.chunks(if need(variable) <= room { variable.len() } else { 1 }) {
                if used > 0 && used + need(part) > room {
                    groups.push(Vec::new());
                    used = 0;
                }
                used += need(part);
                groups.last_mut().expect("there is a first").extend(part);
            }
        }
        let shown = groups.iter().map(|group| beside(names, group, room, self.rows.len()));
        shown.collect::<Vec<_>>().join("\n\n")
    }

    fn column(&self, number: usize, with_notes: bool) -> Column<'_> {
        let cells = || self.rows.iter().filter_map(|row| row.get(number));
        let is_of_figures = cells().all(|cell| is_figure(&cell.text));
        let text = |row: &Vec<super::Cell>| match row.get(number) {
            Some(cell) if with_notes && !cell.note.is_empty() => format!("{} ({})", cell.text, cell.note),
            Some(cell) => cell.text.clone(),
            None => String::new(),
        };
        let (heading, cells): (&str, Vec<String>) = (&self.header[number], self.rows.iter().map(text).collect());
        let lines = || heading.lines().chain(cells.iter().flat_map(|cell| cell.lines()));
        let unbroken = heading
            .split([' ', '\n'])
            .chain(cells.iter().flat_map(|cell| cell.split(|it| it == '\n' || it == ' ' && !is_of_figures)));
        let least = unbroken.map(display_width).max().unwrap_or(0);
        let most = lines().map(display_width).max().unwrap_or(0);
        Column { heading, is_of_figures, least, most, cells }
    }
}

impl Column<'_> {
    /// What the first of two lines of the heading names.
    fn subject(&self) -> Option<&str> {
        self.heading.split_once('\n').map(|(subject, _)| subject)
    }

    /// The heading, or the cell of a row, in lines of this width.
    fn lines(&self, row: Option<usize>, width: usize) -> Vec<String> {
        let lines = wrap(row.map_or(self.heading, |row| &self.cells[row]), width, "");
        let aligned = |line: String| {
            let space = " ".repeat(width.saturating_sub(display_width(&line)));
            if self.is_of_figures { space + &line } else { line + &space }
        };
        lines.into_iter().map(aligned).collect()
    }
}

/// The columns of a group beside the names, in as much room as there is for the group.
fn beside(names: &Column<'_>, group: &[&Column<'_>], room: usize, rows: usize) -> String {
    let columns: Vec<(&Column<'_>, usize)> =
        std::iter::once((names, names.most)).chain(group.iter().copied().zip(widths(group, room))).collect();
    let mut text = Vec::new();
    for row in std::iter::once(None).chain((0..rows).map(Some)) {
        let cells: Vec<Vec<String>> = columns.iter().map(|(column, width)| column.lines(row, *width)).collect();
        for number in 0..cells.iter().map(Vec::len).max().unwrap_or(0) {
            let of_column = |(lines, (_, width)): (&Vec<String>, &(_, usize))| {
                lines.get(number).cloned().unwrap_or_else(|| " ".repeat(*width))
            };
            let line: Vec<String> = cells.iter().zip(&columns).map(of_column).collect();
            text.push(line.join(" ").trim_end().to_string());
        }
    }
    text.join("\n")
}

/// The widths of columns in as much room. What words do not need goes to headings that would be broken otherwise, and what
/// is left then is shared out among texts, such that none gets more than it can fill while another wants more than that.
fn widths(group: &[&Column<'_>], room: usize) -> Vec<usize> {
    let mut widths: Vec<usize> = group.iter().map(|it| it.least).collect();
    let mut spare = room.saturating_sub(widths.iter().map(|width| width + 1).sum());
    let (mut figures, texts): (Vec<usize>, Vec<usize>) = (0..group.len()).partition(|&it| group[it].is_of_figures);
    figures.sort_by_key(|&it| group[it].most - group[it].least);
    for number in figures {
        let more = group[number].most - group[number].least;
        if more <= spare {
            widths[number] += more;
            spare -= more;
        }
    }
    let more = |level: usize, it: usize| level.clamp(group[it].least, group[it].most) - group[it].least;
    let level = (0..=room).rev().find(|&level| texts.iter().map(|&it| more(level, it)).sum::<usize>() <= spare);
    texts.iter().for_each(|&it| widths[it] += more(level.unwrap_or(0), it));
    widths
}

/// Sentences, line by line, each going on below itself a little to the right where it is longer than the width.
pub fn sentences(text: &str, width: usize) -> String {
    let of_line = |line: &str| {
        let indent = " ".repeat(2 + line.len() - line.trim_start().len());
        wrap(line, width, &indent)
    };
    text.lines().flat_map(of_line).collect::<Vec<_>>().join("\n")
}

fn wrap(text: &str, width: usize, indent: &str) -> Vec<String> {
    let options = Options::new(width).subsequent_indent(indent).break_words(false);
    let options = options.word_separator(WordSeparator::AsciiSpace).word_splitter(WordSplitter::NoHyphenation);
    let lines = textwrap::wrap(text, options.wrap_algorithm(WrapAlgorithm::FirstFit));
    lines.into_iter().map(|line| line.into_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::Cell;

    fn table() -> Table {
        let header = ["method", "h [m]\nbackground", "h [m]\nO−A passive", "u [m\u{a0}s⁻¹]\nspread"];
        let row = |name: &str| vec![name.into(), Cell::figure(Some(2.0)), "–".into(), Cell::figure(Some(-10.0))];
        Table::new(&header, vec![row("free"), row("a name with blanks")])
    }

    #[test]
    fn headings_are_broken_between_words_before_columns_are_parted() {
        let text = table().terminal(47);
        let expected = "\
method                  h [m]   h [m] u [m\u{a0}s⁻¹]
                   background     O−A    spread
                              passive
free                     2.00       –     -10.0
a name with blanks       2.00       –     -10.0";
        assert_eq!(text, expected);
        assert!(!table().terminal(52).contains("\n                              passive"), "{}", table().terminal(52));
    }

    #[test]
    fn columns_of_a_variable_stay_together_if_they_can() {
        let text = table().terminal(44);
        let headings: Vec<&str> = text.lines().filter(|line| line.starts_with("method")).collect();
        assert_eq!(headings.len(), 2, "{text}");
        assert!(headings[0].ends_with("h [m]       h [m]") && headings[1].ends_with("u [m\u{a0}s⁻¹]"), "{text}");
        assert_eq!(table().terminal(30).matches("method").count(), 3);
    }

    #[test]
    fn what_is_longer_than_the_terminal_stands_alone_and_whole() {
        let text = table().terminal(5);
        assert!(text.contains("a name with blanks       2.00\n") && text.contains("background"), "{text}");
    }

    #[test]
    fn texts_share_the_room_and_figures_with_notes_do_not_break() {
        let noted = Cell { note: "1.50 … 2.50".into(), ..Cell::figure(Some(2.0)) };
        let rows = vec![vec!["a".into(), noted, "one two three four five six".into()]];
        let table = Table::new(&["kind", "figure", "what it is"], rows);
        let expected = "\
kind             figure what it is
a    2.00 (1.50 … 2.50) one two
                        three four
                        five six";
        assert_eq!(table.terminal_with_notes(35), expected);
        assert_eq!(table.terminal(50).lines().count(), 2);
    }

    #[test]
    fn sentences_go_on_below_themselves() {
        let text = "Partition\nfkf: 24 blocks of which\n  a finding of several words\nx";
        let expected = "Partition\nfkf: 24 blocks\n  of which\n  a finding of\n    several\n    words\nx";
        assert_eq!(sentences(text, 14), expected);
    }
}
