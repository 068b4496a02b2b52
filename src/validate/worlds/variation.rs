//! The length over which worlds of one recipe differ. Sites and electrons are drawn one by one, but interfaces and phase boundaries wander:
//! the part of them in a field varies over their length, which no single place of the field shows.

use serde::Serialize;

/// Number of slow waves along an axis, if nothing varies over more than a fifth of the field.
const WAVES: usize = 5;
/// Number of waves over the width, if only parts of the full height are independent.
const WAVES_ACROSS: usize = 16;
/// Number of the fastest wave along y that holds 80 % of the power of the slowest, times the correlation length (of a Gaussian
/// correlation), in heights of the field.
const FASTEST: f64 = 0.21;
/// Height of independent parts in correlation lengths: the integral of the correlation, sqrt(2 pi).
const PART: f64 = 2.5;

/// How worlds of one kind vary, in ascending order.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize)]
#[serde(rename_all = "snake_case", tag = "kind", content = "nm")]
pub enum Variation {
    /// Places far apart vary independently, according to the recipe.
    Local,
    /// Interfaces along y vary over this correlation length in nm.
    AlongY(f64),
    /// Boundaries along y wander over the height of the full field, and the world holds all of it.
    FullHeight,
    /// Boundaries wander over this length in nm, and the world holds only a part of it.
    Beyond(f64),
}

impl Variation {
    /// Derives the variation from the recipe of a world with this height and width.
    pub(crate) fn of_recipe(recipe: Option<&toml::Table>, extent_nm: [f64; 2]) -> Self {
        let value = |keys: [&str; 2]| recipe?.get(keys[0])?.get(keys[1]);
        let as_number = |v: &toml::Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
        let number = |keys: [&str; 2]| value(keys).and_then(as_number);
        let field = value(["field", "fov_nm"]).and_then(|v| v.as_array());
        let full: Vec<f64> = field.into_iter().flatten().filter_map(as_number).collect();
        if number(["domains", "waviness"]).is_some_and(|w| w > 0.0) {
            // Whole tiles may fall short of the field by a per cent.
            return match full[..] {
                [height, width] if extent_nm[0] < 0.98 * height || extent_nm[1] < 0.98 * width => {
                    Variation::Beyond(height)
                }
                _ => Variation::FullHeight,
            };
        }
        match number(["wells", "roughness_nm"]).is_some_and(|r| r > 0.0) {
            true => number(["wells", "roughness_correlation_nm"])
                .map_or(Variation::FullHeight, Variation::AlongY),
            false => Variation::Local,
        }
    }

    /// Returns the greater variation.
    pub(crate) fn most(self, other: Self) -> Self {
        if other > self { other } else { self }
    }

    /// Returns the numbers of waves along y and x, the constant one included, that carry as much of the variation as the mean of a field of
    /// this height does; `None` if no part of the field is independent of the others.
    pub(crate) fn waves(self, height_nm: f64) -> Option<[usize; 2]> {
        match self {
            Variation::Local => Some([WAVES, WAVES]),
            Variation::AlongY(length) => {
                let fastest = (FASTEST * height_nm / length) as usize;
                Some([(1 + fastest).min(WAVES), WAVES])
            }
            Variation::FullHeight => Some([1, WAVES_ACROSS]),
            Variation::Beyond(_) => None,
        }
    }

    /// Returns the number of rows of blocks in an independent part, of `rows` in all; `None` if there is no such part.
    pub(crate) fn rows_of_part(self, rows: usize, height_nm: f64) -> Option<usize> {
        match self {
            Variation::Local => Some(1),
            Variation::AlongY(length) => {
                let part = (PART * length / height_nm * rows as f64).ceil();
                Some((part as usize).clamp(1, rows))
            }
            Variation::FullHeight => Some(rows),
            Variation::Beyond(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recipes_tell_how_their_worlds_vary() {
        let of = |text: &str, extent| Variation::of_recipe(Some(&text.parse().unwrap()), extent);
        let wells = "[wells]\nroughness_nm = 0.5\nroughness_correlation_nm = 3.0";
        assert_eq!(of(wells, [16.0, 16.0]), Variation::AlongY(3.0));
        assert_eq!(of("[wells]\nroughness_nm = 0.0", [16.0, 16.0]), Variation::Local);
        let domains = "[field]\nfov_nm = [100.0, 100]\n[domains]\nwaviness = 0.1";
        assert_eq!(of(domains, [99.5, 100.1]), Variation::FullHeight);
        assert_eq!(of(domains, [10.0, 100.0]), Variation::Beyond(100.0));
        assert_eq!(Variation::of_recipe(None, [1.0, 1.0]), Variation::Local);
        let most = Variation::AlongY(3.0).most(Variation::Local);
        assert_eq!(most, Variation::AlongY(3.0));
        assert_eq!((most.waves(16.1), most.waves(80.0)), (Some([2, 5]), Some([5, 5])));
        assert_eq!((most.rows_of_part(16, 16.0), most.rows_of_part(16, 80.0)), (Some(8), Some(2)));
        assert_eq!(Variation::Beyond(100.0).waves(10.0), None);
    }
}
