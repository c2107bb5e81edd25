//! Pictures with at most 256 colours: a third of the size, and to the eye the same.

use color_quant::NeuQuant;
use png::{BitDepth, ColorType, Compression, Decoder, Encoder, Transformations};
use std::collections::HashMap;
use std::io::Cursor;

/// The most frequent colours, which stay as they are: paper, ink, and all steps of a colour scale.
const EXACT: usize = 96;

/// Colours that a neural network (Dekker 1994) finds for all others: contour lines that blend with what they cross.
const FOUND: usize = 160;

/// The same picture with a palette; as it was if parts of it are transparent.
///
/// # Errors
/// If it is no picture.
pub fn indexed(picture: Vec<u8>) -> Result<Vec<u8>, String> {
    let mut decoder = Decoder::new(Cursor::new(&picture));
    decoder.set_transformations(Transformations::ALPHA | Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(|error| error.to_string())?;
    let mut bytes = vec![0; reader.output_buffer_size().ok_or("it is too large")?];
    let frame = reader.next_frame(&mut bytes).map_err(|error| error.to_string())?;
    let pixels = bytes.as_chunks::<4>().0;
    if frame.color_type != ColorType::Rgba || pixels.iter().any(|pixel| pixel[3] != 255) {
        return Ok(picture);
    }
    let mut counts: HashMap<[u8; 4], u32> = HashMap::new();
    pixels.iter().for_each(|pixel| *counts.entry(*pixel).or_default() += 1);
    let mut colors: Vec<([u8; 4], u32)> = counts.into_iter().collect();
    colors.sort_unstable_by_key(|&(color, count)| (std::cmp::Reverse(count), color));
    let rest = colors.split_off(colors.len().min(EXACT));
    let mut palette: Vec<u8> = colors.iter().flat_map(|(color, _)| color[..3].to_vec()).collect();
    let numbered = |first: usize, colors: &[([u8; 4], u32)]| -> Vec<([u8; 4], u8)> {
        colors.iter().enumerate().map(|(number, (color, _))| (*color, (first + number) as u8)).collect()
    };
    let mut number: HashMap<[u8; 4], u8> = numbered(0, &colors).into_iter().collect();
    if rest.len() <= FOUND {
        number.extend(numbered(colors.len(), &rest));
        palette.extend(rest.iter().flat_map(|(color, _)| color[..3].to_vec()));
    } else {
        // Each colour once for each doubling of its frequency: dots are few pixels, and yet must keep their colours.
        let repeat = |(color, count): &([u8; 4], u32)| std::iter::repeat_n(*color, 1 + count.ilog2() as usize);
        let sample: Vec<u8> = rest.iter().flat_map(repeat).flatten().collect();
        let network = NeuQuant::new(1, FOUND, &sample);
        palette.extend(network.color_map_rgb());
        let found = |color: &[u8; 4]| (EXACT + network.index_of(color)) as u8;
        number.extend(rest.iter().map(|(color, _)| (*color, found(color))));
    }
    let indices: Vec<u8> = pixels.iter().map(|pixel| number[pixel]).collect();
    let mut result = Vec::new();
    let mut encoder = Encoder::new(&mut result, frame.width, frame.height);
    encoder.set_color(ColorType::Indexed);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(Compression::High);
    encoder.set_palette(palette);
    let mut writer = encoder.write_header().map_err(|error| error.to_string())?;
    writer.write_image_data(&indices).map_err(|error| error.to_string())?;
    writer.finish().map_err(|error| error.to_string())?;
    Ok(result)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(pixels: &[[u8; 4]], width: u32) -> Vec<u8> {
        let mut result = Vec::new();
        let mut encoder = Encoder::new(&mut result, width, pixels.len() as u32 / width);
        encoder.set_color(ColorType::Rgba);
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&pixels.concat()).unwrap();
        writer.finish().unwrap();
        result
    }

    fn read(picture: &[u8]) -> Vec<[u8; 3]> {
        let mut decoder = Decoder::new(Cursor::new(picture));
        decoder.set_transformations(Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        bytes.as_chunks::<3>().0.to_vec()
    }

    #[test]
    fn few_colours_stay_as_they_are() {
        let pixels: Vec<[u8; 4]> = (0..900).map(|at| [(at % 100) as u8, 7, (at % 2) as u8, 255]).collect();
        let found = read(&indexed(picture(&pixels, 30)).unwrap());
        assert!(found.iter().zip(&pixels).all(|(found, pixel)| found == &pixel[..3]));
    }

    #[test]
    fn many_colours_become_few_that_are_near() {
        // A white ground, a rough field of many colours, and one red dot.
        let mut pixels: Vec<[u8; 4]> = (0..40_000_u32)
            .map(|at| match at / 200 {
                0..40 => [255; 4],
                row => [(at % 200) as u8, row as u8, (at.wrapping_mul(2_654_435_761) >> 28) as u8, 255],
            })
            .collect();
        pixels[100..104].fill([255, 0, 0, 255]);
        let before = picture(&pixels, 200);
        let after = indexed(before.clone()).unwrap();
        assert_eq!(after, indexed(before.clone()).unwrap());
        let found = read(&after);
        assert_eq!(found[0], [255; 3]);
        let distance = |at: usize| (0..3).map(|c| found[at][c].abs_diff(pixels[at][c])).max().unwrap();
        assert!(distance(101) < 30, "{:?}", found[101]);
        let mean = (0..pixels.len()).map(|at| u32::from(distance(at))).sum::<u32>() / pixels.len() as u32;
        assert!(mean < 8, "{mean}");
    }

    #[test]
    fn what_is_transparent_stays_and_what_is_no_picture_is_refused() {
        let before = picture(&[[1, 2, 3, 4]; 4], 2);
        assert_eq!(indexed(before.clone()).unwrap(), before);
        assert!(indexed(b"no picture".to_vec()).is_err());
    }
}
