//! A drawing of a specimen seen along the beam: projected atoms, tinted areas, marked columns,
//! lines, and a legend beside it.

use super::canvas::{Point, RgbImage};
use super::font;
use super::overlay::draw_bar;

const WHITE: [u8; 3] = [255; 3];
const INK: [u8; 3] = [30, 30, 30];
/// Radius of a drawn atom in nm.
const ATOM_NM: f64 = 0.05;
/// Radius of the ring about a marked column in nm.
const RING_NM: f64 = 0.085;
/// With fewer pixels per nm than this, marked columns become a tint by their density.
const RINGS_FROM: f64 = 40.0;
/// Edge of a block of that tint in pixels.
const BLOCK: usize = 8;
/// The opacity of atoms is 1 - exp(-(mass / mass at this share of the heaviest)^POWER).
const HALF_SHARE: f64 = 0.3;
const POWER: f64 = 0.7;

/// Colours that people with any colour vision distinguish (Okabe and Ito 2008).
pub mod palette {
    /// For elements, from the heaviest.
    pub const ELEMENTS: [[u8; 3]; 5] =
        [[0, 114, 178], [230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66]];
    /// For vacant sites.
    pub const VACANCY: [u8; 3] = [213, 94, 0];
    /// For substituted sites.
    pub(crate) const SUBSTITUTION: [u8; 3] = [204, 121, 167];
    /// For lines.
    pub(crate) const LINE: [u8; 3] = [0, 0, 0];
    /// Grounds of phases, from the first.
    pub(crate) const PHASES: [[u8; 3]; 3] = [[255, 255, 255], [255, 236, 200], [214, 236, 220]];
}

/// A sample beside a line of the legend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Swatch {
    /// Nothing; the text begins at the edge.
    None,
    /// An atom.
    Disc([u8; 3]),
    /// A marked column.
    Ring([u8; 3]),
    /// A line.
    Line([u8; 3]),
    /// An area.
    Area([u8; 3]),
}

/// A drawing in progress. Positions are in nm from the upper left corner of the field.
pub(crate) struct Scene {
    pixels_per_nm: f64,
    ground: RgbImage,
    ring_nm: f64,
    /// Red, green, blue, each times the mass, and the mass of the atoms on a pixel.
    atoms: Vec<[f32; 4]>,
    rings: Vec<(Point, [u8; 3], f64)>,
    densities: Vec<Density>,
    strokes: Vec<(Vec<Point>, [u8; 3])>,
    legend: Vec<(Swatch, String)>,
}

/// Marked sites by blocks.
struct Density {
    color: [u8; 3],
    marked: Vec<f32>,
}

impl Scene {
    /// An empty field of `size_nm` (width, height), `longest` pixels along its longer side.
    pub(crate) fn new(size_nm: [f64; 2], longest: usize) -> Self {
        let pixels_per_nm = longest as f64 / size_nm[0].max(size_nm[1]);
        let [width, height] =
            size_nm.map(|s| ((s * pixels_per_nm).round() as usize).clamp(1, longest));
        Scene {
            pixels_per_nm,
            ring_nm: RING_NM,
            ground: RgbImage::filled(width, height, WHITE),
            atoms: vec![[0.0; 4]; width * height],
            rings: Vec::new(),
            densities: Vec::new(),
            strokes: Vec::new(),
            legend: Vec::new(),
        }
    }

    /// A field whose ground is a picture, drawn with so many pixels per nm.
    pub(crate) fn over(picture: RgbImage, pixels_per_nm: f64) -> Self {
        Scene {
            pixels_per_nm,
            ring_nm: RING_NM,
            atoms: Vec::new(),
            ground: picture,
            rings: Vec::new(),
            densities: Vec::new(),
            strokes: Vec::new(),
            legend: Vec::new(),
        }
    }

    /// Mixes colours into the ground. A position in nm has a colour or none.
    pub(crate) fn wash(&mut self, color: impl Fn([f64; 2]) -> Option<[u8; 3]>, alpha: f64) {
        for y in 0..self.ground.height {
            for x in 0..self.ground.width {
                let at = [x, y].map(|p| (p as f64 + 0.5) / self.pixels_per_nm);
                if let Some(color) = color(at) {
                    self.ground.blend(x, y, color, alpha);
                }
            }
        }
    }

