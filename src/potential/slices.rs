//! The cuts between the slices of a specimen.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// How the specimen is cut into slices.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Default)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Slicing {
    /// One slice per atomic plane, cut midway between planes. In specimens without planes, atoms within
    /// 0.5 A along the beam share a slice.
    #[default]
    Planes,
    /// [`Slicing::Planes`] where atoms form planes. Elsewhere [`Slicing::Local`] of 0.35 A for engines with windows, and
    /// [`Slicing::Grouped`] of 0.5 A for others.
    Auto,
    /// Atoms within this distance in Angstrom along the beam share a slice, at their mean height.
    Grouped(f64),
    /// Slices as in [`Slicing::Grouped`], but each window puts a slice at the mean height of the slice's atoms near the window's middle.
    /// Slices join where this displaces atoms by little. Engines without windows take [`Slicing::Grouped`].
    Local(f64),
    /// Slices of equal thickness, at most this many Angstrom and as near to that as possible.
    Thickness(f64),
    /// Slices of equal thickness that begin at z = 0 of the cell, even where atoms lie on its faces, as in abTEM.
    ThicknessFromFace(f64),
}

/// Atoms of specimens without planes share a slice, at their mean height, if they lie within this distance in Angstrom
/// along the beam. Moving an atom by 1 A turns the phase of its wave by 0.6 rad at 68 mrad and 200 kV. Measured on a tilted Pt
/// particle of 2.8 nm in one phonon configuration, against 0.05 A: bright pixels are off by 0.68 % rms with 0.5 A, by
/// 0.43 % with 0.25 A, and by 0.27 % with 0.15 A. With even slices of 1 A, bright columns are off by 1.8 %, against 0.25 A.
pub(crate) const GROUP_ANGSTROM: f64 = 0.5;
/// Atoms of specimens without planes share a slice in windows if they lie within this distance in Angstrom along the beam, at the height of
/// those near the middle of the window. `cargo bench --bench slices` (a tilted Pt particle, windows of 5.9 A): 0.10 % rms of the mean, where
/// one height gives 0.37 %, in 0.6 of its time.
pub(crate) const LOCAL_ANGSTROM: f64 = 0.35;
/// The exact engine's distance in Angstrom within which atoms of specimens without planes share a slice: 0.10 % rms of the mean in the same
/// bench.
pub(crate) const FINE_ANGSTROM: f64 = 0.1;
/// Thickness of slices where there are no atoms.
const EMPTY_THICKNESS_ANGSTROM: f64 = 1.0;
/// Thicknesses of slices that may be asked for. Thinner ones cost time and gain nothing.
const THICKNESSES_ANGSTROM: std::ops::RangeInclusive<f64> = 0.01..=1000.0;
/// Most slices of equal thickness.
const MOST_SLICES: f64 = 1e6;
/// Atoms nearer than this along the beam belong to the same plane.
const SAME_PLANE_ANGSTROM: f64 = 0.25;
/// Atoms linked into a group wider than this, in Angstrom, form no plane.
const MAX_PLANE_SPREAD_ANGSTROM: f64 = 0.7;
/// Atoms within this of a face along the beam, in Angstrom, are on that face.
const ON_FACE_ANGSTROM: f64 = 1e-3;
/// An atom nearer than this to a face of the cell, in Angstrom, may cross it by thermal motion.
const FACE_ROOM_ANGSTROM: f64 = 0.5;

impl Slicing {
    /// Replaces [`Slicing::Auto`] by the slices that it stands for, in a cell of `height` Angstrom with atoms at mean heights `z`.
    pub(crate) fn resolved(self, windows: bool, height: f64, z: &[f64]) -> Slicing {
        let auto = self == Slicing::Auto && height > 0.0 && height.is_finite();
        match auto {
            false => self,
            true if planes(&in_period(z, height).1).is_some() => Slicing::Planes,
            true if windows => Slicing::Local(LOCAL_ANGSTROM),
            true => Slicing::Grouped(GROUP_ANGSTROM),
        }
    }

