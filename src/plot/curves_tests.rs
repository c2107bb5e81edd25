//! Tests of curves.

use super::*;

fn plot(points: Vec<[f64; 2]>) -> CurvePlot {
    let curves = vec![Curve::new("<script>", [1, 2, 3], points)];
    CurvePlot::new("error of <h> & \"u\"".into(), "time [d]".into(), "error [m]".into(), curves)
}

#[test]
fn a_figure_is_the_same_whenever_it_is_drawn_and_escapes_its_texts() {
    let plot = plot(vec![[0.0, 1.0], [1.0, 2.0]]);
    let first = plot.svg("a");
    assert_eq!(first, plot.svg("a"));
    assert!(!first.file.contains("kuva-clip") && first.file.contains("#010203"));
    for svg in [&first.file, &first.page] {
        assert!(svg.contains("&lt;script&gt;") && !svg.contains("<script"), "{svg}");
        assert!(svg.contains("time [d]") && svg.contains("error [m]") && svg.contains("&lt;h&gt; &amp;"));
    }
    assert!(first.page.contains("var(--ink)") && !first.page.contains(INK), "{}", first.page);
    assert_ne!(first.page, plot.svg("b").page, "identifiers must differ within a page");
}

/// However many curves there are, and however long their names: all names are within the figure, and so are the curves.
#[test]
fn every_name_has_its_place() {
    for (count, length) in [(1, 4), (2, 4), (3, 40), (9, 12), (14, 14), (40, 6)] {
        let mut plot = plot(vec![[0.0, 1.0], [1.0, 2.0]]);
        let name = |number: usize| format!("{}{number:02}", "n".repeat(length - 2));
        let curve = |number: usize| Curve::new(&name(number), [1, 2, 3], vec![[0.0, 1.0], [1.0, number as f64]]);
        plot.curves = (0..count).map(curve).collect();
        let svg = plot.svg("a").file;
        let number = |text: &str, key: &str| -> f64 {
            let value = text.split(&format!("{key}=\"")).nth(1).unwrap().split('"').next().unwrap();
            value.parse().unwrap()
        };
        let height = number(&svg, " height");
        for name in (0..count).map(name) {
            let end = svg.find(&format!(">{name}</text>")).unwrap_or_else(|| panic!("{name} is missing"));
            let own = &svg[svg[..end].rfind("<text").unwrap()..];
            let (x, y) = (number(own, " x"), number(own, " y"));
            assert!(y < height && x < 440.0, "{count} of {length}: {name} at {x}, {y} of {height}");
        }
        let clip = &svg[svg.find("<clipPath").unwrap()..];
        assert!(number(clip, " height") > 150.0, "{count} of {length}: {}", number(clip, " height"));
    }
}

#[test]
fn curves_far_apart_have_a_logarithmic_axis() {
    let figure = |high: f64, from_zero: bool| {
        let mut plot = plot(vec![[0.0, 1.0], [1.0, 2.0], [2.0, 1.5]]);
        plot.curves.push(Curve::new("free", [3, 2, 1], vec![[0.0, high], [1.0, high]]));
        plot.from_zero = from_zero;
        plot
    };
    assert!(figure(50.0, true).is_logarithmic() && !figure(5.0, true).is_logarithmic());
    assert!(!figure(50.0, false).is_logarithmic());
    let svg = figure(50.0, true).svg("a").file;
    assert!(svg.contains("error [m], logarithmic") && !svg.contains("NaN"), "{svg}");
    // Ticks are plain numbers.
    let mut low = figure(50.0, true);
    low.curves.iter_mut().flat_map(|curve| &mut curve.points).for_each(|point| point[1] *= 0.1);
    let svg = low.svg("a").file;
    assert!(svg.contains(">0.1<") && svg.contains(">0.5<") && !svg.contains("e-1<"), "{svg}");
    // Nothing is logarithmic of zero.
    let mut zero = figure(50.0, true);
    zero.curves[0].points[1][1] = 0.0;
    assert!(!zero.is_logarithmic());
    // A band that reaches zero ends at the axis.
    let mut banded = figure(50.0, true);
    banded.curves[0].band = Some(vec![[-1.0, 3.0]; 3]);
    let [_, [low, high]] = banded.ranges();
    assert_eq!((low, high), (1.0, 50.0));
    assert!(!banded.svg("a").file.contains("NaN"));
}

