//! Reads the size of a pixel of a TIFF: from ImageJ's or OME's description, or from the resolution.

use crate::io::foreign::length_units::unit_nm;
use crate::lengths;

/// Sides of a pixel along x and y in Angstrom; otherwise a reason, if there is one to report.
pub(super) type PixelSides = std::result::Result<[f64; 2], Option<String>>;

/// The tags that give the number of pixels in a unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Resolution {
    /// Number of pixels in a unit along x and y.
    pub per_unit: Option<[f64; 2]>,
    /// Code of the unit: 1 for none, 2 for the inch, 3 for the centimetre.
    pub unit: Option<u32>,
}

const INCH: u32 = 2;
const CENTIMETRE: u32 = 3;
/// A resolution with larger pixels than this was made for a printer, not by a microscope: 25 400 pixels in an inch.
const LARGEST_RESOLVED_ANGSTROM: f64 = 1e4;

/// Returns the sides of a pixel.
pub(super) fn sides(descriptions: &[String], resolution: Resolution) -> PixelSides {
    let imagej = descriptions.iter().find(|text| text.starts_with("ImageJ="));
    let ome = descriptions.iter().find_map(|text| pixels_element(text));
    match (imagej.and_then(|text| imagej_unit(text)), ome.and_then(of_ome)) {
        (_, Some(sides)) => sides,
        (Some(unit), None) => of_unit(&unit, resolution),
        (None, None) => of_tags(resolution),
    }
}

/// Returns the unit of ImageJ. Characters beyond ASCII may be written as `\u00B5`.
fn imagej_unit(text: &str) -> Option<String> {
    let unit = text.lines().find_map(|line| line.strip_prefix("unit="))?.trim();
    let mut plain = String::new();
    let mut rest = unit;
    while let Some((before, after)) = rest.split_once("\\u") {
        let code = after.get(..4).and_then(|digits| u32::from_str_radix(digits, 16).ok());
        let Some(letter) = code.and_then(char::from_u32) else { break };
        plain += before;
        plain.push(letter);
        rest = &after[4..];
    }
    plain += rest;
    (!plain.is_empty()).then_some(plain)
}

/// Returns the sides from the number of pixels in a named unit.
fn of_unit(unit: &str, resolution: Resolution) -> PixelSides {
    let Some(per_unit) = resolution.per_unit else { return Err(None) };
    let Some(nm) = unit_nm(unit) else {
        let said =
            format!("ImageJ says that its pixels are counted in `{unit}`, which is no length");
        return Err(Some(said));
    };
    positive(per_unit.map(|n| lengths::angstrom(nm) / n))
}

/// Returns the sides from the number of pixels in an inch or a centimetre.
fn of_tags(resolution: Resolution) -> PixelSides {
    let Some(per_unit) = resolution.per_unit else { return Err(None) };
    let (name, nm) = match resolution.unit {
        None | Some(INCH) => ("inch", 2.54e7),
        Some(CENTIMETRE) => ("cm", 1e7),
        Some(_) => return Err(None),
    };
    let sides = positive(per_unit.map(|n| lengths::angstrom(nm) / n))?;
    match sides.iter().all(|side| *side <= LARGEST_RESOLVED_ANGSTROM) {
        true => Ok(sides),
        false => Err(Some(format!(
            "its resolution of {} in the {name} is one for a printer",
            per_unit[0]
        ))),
    }
}

fn positive(sides: [f64; 2]) -> PixelSides {
    let good = sides.iter().all(|side| side.is_finite() && *side > 0.0);
    if good { Ok(sides) } else { Err(None) }
}

/// Returns the attributes of the first element `Pixels` in OME's XML.
fn pixels_element(text: &str) -> Option<&str> {
    let text = text.contains("openmicroscopy.org").then_some(text)?;
    let at =
        ["<Pixels ", "<OME:Pixels ", "<ome:Pixels "].iter().find_map(|open| text.find(open))?;
    text[at..].split_once(' ')?.1.split('>').next()
}

