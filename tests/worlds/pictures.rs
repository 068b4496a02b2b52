//! Pictures are decoded again and measured.

use std::path::Path;
use stemgen::Error;
use stemgen::render::{Colormap, Contrast, Enlarge, Marker, MarkerShape, Picture};

fn decode(path: &Path) -> (usize, usize, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    assert_eq!(info.bit_depth, png::BitDepth::Eight);
    (info.width as usize, info.height as usize, pixels)
}

/// Gaussian columns on a square lattice.
fn columns(size: usize, spacing: f64) -> Vec<f32> {
    let value = |i: usize, j: usize| {
        let peak = |at: f64, p: usize| {
            let d = (p as f64 - at + spacing / 2.0).rem_euclid(spacing) - spacing / 2.0;
            (-d * d / (0.03 * spacing * spacing)).exp()
        };
        let half = spacing / 2.0;
        peak(half, i) * peak(half, j) + 0.45 * peak(0.0, i) * peak(0.0, j)
    };
    (0..size * size).map(|k| value(k / size, k % size) as f32).collect()
}

#[test]
fn a_written_picture_has_the_rendered_pixels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let values: Vec<f32> = (0..60).map(|v| v as f32).collect();
    let mut picture = Picture::new(&values, [6, 10]).unwrap();
    picture.max_side = 45;
    picture.enlarge = Enlarge::Nearest;
    picture.colormap = Colormap::Viridis;
    picture.contrast = Contrast::Range { min: 0.0, max: 59.0 };
    picture.write_png(&path).unwrap();
    let (width, height, pixels) = decode(&path);
    assert_eq!((width, height), (40, 24));
    assert_eq!(pixels, picture.render().unwrap().pixels);
    assert_eq!(pixels[..3], [68, 1, 84], "the first colour of viridis");
    assert_eq!(pixels[pixels.len() - 3..], [253, 231, 37], "the last colour of viridis");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn large_images_are_averaged() {
    let values: Vec<f32> = (0..200 * 300).map(|k| ((k / 300 + k % 300) % 2) as f32).collect();
    let mut picture = Picture::new(&values, [200, 300]).unwrap();
    picture.max_side = 100;
    picture.contrast = Contrast::Range { min: 0.0, max: 1.0 };
    let image = picture.render().unwrap();
    assert_eq!((image.width, image.height), (100, 67));
    assert!(image.pixels.iter().all(|p| (113..=142).contains(p)));
}

/// Rows of pure white in the lower left: their run is the bar.
fn longest_white_run(image: &stemgen::render::RgbImage) -> usize {
    let mut longest = 0;
    for y in 0..image.height {
        let mut run = 0;
        for x in 0..image.width {
            let start = 3 * (y * image.width + x);
            run = if image.pixels[start..start + 3] == [255; 3] { run + 1 } else { 0 };
            longest = longest.max(run);
        }
    }
    longest
}

#[test]
fn the_bar_is_as_long_as_it_says() {
    for (size, pixel) in [(100, 0.2), (400, 0.1), (700, 1.3), (128, 0.01), (2000, 0.5), (64, 90.0)]
    {
        let values = vec![0.0; size * size];
        let mut picture = Picture::new(&values, [size, size]).unwrap();
        picture.contrast = Contrast::Range { min: 0.0, max: 1.0 };
        picture.pixel_angstrom = Some(pixel);
        let image = picture.render().unwrap();
        let angstrom_per_pixel = pixel * size as f64 / image.width as f64;
        let expected = image.bar_angstrom.unwrap() / angstrom_per_pixel;
        let got = longest_white_run(&image) as f64;
        assert!((got - expected).abs() <= 1.5, "{size}: {got}, expected {expected}");
        assert!((0.1..=0.28).contains(&(expected / image.width as f64)));
    }
}

#[test]
fn pictures_too_small_for_a_bar_have_none() {
    let values = vec![0.0; 30 * 400];
    let mut picture = Picture::new(&values, [30, 400]).unwrap();
    picture.max_side = 400;
    picture.pixel_angstrom = Some(0.1);
    assert_eq!(picture.render().unwrap().bar_angstrom, None);
}

#[test]
fn markers_stand_on_their_pixel() {
    let values = vec![0.0; 50 * 40];
    let mut picture = Picture::new(&values, [50, 40]).unwrap();
    picture.max_side = 500;
    let red = [255, 0, 0];
    let marker =
        Marker { position: [30.0, 10.0], radius: 3.0, shape: MarkerShape::Cross, color: red };
    picture.markers = vec![marker];
    let image = picture.render().unwrap();
    let at = |x: usize, y: usize| {
        let start = 3 * (y * image.width + x);
        [image.pixels[start], image.pixels[start + 1], image.pixels[start + 2]]
    };
    assert_eq!(at(104, 304)[1..], [0, 0]);
    assert!(at(104, 304)[0] > 250 && at(110, 310)[0] > 200);
    picture.markers[0].shape = MarkerShape::Circle;
    let image = picture.render().unwrap();
    let red_at = |x: usize, y: usize| image.pixels[3 * (y * image.width + x)] > 160;
    assert!(red_at(134, 304) && red_at(104, 274) && !red_at(104, 304));
    picture.markers[0].position = [1e300, -1e300];
    picture.render().unwrap();
    picture.markers[0].position = [f64::NAN, 0.0];
    assert!(picture.render().is_err());
}

#[test]
fn errors_name_the_place() {
    let mut values = vec![1.0; 12];
    values[7] = f32::NAN;
    let error = Picture::new(&values, [3, 4]).unwrap_err().to_string();
    assert!(error.contains("row 1, column 3"), "{error}");
    values[7] = 0.0;
    let picture = Picture::new(&values, [3, 4]).unwrap();
    let error = picture.write_png(Path::new("no/such/folder/a.png")).unwrap_err();
    assert!(matches!(error, Error::Io { .. }) && error.to_string().contains("no/such/folder"));
}

/// Writes pictures to look at into `$STEMGEN_LOOK`.
#[test]
fn pictures_to_look_at() {
    let Some(folder) = std::env::var_os("STEMGEN_LOOK") else { return };
    let folder = Path::new(&folder);
    for (name, size, pixel, map) in [
        ("small", 96, 0.15, Colormap::Gray),
        ("large", 1000, 0.37, Colormap::Inferno),
        ("tiny", 40, 0.02, Colormap::Viridis),
        ("wide", 900, 120.0, Colormap::Magma),
    ] {
        let spacing = size as f64 / 6.0;
        let values = columns(size, spacing);
        let mut picture = Picture::new(&values, [size, size]).unwrap();
        picture.colormap = map;
        picture.pixel_angstrom = Some(pixel);
        for i in 0..3 {
            let position = [spacing * (i as f64 + 0.5), spacing * 1.5];
            let shape = if i == 1 { MarkerShape::Cross } else { MarkerShape::Circle };
            let color = [255, 90, 60];
            picture.markers.push(Marker { position, radius: spacing / 4.0, shape, color });
        }
        picture.write_png(&folder.join(format!("{name}.png"))).unwrap();
        picture.max_side = 200;
        picture.write_png(&folder.join(format!("{name}_200.png"))).unwrap();
    }
}