/// Half of the axis counts: the shade is half as wide as the axis, and goes to its end.
#[test]
fn what_counts_is_shaded() {
    let mut plot = plot(vec![[0.0, 1.0], [1.0, 2.0], [2.0, 1.5]]);
    assert!(!plot.svg("a").file.contains("pacity=\"0.35"));
    plot.counts = Some([1.0, 9.0]);
    let svg = plot.svg("a").file;
    let rectangle = svg.split("<rect").find(|part| part.contains("pacity=\"0.35")).unwrap_or_else(|| panic!("{svg}"));
    let number = |text: &str, key: &str| -> f64 {
        text.split(&format!("{key}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
    };
    let axis = number(&svg[svg.find("<clipPath").unwrap()..], " width");
    assert!((number(rectangle, " width") / axis - 0.5).abs() < 0.01, "{rectangle} of {axis}");
}

#[test]
fn figures_without_points_or_extent_or_finite_numbers_can_be_drawn() {
    for points in [
        vec![],
        vec![[0.0, 0.0]],
        vec![[1.0, 5.0]; 3],
        vec![[0.0, f64::NAN], [1.0, f64::INFINITY], [2.0, 3.0]],
        vec![[0.0, 1e300], [1.0, -1e300]],
        vec![[0.0, 1e-300], [1.0, 2e-300]],
    ] {
        for from_zero in [true, false] {
            let mut plot = plot(points.clone());
            plot.from_zero = from_zero;
            plot.curves[0].band = Some(vec![[f64::NAN, 1.0]; points.len()]);
            let svg = plot.svg("a").file;
            assert!(svg.starts_with("<svg") && !svg.contains("NaN") && !svg.contains("inf"), "{points:?} {svg}");
        }
    }
}

/// A point at the edge of the data is not at the edge of the axis, where half of it would be cut off.
#[test]
fn points_are_seen_whole() {
    let mut plot = plot(vec![[1.0, 1.0], [5.0, 2.0]]);
    assert_eq!(plot.ranges()[0], [1.0, 5.0]);
    plot.curves[0].dash = Dash::Points;
    let [left, right] = plot.ranges()[0];
    assert!(left < 1.0 && right > 5.0 && right - left < 4.5, "{left} {right}");
    assert!(!plot.svg("a").file.contains("NaN"));
}

/// Names stand at the ends of lines that are apart, and below those that are not.
#[test]
fn names_are_at_the_ends_of_curves_that_are_apart() {
    let figure = |ends: &[f64], name: &str| {
        let mut plot = plot(vec![]);
        let curve = |(number, &end): (usize, &f64)| {
            Curve::new(&format!("{name}{number}"), [1, 2, 3 + number as u8], vec![[0.0, 1.0], [1.0, end]])
        };
        plot.curves = ends.iter().enumerate().map(curve).collect();
        plot.svg("a").file
    };
    let number = |text: &str, key: &str| -> f64 {
        text.split(&format!(" {key}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
    };
    let place = |svg: &str, name: &str| {
        let end = svg.find(&format!(">{name}</text>")).unwrap_or_else(|| panic!("{name} is not in {svg}"));
        let own = &svg[svg[..end].rfind("<text").unwrap()..end];
        (number(own, "x"), number(own, "y"), own.to_string())
    };
    let svg = figure(&[2.0, 6.0, 4.0], "n");
    let (clip, places) = (&svg[svg.find("<clipPath").unwrap()..], ["n0", "n1", "n2"].map(|name| place(&svg, name)));
    let right = number(clip, "x") + number(clip, "width");
    assert!(places.iter().all(|it| it.0 > right && it.0 < 440.0), "{right}: {places:?}");
    let heights: Vec<f64> = places.iter().map(|it| it.1).collect();
    // The axis is linear: the name of the curve that ends in between is in between.
    assert!((heights[0] - heights[2] - (heights[2] - heights[1])).abs() < 0.3, "{heights:?}");
    assert!(places[1].2.contains("#010204") && svg.contains("#010204"));
    // Two that end together have names of their own, and eight have a legend.
    let svg = figure(&[3.0, 3.0], "n");
    assert!((place(&svg, "n0").1 - place(&svg, "n1").1).abs() >= 11.0);
    let bottom = |svg: &str| {
        let clip = &svg[svg.find("<clipPath").unwrap()..];
        number(clip, "y") + number(clip, "height")
    };
    let svg = figure(&[3.0; 8], "n");
    assert!((0..8).all(|it| place(&svg, &format!("n{it}")).1 > bottom(&svg)));
    let svg = figure(&[2.0, 6.0], "a name that is much too long ");
    assert!(place(&svg, "a name that is much too long 0").1 > bottom(&svg));
}
