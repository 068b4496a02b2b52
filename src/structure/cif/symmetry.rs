//! Symmetry operations written as `-x+1/2,y,z`.

use super::super::lattice::{Mat3, Vec3, dot};
use std::collections::HashMap;

/// Translations that differ by less than this fraction of a cell count as equal; thirds may have three digits.
const SAME_TRANSLATION: f64 = 2e-3;

/// A symmetry operation on fractional coordinates: `rotation * x + translation`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Operation {
    pub rotation: [[i32; 3]; 3],
    pub translation: Vec3,
}

impl Operation {
    pub const IDENTITY: Self =
        Operation { rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation: [0.0; 3] };

    /// Reads `x,y,z` notation; the error describes the fault.
    pub fn parse(text: &str) -> Result<Self, String> {
        let parts: Vec<&str> = text.split(',').collect();
        let &[x, y, z] = parts.as_slice() else {
            return Err("expected three parts between commas, as in `-x, y+1/2, z`".to_owned());
        };
        let mut operation = Operation { rotation: [[0; 3]; 3], translation: [0.0; 3] };
        for (axis, part) in [x, y, z].into_iter().enumerate() {
            (operation.rotation[axis], operation.translation[axis]) = component(part)?;
        }
        if operation.determinant().abs() != 1 {
            return Err("the operation is not a rotation or reflection".to_owned());
        }
        Ok(operation)
    }

    fn determinant(&self) -> i32 {
        let r = self.rotation;
        (0..3)
            .map(|i| {
                let (j, k) = ((i + 1) % 3, (i + 2) % 3);
                r[0][i] * (r[1][j] * r[2][k] - r[1][k] * r[2][j])
            })
            .sum()
    }

    /// Returns the image of a fractional position.
    pub fn apply(&self, x: Vec3) -> Vec3 {
        std::array::from_fn(|i| dot(self.rotation[i].map(f64::from), x) + self.translation[i])
    }

    /// Whether both operations move every atom alike.
    pub fn moves_alike(&self, other: &Self) -> bool {
        self.rotation == other.rotation && same_translation(self.translation, other.translation)
    }

    /// Returns the product: first `other`, then `self`.
    pub fn after(&self, other: &Self) -> Self {
        let rotation = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                (0..3).map(|k| self.rotation[i][k] * other.rotation[k][j]).sum()
            })
        });
        Operation { rotation, translation: self.apply(other.translation) }
    }

    /// Returns the largest relative change of the scalar products of the cell vectors.
    pub fn strain(&self, cell: &Mat3) -> f64 {
        // Column j of the rotation is the image of cell vector j.
        let image = |j: usize| -> Vec3 {
            let r: Vec3 = std::array::from_fn(|i| f64::from(self.rotation[i][j]));
            std::array::from_fn(|c| dot(r, [cell[0][c], cell[1][c], cell[2][c]]))
        };
        let mut worst = 0.0f64;
        for i in 0..3 {
            for j in 0..=i {
                let scale = (dot(cell[i], cell[i]) * dot(cell[j], cell[j])).sqrt();
                let change = dot(image(i), image(j)) - dot(cell[i], cell[j]);
                worst = worst.max(change.abs() / scale);
            }
        }
        worst
    }
}

/// Whether translations differ by whole cells.
fn same_translation(a: Vec3, b: Vec3) -> bool {
    (0..3).all(|i| {
        let d = a[i] - b[i];
        (d - d.round()).abs() < SAME_TRANSLATION
    })
}

