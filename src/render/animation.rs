//! Pictures that move.

use super::canvas::RgbImage;
use crate::error::{Error, Result};
use crate::setting::Setting;

/// Times that a picture may stand, in seconds.
pub const FRAME_S: std::ops::RangeInclusive<f64> = 0.01..=60.0;

/// An animated PNG of pictures of one size, each shown for `frame_s` seconds, without end. Programs that know no animations show the
/// first.
///
/// # Errors
/// [`Error::Invalid`] for no pictures, pictures of several sizes, or a time out of limits.
pub fn animated_png(pictures: &[RgbImage], frame_s: f64) -> Result<Vec<u8>> {
    let refuse = |value: String, expected: &str| Error::invalid(Setting::Images, value, expected);
    let Some(first) = pictures.first() else {
        return Err(refuse("0 pictures".into(), "expected one or more"));
    };
    let size = |p: &RgbImage| [p.width, p.height];
    if let Some(other) = pictures.iter().find(|p| size(p) != size(first)) {
        let value = format!("{:?} and {:?} pixels", size(first), size(other));
        return Err(refuse(value, "expected pictures of one size"));
    }
    if !FRAME_S.contains(&frame_s) {
        return Err(refuse(format!("{frame_s} s"), "expected 0.01 to 60 s for each picture"));
    }
    encode(pictures, (1000.0 * frame_s).round() as u16)
        .map_err(|e| refuse(e.to_string(), "expected pictures that PNG can hold"))
}

fn encode(
    pictures: &[RgbImage],
    frame_ms: u16,
) -> std::result::Result<Vec<u8>, png::EncodingError> {
    let mut bytes = Vec::new();
    let [width, height] = [pictures[0].width, pictures[0].height].map(|n| n as u32);
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_animated(pictures.len() as u32, 0)?;
    encoder.set_frame_delay(frame_ms, 1000)?;
    let mut writer = encoder.write_header()?;
    for picture in pictures {
        writer.write_image_data(&picture.pixels)?;
    }
    writer.finish()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_back_one_by_one() {
        let pictures = [[9, 8, 7], [200, 100, 0], [0, 0, 255]].map(|c| RgbImage::filled(5, 4, c));
        let bytes = animated_png(&pictures, 0.25).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        for picture in &pictures {
            let mut found = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut found).unwrap();
            assert_eq!(found, picture.pixels);
            let control = reader.info().frame_control().unwrap();
            assert_eq!((control.delay_num, control.delay_den), (250, 1000));
        }
    }

    #[test]
    fn nothing_and_mixtures_are_refused() {
        let [a, b] = [[5, 4], [4, 5]].map(|[w, h]| RgbImage::filled(w, h, [0; 3]));
        assert!(animated_png(&[], 0.1).unwrap_err().to_string().contains("one or more"));
        let error = animated_png(&[a.clone(), b], 0.1).unwrap_err().to_string();
        assert!(error.contains("one size"), "{error}");
        assert!(animated_png(&[a], 0.0).unwrap_err().to_string().contains("0.01"));
    }
}
