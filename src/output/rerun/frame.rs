//! The geometry of a map in the viewer: a unit is a cell, and y points down from the northern edge.

use crate::output::history::Fields;
use crate::plot::colors::Scale;
use crate::plot::number;
use isobar_model::{Boundary, Grid, Layout, Location};

/// Width of the margin around a map, and height of the colour bar's place under it, as parts of the map's width.
const MARGIN: f32 = 0.02;
const BAR: f32 = 0.13;

/// Half the height of the headline's place above it.
const HEADLINE: f32 = 0.05;

/// Places and sizes in a map.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    layout: &'a Layout,
}

/// The colour bar under a map: a band of coloured segments, and labels.
#[derive(Clone, Debug)]
pub struct ColorBar {
    /// Start and end of each segment.
    pub segments: Vec<[[f32; 2]; 2]>,
    /// Their colours.
    pub colors: Vec<[u8; 3]>,
    /// Half the thickness of the band.
    pub radius: f32,
    /// Places of the labels.
    pub labels_at: Vec<[f32; 2]>,
    /// The labels.
    pub labels: Vec<String>,
}

impl<'a> Frame<'a> {
    /// The frame of maps on the grid.
    pub fn new(layout: &'a Layout) -> Self {
        Self { layout }
    }

    fn grid(&self) -> &'a Grid {
        &self.layout.grid
    }

    fn size(&self) -> [f32; 2] {
        [self.grid().nx as f32, self.grid().ny as f32]
    }

    /// The numbers of columns and rows.
    pub fn resolution(&self) -> [u32; 2] {
        [self.grid().nx as u32, self.grid().ny as u32]
    }

    /// What the view shows: x and y, from and to; with a place for a headline above the map, if there is one.
    pub fn bounds(&self, headline: bool) -> [[f64; 2]; 2] {
        let [width, height] = self.size();
        let margin = MARGIN * width;
        let top = if headline { 2.0 * HEADLINE * width } else { margin };
        let bounds = [[-margin, width + margin], [-top, height + BAR * width]];
        bounds.map(|range| range.map(f64::from))
    }

    /// Where a headline above the map hangs.
    pub fn headline(&self) -> [f32; 2] {
        let [width, _] = self.size();
        [0.5 * width, -1.6 * HEADLINE * width]
    }

    /// The place of the point (x, y) \[m\].
    pub fn place(&self, x_m: f64, y_m: f64) -> [f32; 2] {
        let grid = self.grid();
        [(x_m / grid.dx_m) as f32, (grid.ny as f64 - y_m / grid.dy_m) as f32]
    }

    /// The values of a field row by row from the north.
    pub fn pixels<'b, T>(&self, field: &'b [T]) -> impl Iterator<Item = &'b T> + use<'b, T> {
        field.chunks(self.grid().nx).rev().flatten()
    }

    /// A length to which sizes of marks relate: about a fortieth of the map.
    pub fn mark(&self) -> f32 {
        let [width, height] = self.size();
        (width * height).sqrt() / 40.0
    }

    /// u and v of the fields of all variables, where the model has them.
    pub fn wind<'b>(&self, fields: &'b Fields) -> Option<[&'b [f32]; 2]> {
        let of = |name| self.layout.variable(name).map(|variable| fields[variable].as_slice());
        Some([of("u")?, of("v")?])
    }

    /// The highest wind speed in the fields of all variables; 0 without wind.
    pub fn highest_speed(&self, fields: &Fields) -> f32 {
        let Some([u, v]) = self.wind(fields) else { return 0.0 };
        u.iter().zip(v).map(|(u, v)| u.hypot(*v)).filter(|speed| speed.is_finite()).fold(0.0, f32::max)
    }

    /// Arrows of the wind (origins, vectors) at some cell centres; `fastest` is as long as arrows are apart.
    pub fn arrows(&self, [u, v]: [&[f32]; 2], fastest: f32) -> [Vec<[f32; 2]>; 2] {
        let grid = self.grid();
        let stride = (grid.nx.max(grid.ny)).div_ceil(16).max(1);
        let scale = 1.3 * stride as f32 / if fastest > 0.0 { fastest } else { 1.0 };
        let (mut origins, mut vectors) = (Vec::new(), Vec::new());
        for j in (stride / 2..grid.ny).step_by(stride) {
            for i in (stride / 2..grid.nx).step_by(stride) {
                let vector = [self.at_center("u", u, j, i) * scale, -self.at_center("v", v, j, i) * scale];
                let vector = shortened(vector, 3.0 * stride as f32);
                let center = [i as f32 + 0.5, (grid.ny - j) as f32 - 0.5];
                origins.push([center[0] - 0.5 * vector[0], center[1] - 0.5 * vector[1]]);
                vectors.push(vector);
            }
        }
        [origins, vectors]
    }

    /// The mean of a variable over a cell: between its two faces, if that is where the variable lives.
    fn at_center(&self, name: &str, field: &[f32], j: usize, i: usize) -> f32 {
        let grid = self.grid();
        let here = field[j * grid.nx + i];
        match self.layout.variable(name).map(|variable| self.layout.variables[variable].location) {
            Some(Location::XFace) => 0.5 * (here + field[j * grid.nx + (i + 1) % grid.nx]),
            Some(Location::YFace) if j + 1 < grid.ny => 0.5 * (here + field[(j + 1) * grid.nx + i]),
            Some(Location::YFace) if grid.boundary == Boundary::Periodic => 0.5 * (here + field[i]),
            Some(Location::YFace) => 0.5 * here,
            _ => here,
        }
    }

    /// The colour bar of a scale from `low` to `high`.
    pub fn color_bar(&self, scale: Scale, [low, high]: [f32; 2], unit: &str) -> ColorBar {
        const SEGMENTS: usize = 64;
        let [width, height] = self.size();
        let radius = 0.014 * width;
        let y = height + 2.2 * radius;
        let at = |part: f32| [part * width, y];
        let part = |number: usize| number as f32 / SEGMENTS as f32;
        ColorBar {
            segments: (0..SEGMENTS).map(|number| [at(part(number)), at(part(number + 1))]).collect(),
            colors: (0..SEGMENTS).map(|number| scale.color((number as f32 + 0.5) / SEGMENTS as f32)).collect(),
            radius,
            labels_at: [0.06, 0.5, 0.94].map(|part| [part * width, y + 2.0 * radius]).into(),
            labels: [low, 0.5 * (low + high), high].map(|value| format!("{} {unit}", number(value))).into(),
        }
    }
}