    /// The slices of the exact engine: as these, but finer where [`Slicing::Auto`] finds no planes.
    pub(crate) fn exact(self, height: f64, z: &[f64]) -> Slicing {
        match (self, self.resolved(false, height, z)) {
            (Slicing::Auto, Slicing::Grouped(_)) => Slicing::Grouped(FINE_ANGSTROM),
            _ => self,
        }
    }
}

/// Slices of a specimen: slice i holds the atoms with `boundaries[i] <= z < boundaries[i + 1]`, and
/// its projected potential acts at `planes[i]`.
///
/// Waves are propagated from plane to plane, so that moving a boundary within a gap between atomic
/// planes changes nothing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Slices {
    /// n + 1 positions along the beam in Angstrom; the first is the entrance surface, the last the
    /// exit surface.
    pub boundaries: Vec<f64>,
    /// Heights at which the n slices' potentials act, in Angstrom.
    pub planes: Vec<f64>,
}

impl Slices {
    /// Cuts a cell of height `height` (Angstrom, periodic) whose atoms have mean heights `z`.
    ///
    /// When atoms lie on a face of the cell, the window of one period that is cut into slices starts half a gap before the first plane (at
    /// most 1 A), so that no atom crosses a face by thermal motion. Below vacuum it starts up to 0.5 A deeper than the face, just enough to
    /// give the last atoms room: probes are focused on it.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a height that is not positive, and for a thickness or span out of range.
    pub(crate) fn new(slicing: Slicing, height: f64, z: &[f64]) -> Result<Self> {
        if !(height > 0.0 && height.is_finite()) {
            return Err(Error::invalid(
                crate::Setting::CellHeightAngstrom,
                height,
                "must be positive",
            ));
        }
        let (entrance, z) = in_period(z, height);
        match slicing {
            Slicing::Planes | Slicing::Auto | Slicing::Grouped(_) | Slicing::Local(_)
                if z.is_empty() =>
            {
                if height > MOST_SLICES {
                    let expected = format!("at most {MOST_SLICES} where there are no atoms");
                    let setting = crate::Setting::CellHeightAngstrom;
                    return Err(Error::invalid(setting, height, expected));
                }
                Ok(Self::even(EMPTY_THICKNESS_ANGSTROM, entrance, height))
            }
            Slicing::Planes | Slicing::Auto => {
                let planes = planes(&z).unwrap_or_else(|| groups(&z, GROUP_ANGSTROM));
                Ok(Self::around(&planes, entrance, height))
            }
            Slicing::Grouped(span) | Slicing::Local(span) if !(span >= 0.0 && span.is_finite()) => {
                Err(Error::invalid(crate::Setting::SliceSpanAngstrom, span, "must be 0 or more"))
            }
            Slicing::Grouped(span) | Slicing::Local(span) => {
                Ok(Self::around(&groups(&z, span), entrance, height))
            }
            Slicing::Thickness(t) | Slicing::ThicknessFromFace(t) => {
                let [least, most] = [THICKNESSES_ANGSTROM.start(), THICKNESSES_ANGSTROM.end()];
                if !THICKNESSES_ANGSTROM.contains(&t) || height / t > MOST_SLICES {
                    let expected =
                        format!("from {least} to {most} A, and at most {MOST_SLICES} slices");
                    return Err(Error::invalid(
                        crate::Setting::SliceThicknessAngstrom,
                        t,
                        expected,
                    ));
                }
                let from_face = matches!(slicing, Slicing::ThicknessFromFace(_));
                Ok(Self::even(t, if from_face { 0.0 } else { entrance }, height))
            }
        }
    }

    fn even(thickness: f64, entrance: f64, height: f64) -> Self {
        let n = (height / thickness - 1e-6).ceil().max(1.0);
        let edge = |i: f64| entrance + height * i / n;
        let count = n as usize;
        Slices {
            boundaries: (0..=count).map(|i| edge(i as f64)).collect(),
            planes: (0..count).map(|i| edge(i as f64 + 0.5)).collect(),
        }
    }