/// Reads one part such as `1/2-x`: the coefficients of x, y, z and the constant.
fn component(text: &str) -> Result<([i32; 3], f64), String> {
    let compact: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    let mut rest = compact.to_ascii_lowercase();
    if rest.is_empty() {
        return Err("a part between commas is empty".to_owned());
    }
    let (mut row, mut constant) = ([0i32; 3], 0.0);
    while !rest.is_empty() {
        let sign = if rest.starts_with('-') { -1 } else { 1 };
        let body = rest.strip_prefix(['-', '+']).unwrap_or(&rest);
        let end = body.find(['-', '+']).unwrap_or(body.len());
        match &body[..end] {
            "x" => row[0] += sign,
            "y" => row[1] += sign,
            "z" => row[2] += sign,
            term => {
                let value = fraction(term)
                    .ok_or_else(|| format!("`{term}` is not x, y, z or a fraction"))?;
                constant += f64::from(sign) * value;
            }
        }
        rest = body[end..].to_owned();
    }
    Ok((row, constant))
}

fn fraction(text: &str) -> Option<f64> {
    let number = |t: &str| {
        let plain = !t.is_empty() && t.chars().all(|c| c.is_ascii_digit() || c == '.');
        plain.then(|| t.parse::<f64>().ok()).flatten().filter(|v| *v <= 100.0)
    };
    match text.split_once('/') {
        Some((top, bottom)) => {
            let (top, bottom) = (number(top)?, number(bottom)?);
            (bottom > 0.0).then(|| top / bottom)
        }
        None => number(text),
    }
}

/// Returns a pair of operations (their indices) whose product is not in the list: a list that is cut off or mistyped is no group.
pub fn missing_product(operations: &[Operation]) -> Option<(usize, usize)> {
    let mut known: HashMap<[[i32; 3]; 3], Vec<Vec3>> = HashMap::new();
    for operation in operations {
        known.entry(operation.rotation).or_default().push(operation.translation);
    }
    let has = |product: &Operation| {
        known
            .get(&product.rotation)
            .is_some_and(|list| list.iter().any(|t| same_translation(product.translation, *t)))
    };
    (0..operations.len())
        .flat_map(|i| (0..operations.len()).map(move |j| (i, j)))
        .find(|&(i, j)| !has(&operations[i].after(&operations[j])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notation_in_its_variants() {
        let op = Operation::parse(" 1/2 - X, y+0.25 ,+z-x").unwrap();
        assert_eq!(op.rotation, [[-1, 0, 0], [0, 1, 0], [-1, 0, 1]]);
        assert_eq!(op.translation, [0.5, 0.25, 0.0]);
        assert_eq!(op.apply([0.1, 0.2, 0.3]), [0.4, 0.45, 0.3 - 0.1]);
        for bad in ["x,y", "x,y,", "x,y,w", "x,y,1/0", "x,x,z", "x,y,z,x", "x,y,1e9", ""] {
            assert!(Operation::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_list_that_is_cut_off_is_no_group() {
        let of = |list: &[&str]| -> Vec<Operation> {
            list.iter().map(|t| Operation::parse(t).unwrap()).collect()
        };
        let four = ["x,y,z", "-y,x,z", "-x,-y,z", "y,-x,z"];
        assert_eq!(missing_product(&of(&four)), None);
        assert_eq!(missing_product(&of(&four[..2])), Some((1, 1)));
        assert_eq!(missing_product(&of(&["x,y,z", "-y,x-y,z+0.333", "y-x,-x,z+0.667"])), None);
        assert_eq!(missing_product(&of(&["x,y,z", "x+1/2,y+1/2,z"])), None);
    }

    #[test]
    fn strain_tells_an_operation_that_the_cell_does_not_have() {
        let cell = [[3.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 5.0]];
        assert!(Operation::parse("-x,y,z").unwrap().strain(&cell) < 1e-12);
        assert!(Operation::parse("-y,x,z").unwrap().strain(&cell) > 0.1);
        let hexagonal = [[3.0, 0.0, 0.0], [-1.5, 3.0 * 0.75f64.sqrt(), 0.0], [0.0, 0.0, 5.0]];
        assert!(Operation::parse("-y,x-y,z").unwrap().strain(&hexagonal) < 1e-12);
    }
}