/// Returns the sides from OME: `PhysicalSizeX` in `PhysicalSizeXUnit`, micrometres if there is no unit. `None` if it gives no sizes.
fn of_ome(element: &str) -> Option<PixelSides> {
    let side = |axis: char| -> Option<std::result::Result<f64, String>> {
        let size: f64 = attribute(element, &format!("PhysicalSize{axis}"))?.parse().ok()?;
        let unit = attribute(element, &format!("PhysicalSize{axis}Unit"));
        let unit = unit.unwrap_or_else(|| "\u{b5}m".into());
        let no_length =
            || format!("OME says that its pixels are {size} `{unit}`, which is no length");
        Some(unit_nm(&unit).map(|nm| lengths::angstrom(nm) * size).ok_or_else(no_length))
    };
    let (x, y) = (side('X')?, side('Y')?);
    Some(match (x, y) {
        (Ok(x), Ok(y)) => positive([x, y]),
        (Err(why), _) | (_, Err(why)) => Err(Some(why)),
    })
}

/// Returns the value of an XML attribute.
fn attribute(element: &str, name: &str) -> Option<String> {
    let open = [format!(" {name}=\""), format!(" {name}='")];
    let element = format!(" {}", element.replace(['\n', '\r', '\t'], " "));
    let (at, open) = open.iter().find_map(|open| Some((element.find(open)?, open)))?;
    let value = element[at + open.len()..].split(['"', '\'']).next()?;
    let mut plain = value.to_owned();
    for (entity, letter) in
        [("&#181;", "\u{b5}"), ("&#xB5;", "\u{b5}"), ("&#197;", "\u{c5}"), ("&#xC5;", "\u{c5}")]
    {
        plain = plain.replace(entity, letter);
    }
    Some(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(description: &str, per_unit: f64, unit: u32) -> PixelSides {
        let resolution = Resolution { per_unit: Some([per_unit; 2]), unit: Some(unit) };
        sides(&[description.to_owned()], resolution)
    }

    #[test]
    fn imagej_counts_pixels_in_its_unit_whatever_the_tag_says() {
        for (unit, angstrom) in
            [("nm", 0.2), ("micron", 200.0), ("\\u00B5m", 200.0), ("\\u00C5", 0.02), ("cm", 2e6)]
        {
            let sides = of(&format!("ImageJ=1.54f\nimages=1\nunit={unit}\nmin=0.0\n"), 50.0, 2);
            let [x, y] = sides.unwrap();
            assert!((x / angstrom - 1.0).abs() < 1e-12 && x == y, "{unit}: {x}");
        }
        let message = of("ImageJ=1.54f\nunit=pixel\n", 1.0, 1).unwrap_err().unwrap();
        assert!(message.contains("`pixel`, which is no length"), "{message}");
        assert_eq!(of("ImageJ=1.54f\n", 1.0, 1), Err(None));
    }

    #[test]
    fn ome_says_sizes_and_units() {
        let xml = |pixels: &str| {
            let space = "http://www.openmicroscopy.org/Schemas/OME/2016-06";
            format!(
                "<?xml version=\"1.0\"?><OME xmlns=\"{space}\"><Image><Pixels ID=\"1\" {pixels}/>"
            )
        };
        let unit = "PhysicalSizeXUnit=\"nm\" PhysicalSizeYUnit='&#197;'";
        let sides =
            of(&xml(&format!("PhysicalSizeX=\"0.02\" PhysicalSizeY=\"0.3\" {unit}")), 1.0, 1);
        let [x, y] = sides.unwrap();
        assert!((x - 0.2).abs() < 1e-12 && (y - 0.3).abs() < 1e-12, "{x} {y}");
        let micrometres =
            of(&xml("PhysicalSizeX=\"2e-5\" PhysicalSizeY=\"2e-5\""), 1.0, 1).unwrap();
        assert!((micrometres[0] - 0.2).abs() < 1e-12);
        let pixel = "PhysicalSizeX=\"1\" PhysicalSizeY=\"1\" PhysicalSizeXUnit=\"pixel\"";
        assert!(of(&xml(pixel), 1.0, 1).unwrap_err().unwrap().contains("no length"));
        assert_eq!(of(&xml("SizeX=\"9\""), 1.0, 1), Err(None));
    }

    #[test]
    fn resolutions_of_printers_are_none_of_microscopes() {
        let [x, _] = of("", 5e8, CENTIMETRE).unwrap();
        assert!((x - 0.2).abs() < 1e-12, "{x}");
        for (per_unit, unit) in [(72.0, INCH), (300.0, INCH), (118.0, CENTIMETRE)] {
            let message = of("", per_unit, unit).unwrap_err().unwrap();
            assert!(message.contains("one for a printer"), "{message}");
        }
        assert_eq!(of("", 1.0, 1), Err(None));
        assert_eq!(of("", 0.0, INCH), Err(None));
        assert_eq!(sides(&[], Resolution::default()), Err(None));
    }
}