    fn around(planes: &[f64], entrance: f64, height: f64) -> Self {
        let mut boundaries = vec![entrance];
        boundaries.extend(planes.windows(2).map(|w| 0.5 * (w[0] + w[1])));
        boundaries.push(entrance + height);
        Slices { boundaries, planes: planes.to_vec() }
    }

    /// Number of slices.
    pub fn len(&self) -> usize {
        self.planes.len()
    }

    /// Whether there is no slice; there is always at least one.
    pub fn is_empty(&self) -> bool {
        self.planes.is_empty()
    }

    /// Height of the entrance surface in Angstrom.
    pub(crate) fn entrance(&self) -> f64 {
        self.boundaries[0]
    }

    /// Total thickness in Angstrom.
    pub(crate) fn thickness(&self) -> f64 {
        self.boundaries[self.len()] - self.boundaries[0]
    }

    /// `mean_z` (Angstrom), wrapped into the period that is cut into slices.
    pub(crate) fn wrap(&self, mean_z: f64) -> f64 {
        wrap(mean_z, self.entrance(), self.thickness())
    }

    /// The slice that contains height `z`. Beyond the surfaces it is the first or last one, so that an atom displaced out of the specimen
    /// is kept.
    pub(crate) fn index(&self, z: f64) -> usize {
        let inner = &self.boundaries[1..self.len()];
        inner.partition_point(|b| *b <= z)
    }
}

/// The start of the period that is cut into slices, and the heights wrapped into it, ascending.
fn in_period(z: &[f64], height: f64) -> (f64, Vec<f64>) {
    let mut z = on_faces(z, height);
    let entrance = entrance(&z, height);
    z.iter_mut().for_each(|v| *v = wrap(*v, entrance, height));
    z.sort_by(f64::total_cmp);
    (entrance, z)
}

fn wrap(z: f64, start: f64, period: f64) -> f64 {
    let r = (z - start).rem_euclid(period);
    // rounding may give r = period for tiny negative arguments
    start + if r >= period { 0.0 } else { r }
}

/// Sorted heights in [0, height]. A height within rounding of a face counts as on that face, although the cell is periodic: an atom at
/// -1e-12 is not on the exit surface. A plane on both faces is moved to the entrance.
fn on_faces(z: &[f64], height: f64) -> Vec<f64> {
    let placed = |z: &f64| {
        if z.abs() <= ON_FACE_ANGSTROM {
            z.max(0.0)
        } else if (z - height).abs() <= ON_FACE_ANGSTROM {
            z.min(height)
        } else {
            wrap(*z, 0.0, height)
        }
    };
    let mut z: Vec<f64> = z.iter().map(placed).collect();
    z.sort_by(f64::total_cmp);
    let within = |room: f64| {
        let last = z.len() - z.partition_point(|v| *v < height - room);
        [z.partition_point(|v| *v <= room), last]
    };
    let [first, last] = within(ON_FACE_ANGSTROM);
    // In specimens without planes, atoms at the faces are there by chance.
    if first > 0 && last > 0 && first < z.len() && [first, last] == within(SAME_PLANE_ANGSTROM) {
        z.truncate(z.len() - last);
        z.splice(0..0, std::iter::repeat_n(0.0, last));
    }
    z
}

/// Vacuum of at least this thickness in Angstrom above the first atom stays there.
const VACUUM_ANGSTROM: f64 = 2.0;

/// Start of the slab for sorted heights in [0, height).
fn entrance(z: &[f64], height: f64) -> f64 {
    let (Some(&first), Some(&last)) = (z.first(), z.last()) else { return 0.0 };
    if first >= FACE_ROOM_ANGSTROM && last <= height - FACE_ROOM_ANGSTROM {
        return 0.0;
    }
    if first >= VACUUM_ANGSTROM {
        return last + FACE_ROOM_ANGSTROM - height;
    }
    // the widest gap that touches or is near the face, searched cyclically
    let near = |v: f64| v < 2.0 || v > height - 2.0;
    let mut best = (first + height - last, last - height);
    for w in z.windows(2) {
        if near(w[0]) && near(w[1]) && w[1] - w[0] > best.0 + 1e-9 {
            let lower = if w[0] > height / 2.0 { w[0] - height } else { w[0] };
            best = (w[1] - w[0], lower);
        }
    }
    best.1 + best.0 - (0.5 * best.0).min(1.0)
}