    /// Tints the ground: `color` of positions in nm.
    pub(crate) fn tint(&mut self, color: impl Fn([f64; 2]) -> [u8; 3]) {
        let width = self.ground.width;
        for (i, pixel) in self.ground.pixels.chunks_exact_mut(3).enumerate() {
            let at = [i % width, i / width].map(|p| (p as f64 + 0.5) / self.pixels_per_nm);
            pixel.copy_from_slice(&color(at));
        }
    }

    /// Adds an atom; heavier ones show more.
    pub(crate) fn atom(&mut self, position_nm: [f64; 2], mass: f32, color: [u8; 3]) {
        let [x, y] = self.place(position_nm);
        let radius = (ATOM_NM * self.pixels_per_nm).max(0.7);
        let range = |at: f64, size: usize| {
            let low = (at - radius - 0.5).ceil().max(0.0) as usize;
            low..((at + radius + 0.5).floor() + 1.0).clamp(0.0, size as f64) as usize
        };
        let part = |p: usize, at: f64| p as f64 - at;
        for row in range(y, self.ground.height) {
            for column in range(x, self.ground.width) {
                let distance = part(row, y).hypot(part(column, x));
                let weight = mass * (radius + 0.5 - distance).clamp(0.0, 1.0) as f32;
                let sums = &mut self.atoms[row * self.ground.width + column];
                for (sum, value) in sums.iter_mut().zip(color) {
                    *sum += weight * f32::from(value);
                }
                sums[3] += weight;
            }
        }
    }

    /// Marks `marked` of the sites of a column.
    pub(crate) fn mark(
        &mut self,
        position_nm: [f64; 2],
        marked: usize,
        sites: usize,
        color: [u8; 3],
    ) {
        let at = self.place(position_nm);
        if self.pixels_per_nm >= RINGS_FROM {
            let share = marked as f64 / sites.max(1) as f64;
            self.rings.push((at, color, share));
            return;
        }
        let [columns, rows] = self.blocks();
        let [column, row] = at.map(|p| (p.max(0.0) as usize) / BLOCK);
        if column >= columns || row >= rows {
            return;
        }
        let found = self.densities.iter().position(|d| d.color == color);
        let index = found.unwrap_or_else(|| {
            self.densities.push(Density { color, marked: vec![0.0; columns * rows] });
            self.densities.len() - 1
        });
        self.densities[index].marked[row * columns + column] += marked as f32;
    }

    /// Makes the rings about columns smaller where there are so many per square nm that they would
    /// cross each other.
    pub(crate) fn fit_rings(&mut self, columns_per_nm2: f64) {
        self.ring_nm = RING_NM.min(0.42 / columns_per_nm2.max(1e-9).sqrt());
    }

    /// Draws a line through points in nm.
    pub(crate) fn line(&mut self, points_nm: &[[f64; 2]], color: [u8; 3]) {
        let points = points_nm.iter().map(|p| self.place(*p)).collect();
        self.strokes.push((points, color));
    }

    /// Draws a circle.
    pub(crate) fn circle(&mut self, centre_nm: [f64; 2], radius_nm: f64, color: [u8; 3]) {
        let point = |i: usize| {
            let angle = std::f64::consts::TAU * i as f64 / 96.0;
            [centre_nm[0] + radius_nm * angle.cos(), centre_nm[1] + radius_nm * angle.sin()]
        };
        self.line(&(0..=96).map(point).collect::<Vec<_>>(), color);
    }

    /// Whether marked columns are rings, and not a tint.
    pub(crate) fn has_rings(&self) -> bool {
        self.pixels_per_nm >= RINGS_FROM
    }

    /// Adds a line to the legend. Characters that the font lacks are left out.
    pub(crate) fn legend(&mut self, swatch: Swatch, text: impl Into<String>) {
        let text = text.into();
        // Overlays may draw the same lines.
        if !self.legend.iter().any(|(_, known)| *known == text) {
            self.legend.push((swatch, text));
        }
    }