/// The arrow, cut to the given length: a wind gone astray must not cover the map.
fn shortened([x, y]: [f32; 2], longest: f32) -> [f32; 2] {
    let length = x.hypot(y);
    if length.is_nan() || length.is_infinite() {
        return [0.0, 0.0];
    }
    let factor = if length > longest { longest / length } else { 1.0 };
    [factor * x, factor * y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use isobar_model::Variable;

    fn layout() -> Layout {
        let variable =
            |name, location| Variable { name, long_name: name, standard_name: None, unit: "m s-1", location };
        Layout {
            grid: Grid { nx: 3, ny: 2, dx_m: 10.0, dy_m: 10.0, boundary: Boundary::Channel },
            variables: vec![variable("u", Location::XFace), variable("v", Location::YFace)],
        }
    }

    #[test]
    fn north_is_up() {
        let layout = layout();
        let frame = Frame::new(&layout);
        let rows: Vec<f32> = frame.pixels(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).copied().collect();
        assert_eq!(rows, [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
        assert_eq!(frame.place(0.0, 20.0), [0.0, 0.0]);
        assert_eq!(frame.place(15.0, 0.0), [1.5, 2.0]);
    }

    #[test]
    fn arrows_stand_at_centres_and_point_with_the_wind() {
        let layout = layout();
        let u = vec![1.0, 3.0, 5.0, 0.0, 0.0, 0.0];
        let v = vec![0.0, 0.0, 0.0, 2.0, 2.0, 2.0];
        let [origins, vectors] = Frame::new(&layout).arrows([&u, &v], 2.6);
        // South: u is the mean of both faces, periodic in x; v between wall and face. Up is negative.
        assert_eq!(vectors[..3], [[1.0, -0.5], [2.0, -0.5], [1.5, -0.5]]);
        // North: v between face and wall.
        assert_eq!(vectors[3..], [[0.0, -0.5]; 3]);
        assert_eq!([origins[0][0] + 0.5, origins[0][1] - 0.25], [0.5, 1.5]);
    }

    #[test]
    fn a_wind_gone_astray_does_not_cover_the_map() {
        let layout = layout();
        let (u, v) = (vec![1e30, 1e30, 1e30, f32::NAN, f32::INFINITY, 0.0], vec![0.0; 6]);
        let [_, vectors] = Frame::new(&layout).arrows([&u, &v], 10.0);
        assert_eq!(vectors[..3], [[3.0, 0.0]; 3]);
        assert_eq!(vectors[3..], [[0.0, 0.0]; 3]);
    }
}
