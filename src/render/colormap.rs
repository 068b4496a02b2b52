//! Colours of values from 0 to 1.

use crate::error::{Error, Result};
use crate::setting::Setting;

/// A perceptually uniform colour map: equal steps of the value look equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Colormap {
    /// Black to white.
    #[default]
    Gray,
    /// Dark blue over green to yellow.
    Viridis,
    /// Black over red to pale yellow.
    Inferno,
    /// Black over purple to pale pink.
    Magma,
}

impl Colormap {
    /// All maps, by name.
    pub(crate) const NAMES: [(&'static str, Colormap); 4] = [
        ("gray", Colormap::Gray),
        ("viridis", Colormap::Viridis),
        ("inferno", Colormap::Inferno),
        ("magma", Colormap::Magma),
    ];

    /// Its name.
    pub(crate) fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, map)| *map == self).map_or("gray", |(name, _)| name)
    }

    /// The 256 colours (red, green, blue).
    pub(crate) fn table(self) -> [[u8; 3]; 256] {
        std::array::from_fn(|i| {
            let gradient = match self {
                Colormap::Gray => return [i as u8; 3],
                Colormap::Viridis => colorous::VIRIDIS,
                Colormap::Inferno => colorous::INFERNO,
                Colormap::Magma => colorous::MAGMA,
            };
            let color = gradient.eval_rational(i, 256);
            [color.r, color.g, color.b]
        })
    }
}

impl std::str::FromStr for Colormap {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let found = Self::NAMES.iter().find(|(name, _)| name.eq_ignore_ascii_case(text));
        found.map(|(_, map)| *map).ok_or_else(|| {
            Error::invalid(Setting::Colormap, text, "expected gray, viridis, inferno or magma")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_grow_lighter() {
        for (name, map) in Colormap::NAMES {
            assert_eq!(name.parse::<Colormap>().unwrap(), map);
            let light = map.table().map(|[r, g, b]| {
                0.2126 * f64::from(r) + 0.7152 * f64::from(g) + 0.0722 * f64::from(b)
            });
            assert!(light.windows(2).all(|w| w[1] > w[0] - 1.0), "{name}");
            assert!(light[255] - light[0] > 150.0, "{name}");
        }
        assert!("jet".parse::<Colormap>().is_err());
    }
}