    /// The picture, with a scale bar.
    pub(crate) fn render(mut self) -> RgbImage {
        self.paint_atoms();
        self.paint_densities();
        let mut image = std::mem::replace(&mut self.ground, RgbImage::filled(1, 1, WHITE));
        let radius = (self.ring_nm * self.pixels_per_nm).max(3.0);
        // The colour is that of the legend; how many sites are marked shows in the width.
        for (at, color, share) in &self.rings {
            let width = (0.14 + 0.3 * share).min(0.3) * radius;
            image.ring(*at, radius, width.clamp(1.2, 6.0), *color, 1.0);
        }
        let thickness = (image.width.max(image.height) as f64 / 500.0).max(1.5);
        for (points, color) in &self.strokes {
            // One segment at a time: each is painted within its own rectangle.
            for ends in points.windows(2) {
                image.stroke(&[ends.to_vec()], thickness, *color, 0.9);
            }
        }
        image.bar_angstrom = draw_bar(&mut image, 10.0 / self.pixels_per_nm);
        with_legend(image, &self.legend)
    }

    fn place(&self, position_nm: [f64; 2]) -> Point {
        position_nm.map(|v| v * self.pixels_per_nm - 0.5)
    }

    /// Columns and rows of blocks.
    fn blocks(&self) -> [usize; 2] {
        [self.ground.width, self.ground.height].map(|n| n.div_ceil(BLOCK))
    }

    fn paint_atoms(&mut self) {
        let mut masses: Vec<f32> = self.atoms.iter().map(|a| a[3]).filter(|m| *m > 0.0).collect();
        if masses.is_empty() {
            return;
        }
        let rank = (masses.len() - 1) * 199 / 200;
        let heavy = f64::from(*masses.select_nth_unstable_by(rank, f32::total_cmp).1);
        for (i, [r, g, b, mass]) in self.atoms.iter().enumerate().filter(|(_, a)| a[3] > 0.0) {
            let alpha = 1.0 - (-(f64::from(*mass) / (HALF_SHARE * heavy)).powf(POWER)).exp();
            let color = [r, g, b].map(|sum| (sum / mass).round() as u8);
            self.ground.blend(i % self.ground.width, i / self.ground.width, color, alpha);
        }
    }

    fn paint_densities(&mut self) {
        let [columns, _] = self.blocks();
        for density in &self.densities {
            let most = density.marked.iter().copied().fold(0.0, f32::max).max(1.0);
            for y in 0..self.ground.height {
                for x in 0..self.ground.width {
                    let share = density.marked[y / BLOCK * columns + x / BLOCK] / most;
                    self.ground.blend(x, y, density.color, 0.9 * f64::from(share));
                }
            }
        }
    }
}

/// Sets the legend to the right of a picture.
fn with_legend(field: RgbImage, legend: &[(Swatch, String)]) -> RgbImage {
    if legend.is_empty() {
        return field;
    }
    let digit = (0.016 * field.width.max(field.height) as f64).clamp(11.0, 32.0).round();
    let (margin, swatch, step) = (1.2 * digit, 2.0 * digit, 2.0 * digit);
    let widest = |(kind, text): &(Swatch, String)| {
        font::width(text, digit) + if *kind == Swatch::None { 0.0 } else { swatch }
    };
    let panel = 2.0 * margin + legend.iter().map(widest).fold(0.0, f64::max);
    let needed = (2.0 * margin + legend.len() as f64 * step) as usize;
    let mut image =
        RgbImage::filled(field.width + panel.ceil() as usize, field.height.max(needed), WHITE);
    image.bar_angstrom = field.bar_angstrom;
    let row = 3 * image.width;
    for (line, pixels) in field.pixels.chunks_exact(3 * field.width).enumerate() {
        image.pixels[line * row..line * row + pixels.len()].copy_from_slice(pixels);
    }
    let left = field.width as f64 + margin;
    for (n, (kind, text)) in legend.iter().enumerate() {
        let base = margin + n as f64 * step + digit;
        draw_swatch(&mut image, *kind, [left + 0.6 * digit, base - 0.5 * digit], digit);
        let start = if *kind == Swatch::None { left } else { left + swatch };
        image.stroke(&font::lines(text, [start, base], digit), 0.11 * digit, INK, 1.0);
    }
    image
}