/// Heights of atomic planes for sorted heights, or `None` when the atoms form no planes.
fn planes(z: &[f64]) -> Option<Vec<f64>> {
    let mut planes = Vec::new();
    let mut start = 0;
    for i in 1..=z.len() {
        if i == z.len() || z[i] - z[i - 1] > SAME_PLANE_ANGSTROM {
            let group = &z[start..i];
            if group[group.len() - 1] - group[0] > MAX_PLANE_SPREAD_ANGSTROM {
                return None;
            }
            planes.push(group.iter().sum::<f64>() / group.len() as f64);
            start = i;
        }
    }
    Some(planes)
}

/// Mean heights of groups of sorted heights that span at most `span`.
fn groups(z: &[f64], span: f64) -> Vec<f64> {
    let mut means = Vec::new();
    let mut rest = z;
    while let Some(first) = rest.first() {
        let (group, others) = rest.split_at(rest.partition_point(|v| *v <= first + span));
        means.push(group.iter().sum::<f64>() / group.len() as f64);
        rest = others;
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perovskite_planes_are_centred_wherever_the_cell_starts() {
        let a = 3.905;
        for shift in [0.0, 0.3, a / 4.0, 1.9, -0.001] {
            let z: Vec<f64> = (0..20).map(|i| f64::from(i) * a / 2.0 + shift).collect();
            let s = Slices::new(Slicing::Planes, 10.0 * a, &z).unwrap();
            assert_eq!(s.len(), 20);
            assert!((s.thickness() - 10.0 * a).abs() < 1e-9);
            for i in 0..20 {
                let (low, high) = (s.boundaries[i], s.boundaries[i + 1]);
                let room = (s.planes[i] - low).min(high - s.planes[i]);
                assert!(room > 0.29, "{shift}: slice {i} {low} {} {high}", s.planes[i]);
            }
            let mut count = vec![0; 20];
            z.iter().for_each(|z| count[s.index(s.wrap(*z))] += 1);
            assert_eq!(count, vec![1; 20], "{shift}");
            // an atom displaced out of the slab stays in the surface slice
            assert_eq!(s.index(s.entrance() - 0.1), 0);
            assert_eq!(s.index(s.entrance() + s.thickness() + 0.1), 19);
        }
    }

    #[test]
    fn atoms_without_planes_share_slices_with_their_neighbours() {
        let z: Vec<f64> =
            (1..400).map(|i| 1.0 + (f64::from(i) * 38.0 * 0.618_034).rem_euclid(38.0)).collect();
        for (slicing, span) in [(Slicing::Planes, GROUP_ANGSTROM), (Slicing::Grouped(0.2), 0.2)] {
            let s = Slices::new(slicing, 40.0, &z).unwrap();
            let off = |z: &f64| (s.planes[s.index(s.wrap(*z))] - s.wrap(*z)).abs();
            assert!(z.iter().map(off).fold(0.0, f64::max) <= span);
            // The number of slices is about the smallest that this allows.
            assert!((s.len() as f64) < 38.0 / span + 1.0, "{}", s.len());
            assert!(s.planes.windows(2).all(|p| p[0] < p[1]));
        }
        for bad in [-0.1, f64::NAN] {
            assert!(Slices::new(Slicing::Grouped(bad), 40.0, &z).is_err());
        }
    }

    #[test]
    fn what_is_left_open_depends_on_planes_and_windows() {
        let planes: Vec<f64> = (0..20).map(|i| f64::from(i) * 1.95 + 0.3).collect();
        let none: Vec<f64> =
            (0..400).map(|i| (f64::from(i) * 38.0 * 0.618_034).rem_euclid(38.0)).collect();
        let of = |windows, z: &[f64]| Slicing::Auto.resolved(windows, 39.0, z);
        assert_eq!([of(true, &planes), of(false, &planes)], [Slicing::Planes; 2]);
        assert_eq!(of(true, &none), Slicing::Local(LOCAL_ANGSTROM));
        assert_eq!(of(false, &none), Slicing::Grouped(GROUP_ANGSTROM));
        assert_eq!(Slicing::Auto.exact(39.0, &none), Slicing::Grouped(FINE_ANGSTROM));
        assert_eq!(Slicing::Auto.exact(39.0, &planes), Slicing::Auto);
        for given in [Slicing::Planes, Slicing::Thickness(1.0)] {
            assert_eq!([given.resolved(true, 39.0, &none), given.exact(39.0, &none)], [given; 2]);
        }
    }

    #[test]
    fn requested_thickness_is_an_upper_limit_and_centres_planes_at_half_a_cell() {
        let a = 3.905;
        let z: Vec<f64> = (0..20).map(|i| f64::from(i) * a / 2.0).collect();
        let s = Slices::new(Slicing::Thickness(a / 2.0), 10.0 * a, &z).unwrap();
        assert_eq!(s.len(), 20);
        for z in &z {
            let plane = s.planes[s.index(s.wrap(*z))];
            assert!((plane - s.wrap(*z)).abs() < 1e-9);
        }
        let s = Slices::new(Slicing::Thickness(1.0), 10.0 * a, &z).unwrap();
        assert_eq!(s.len(), 40);
        for bad in [0.0, -1.0, f64::NAN] {
            assert!(Slices::new(Slicing::Thickness(bad), 10.0, &z).is_err());
        }
    }

    #[test]
    fn amorphous_cells_are_cut_by_groups_and_empty_ones_evenly() {
        let z: Vec<f64> = (0..500).map(|i| f64::from(i) * 0.0997).collect();
        // six atoms span 0.4985 A
        assert_eq!(Slices::new(Slicing::Planes, 50.0, &z).unwrap().len(), 84);
        assert_eq!(Slices::new(Slicing::Planes, 5.0, &[]).unwrap().len(), 5);
    }

    #[test]
    fn rounding_moves_no_atom_to_the_other_face() {
        let of = |z: &[f64]| Slices::new(Slicing::Planes, 20.0, z).unwrap();
        assert_eq!(of(&[-1e-12; 4]), of(&[0.0; 4]));
        assert_eq!(of(&[0.0, -1e-12, 2.0]), of(&[0.0, 0.0, 2.0]));
        assert_eq!(of(&[-5e-4, 2.0]).entrance(), of(&[0.0, 2.0]).entrance());
        // On the exit face of a slab below vacuum.
        for z in [20.0, 20.0 + 1e-12, 20.0 - 1e-12] {
            let s = of(&[16.0, 18.0, z]);
            assert!((s.entrance() - 0.5).abs() < 1e-9 && s.index(s.wrap(z)) == 2, "{z}");
        }
        // One plane of a crystal, half of it rounded to the other face.
        let planes: Vec<f64> = (1..10).map(|i| 2.0 * f64::from(i)).collect();
        let with = |face: &[f64]| of(&[face, &planes].concat());
        assert_eq!(with(&[0.0, 20.0 - 1e-9]).boundaries, with(&[0.0, 0.0]).boundaries);
        assert_eq!(with(&[0.0, 20.0 - 1e-9]).planes[0], 0.0);
    }

    #[test]
    fn a_slab_in_vacuum_keeps_its_surfaces() {
        let s = Slices::new(Slicing::Planes, 20.0, &[5.0, 7.0, 9.0]).unwrap();
        assert_eq!(s.boundaries, vec![0.0, 6.0, 8.0, 20.0]);
        assert_eq!(s.planes, vec![5.0, 7.0, 9.0]);
        let s = Slices::new(Slicing::Planes, 20.0, &[0.0, 2.0]).unwrap();
        assert_eq!(s.entrance(), -1.0);
        // Atoms at the exit face only: the vacuum above stays, or probes would be focused somewhere else.
        let s = Slices::new(Slicing::Planes, 20.0, &[16.0, 18.0, 19.75]).unwrap();
        assert_eq!([s.entrance(), s.planes[0], s.planes[2]], [0.25, 16.0, 19.75]);
    }
}
