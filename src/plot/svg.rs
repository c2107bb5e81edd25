//! Figures as SVG: for files of their own and as parts of a page.

use crate::text::printable;

/// Colours of text, of lines in the background, and of paper in a figure's file.
pub(super) const INK: &str = "#1b1e25";
pub(super) const GRID: &str = "#d9dce3";
pub(super) const PAPER: &str = "#ffffff";

/// What stands for them in a figure that is part of a page: the page's style sheet knows their colours by day and by
/// night.
const PAGE_COLORS: [(&str, &str); 3] = [(INK, "var(--ink)"), (GRID, "var(--line)"), (PAPER, "none")];

/// A figure: for a file of its own, and for a page that has it among others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Svg {
    /// With colours on white paper.
    pub file: String,
    /// With the page's colours, its own identifiers, and without a fixed size.
    pub page: String,
    /// Elements that it has in common with others of its page, which holds each once; the file has them within.
    pub shared: Vec<String>,
}

impl Svg {
    /// The figure of a file.
    pub(super) fn new(file: String, title: &str) -> Self {
        Self { page: for_page(&file, title), file, shared: Vec::new() }
    }
}

/// The figure as part of a page.
fn for_page(svg: &str, title: &str) -> String {
    let mut svg = svg.to_string();
    for (from, to) in PAGE_COLORS {
        svg = svg.replace(&format!("\"{from}\""), &format!("\"{to}\""));
    }
    let Some(end) = svg.find('>') else { return svg };
    let (opening, rest) = svg.split_at(end);
    let size = |name: &str| {
        let value = opening.split(&format!(" {name}=\"")).nth(1)?.split('"').next()?;
        value.parse::<f64>().ok()
    };
    let (width, height) = (size("width").unwrap_or(440.0), size("height").unwrap_or(300.0));
    let label = escaped(title);
    let ns = "xmlns=\"http://www.w3.org/2000/svg\"";
    let font = "font-family=\"system-ui, sans-serif\" fill=\"var(--ink)\"";
    format!("<svg {ns} viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{label}\" {font}{rest}")
}

/// Where a text stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// A figure in the making.
pub(super) struct Canvas {
    body: String,
    shared: Vec<String>,
    size: [f64; 2],
}

impl Canvas {
    /// White paper of this width and height.
    pub fn new(size: [f64; 2]) -> Self {
        Self { body: String::new(), shared: Vec::new(), size }
    }

    /// Adds elements, as they are.
    pub fn raw(&mut self, element: &str) {
        self.body.push_str(element);
        self.body.push('\n');
    }

    /// Adds an element that all figures of a page have in common, to be used by its identifier.
    pub fn share(&mut self, element: &str) {
        self.shared.push(element.to_string());
    }

    /// Adds a text in a size and colour, escaped.
    pub fn text(&mut self, [x, y]: [f64; 2], size: f64, anchor: Anchor, color: &str, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = escaped(text);
        self.raw(&format!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"{color}\">{text}</text>"
        ));
    }

    /// Adds a line.
    pub fn line(&mut self, [a, b]: [[f64; 2]; 2], color: &str, width: f64) {
        self.raw(&format!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{color}\" stroke-width=\"{width}\"/>",
            a[0], a[1], b[0], b[1]
        ));
    }

    /// Adds a filled rectangle.
    pub fn rectangle(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], color: &str) {
        self.raw(&format!(
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{color}\"/>"
        ));
    }

    /// Adds a dot with a title that is seen when it is pointed at.
    pub fn dot(&mut self, [x, y]: [f64; 2], radius: f64, color: &str, title: &str) {
        let title = if title.is_empty() { String::new() } else { format!("<title>{}</title>", escaped(title)) };
        self.raw(&format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{color}\">{title}</circle>"));
    }

    /// The figure.
    pub fn finish(self, title: &str) -> Svg {
        let [width, height] = self.size;
        let with = |shared: &str| {
            format!(
                "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
                 font-family=\"system-ui, sans-serif\">\n{shared}<rect width=\"100%\" height=\"100%\" fill=\"{PAPER}\"/>\n\
                 {}</svg>\n",
                self.body
            )
        };
        let figure = Svg::new(with(""), title);
        if self.shared.is_empty() {
            return figure;
        }
        Svg { file: with(&format!("<defs>{}</defs>\n", self.shared.concat())), shared: self.shared, ..figure }
    }
}

/// A line through places as data of a path, to a tenth of a pixel: from its second place on as steps.
pub(super) fn path(places: impl IntoIterator<Item = [f64; 2]>) -> String {
    let mut path = String::new();
    let mut last: Option<[i64; 2]> = None;
    for place in places {
        let own = place.map(|it| (10.0 * it).round() as i64);
        let ([x, y], letter) = match last {
            None => (own, "M"),
            Some([x, y]) => ([own[0] - x, own[1] - y], "l"),
        };
        if last.is_none() || [x, y] != [0, 0] {
            let [x, y] = [x, y].map(|tenths| tenths as f64 / 10.0);
            let between = if y < 0.0 { "" } else { " " };
            path += &format!("{letter}{x}{between}{y}");
        }
        last = Some(own);
    }
    path
}

/// A text as SVG holds it: without characters that XML cannot hold or a browser would obey.
pub(super) fn escaped(text: &str) -> String {
    minijinja::HtmlEscape(&printable(text)).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_goes_through_its_places() {
        let path = path([[1.0, 2.04], [1.26, -3.0], [1.26, -3.0], [11.26, 0.5]]);
        assert_eq!(path, "M1 2l0.3-5l10 3.5");
        assert_eq!(super::path([]), "");
    }
}