fn draw_swatch(image: &mut RgbImage, kind: Swatch, [x, y]: Point, digit: f64) {
    let half = 0.55 * digit;
    match kind {
        Swatch::None => {}
        Swatch::Disc(color) => {
            image.fill([x - half, y - half], [x + half, y + half], half, color, 1.0);
        }
        Swatch::Ring(color) => image.ring([x, y], half, 0.3 * half, color, 1.0),
        Swatch::Line(color) => {
            image.stroke(&[vec![[x - half, y], [x + half, y]]], 0.2 * digit, color, 1.0);
        }
        Swatch::Area(color) => {
            image.fill(
                [x - half - 1.0, y - half - 1.0],
                [x + half + 1.0, y + half + 1.0],
                0.0,
                INK,
                1.0,
            );
            image.fill([x - half, y - half], [x + half, y + half], 0.0, color, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: [u8; 3] = [200, 0, 0];

    fn pixel(image: &RgbImage, x: usize, y: usize) -> [u8; 3] {
        let start = 3 * (y * image.width + x);
        [image.pixels[start], image.pixels[start + 1], image.pixels[start + 2]]
    }

    #[test]
    fn atoms_stand_in_their_place_and_mix_by_mass() {
        let mut scene = Scene::new([2.0, 1.0], 400);
        for _ in 0..20 {
            scene.atom([1.5, 0.25], 80.0, RED);
        }
        for _ in 0..20 {
            scene.atom([0.5, 0.25], 60.0, [0, 0, 0]);
            scene.atom([0.5, 0.25], 20.0, RED);
        }
        let image = scene.render();
        assert_eq!((image.width, image.height), (400, 200));
        let [r, g, b] = pixel(&image, 300, 50);
        assert!(r > 195 && g < 40 && b < 40, "{r} {g} {b}");
        let [r, g, _] = pixel(&image, 100, 50);
        assert!(r > 45 && r < 95 && g < 40, "{r} {g}");
        assert_eq!(pixel(&image, 200, 50), WHITE);
    }

    #[test]
    fn marks_are_rings_near_and_a_tint_far() {
        let mut near = Scene::new([2.0, 2.0], 400);
        assert!(near.has_rings());
        near.mark([1.0, 1.0], 1, 1, RED);
        let image = near.render();
        assert_eq!(pixel(&image, 200, 200), WHITE);
        assert!(pixel(&image, 217, 200)[1] < 40, "{:?}", pixel(&image, 217, 200));
        let mut far = Scene::new([200.0, 200.0], 400);
        assert!(!far.has_rings());
        far.mark([101.0, 101.0], 8, 9, RED);
        far.mark([41.0, 41.0], 2, 9, RED);
        let image = far.render();
        assert!(pixel(&image, 202, 202)[1] < 40);
        assert!((150..240).contains(&pixel(&image, 82, 82)[1]), "{:?}", pixel(&image, 82, 82));
        assert_eq!(pixel(&image, 300, 100), WHITE);
    }

    #[test]
    fn grounds_lines_and_legend_are_drawn() {
        let mut scene = Scene::new([4.0, 4.0], 400);
        scene.tint(|[x, _]| if x < 2.0 { [10, 20, 30] } else { WHITE });
        scene.line(&[[3.0, -1.0], [3.0, 9.0]], [0, 0, 0]);
        scene.legend(Swatch::Disc(RED), "Sr");
        let image = scene.render();
        assert!(image.width > 420 && image.height == 400);
        assert_eq!(pixel(&image, 150, 100), [10, 20, 30]);
        assert!(pixel(&image, 299, 100)[0] < 100);
        assert_eq!(image.bar_angstrom, Some(10.0));
        let red = |x: usize, y: usize| pixel(&image, x, y) == RED;
        assert!((401..image.width).any(|x| (0..60).any(|y| red(x, y))), "no sample in the legend");
    }
}
