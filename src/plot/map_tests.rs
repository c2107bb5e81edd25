//! Tests of maps.

use super::*;

fn map() -> FieldMap {
    FieldMap {
        title: "<h>".into(),
        unit: "m".into(),
        field: (0..12).map(|value| value as f32).collect(),
        size: [4, 3],
        extent_m: [4e5, 3e5],
        scale: Scale::State,
        range: [0.0, 20.0],
        steps: Vec::new(),
        contours: contour_levels([0.0, 20.0]),
        graticule: vec![graticule::Line {
            label: "<50°>".into(),
            at: Some([0.0, 1e5]),
            parts: vec![vec![[0.0, 1e5], [4e5, 1e5]]],
        }],
        coast: vec![vec![[0.0, 0.0], [2e5, 1e5]]],
        marks: vec![Mark { x_m: 1e5, y_m: 1e5, color: Some([255, 255, 255]), title: "<b>".into() }],
    }
}

fn attribute(svg: &str, element: &str, name: &str) -> f64 {
    let own = &svg[svg.find(&format!("<{element} ")).unwrap()..];
    own.split(&format!(" {name}=\"")).nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
}

/// The picture of the cells: colours by rows, from the top.
fn picture(svg: &str) -> (Vec<[u8; 3]>, u32) {
    let data = svg.split("base64,").nth(1).unwrap().split('"').next().unwrap();
    let mut decoder = png::Decoder::new(std::io::Cursor::new(STANDARD.decode(data).unwrap()));
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut bytes).unwrap();
    (bytes.as_chunks::<3>().0.to_vec(), frame.width)
}

#[test]
fn a_map_is_always_the_same_and_escapes_its_texts() {
    let svg = map().svg("a").unwrap();
    assert_eq!(svg, map().svg("a").unwrap());
    assert!(svg.file.contains("&lt;h&gt; [m]") && svg.file.contains("<title>&lt;b&gt;</title>"));
    assert!(svg.file.contains("&lt;50°&gt;</text>") && !svg.page.contains("&lt;50°&gt;"), "it is what maps share");
    assert!(svg.shared.iter().any(|own| own.contains("id=\"graticule\"") && own.contains("&lt;50°&gt;")));
    assert!(svg.page.contains("var(--ink)") && svg.page.contains("id=\"a-0\""));
    let other = FieldMap { range: [0.0, 40.0], ..map() }.svg("a").unwrap();
    assert_ne!(picture(&svg.file).0, picture(&other.file).0, "colours must follow the range");
}

#[test]
fn a_square_is_a_square_and_the_south_is_below() {
    for extent_m in [[4e5, 3e5], [3e5, 9e5], [1e6, 1e6], [8e6, 2e6]] {
        let svg = FieldMap { extent_m, ..map() }.svg("a").unwrap().file;
        let [width, height] = ["width", "height"].map(|name| attribute(&svg, "image", name));
        assert!((width / height / (extent_m[0] / extent_m[1]) - 1.0).abs() < 0.01, "{extent_m:?}: {width} {height}");
        assert!(attribute(&svg, "image", "x") + width < WIDTH - 50.0);
    }
    let (colors, width) = picture(&map().svg("a").unwrap().file);
    assert_eq!((width, colors.len()), (4, 12));
    assert_eq!(colors[8], Scale::State.color(0.0), "the first value is in the south-west");
}

#[test]
fn steps_have_one_colour_each_and_the_sign_is_seen() {
    let steps = symmetric_steps(2.0, 130.0);
    assert_eq!(steps, [-100.0, -50.0, -20.0, -10.0, -5.0, -2.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]);
    assert_eq!(symmetric_steps(2.0, 15.0), [-10.0, -5.0, -2.0, 2.0, 5.0, 10.0]);
    for (least, most) in [(0.0, 1.0), (5.0, 5.0), (f32::NAN, f32::INFINITY), (1e-9, 1e9), (0.0, 0.0)] {
        let steps = symmetric_steps(least, most);
        assert!(steps.len() >= 6 && steps.len() <= 12 && steps.is_sorted(), "{least} {most}: {steps:?}");
    }
    let field = [-200.0, -30.0, 1.0, -1.0, 30.0, 200.0].to_vec();
    let map = FieldMap { field, size: [6, 1], steps, scale: Scale::Difference, range: [-100.0, 100.0], ..map() };
    let svg = map.svg("a").unwrap().file;
    let (colors, _) = picture(&svg);
    assert_eq!(colors[2], colors[3], "what is small is white");
    assert!(colors[0][2] > colors[0][0] && colors[5][0] > colors[5][2] && colors[1] != colors[0]);
    assert!([">-100<", ">20<", ">100<"].iter().all(|label| svg.contains(label)), "{svg}");
}

#[test]
fn the_values_are_in_the_figure_of_a_small_field() {
    let svg = map().svg("a").unwrap().file;
    let part = |name: &str| svg.split(&format!("{name}=\"")).nth(1).unwrap().split('"').next().unwrap().to_string();
    let step: f64 = part("data-step").parse().unwrap();
    let bytes = STANDARD.decode(part("data-values")).unwrap();
    let values: Vec<f64> =
        bytes.as_chunks::<2>().0.iter().map(|pair| step * f64::from(i16::from_le_bytes(*pair))).collect();
    assert!(
        values.iter().zip(&map().field).all(|(found, value)| (found - f64::from(*value)).abs() < step),
        "{values:?}"
    );
}

#[test]
fn odd_fields_are_drawn_or_refused() {
    let mut one = FieldMap { field: vec![f32::NAN], size: [1, 1], ..map() };
    assert!(one.svg("a").is_ok());
    one.field = vec![f32::INFINITY];
    assert!(one.svg("a").is_ok());
    assert!(FieldMap { field: Vec::new(), ..map() }.svg("a").unwrap().file.contains("<circle"));
    assert!(FieldMap { size: [4, 4], ..map() }.svg("a").unwrap_err().to_string().contains("4 × 4"));
    assert!(FieldMap { range: [1.0, 1.0], ..map() }.svg("a").is_err());
    assert!(FieldMap { range: [f32::NAN, 1.0], ..map() }.svg("a").is_err());
}

#[test]
fn a_ring_is_a_line() {
    let plot = FieldMap { size: [12, 1], ..map() }.line().unwrap();
    assert_eq!((plot.curves[0].points.len(), plot.curves[0].points[11][1]), (12, 11.0));
    assert!(map().line().is_none());
}

#[test]
fn contour_levels_are_round_and_within_the_range() {
    assert_eq!(contour_levels([-20.0, 20.0]), [-20.0, -16.0, -12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0, 16.0]);
    assert!(contour_levels([f32::NAN, 1.0]).is_empty());
}
