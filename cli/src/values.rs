//! Parsers of option values. Each message continues clap's `invalid value '...' for '...': `.

use super::foreign_options::foreign_options;
use clap::ValueEnum;
use std::collections::BTreeMap;
use std::str::FromStr;
use stemgen::detect::Detector;
use stemgen::detectability::AskedDefect;
use stemgen::engine::{Expansion, ProbeStep};
use stemgen::files::Shard;
use stemgen::io::TiffDepth;
use stemgen::optics::Aberration;
use stemgen::potential::{Parametrization, Projection};
use stemgen::recipe::Difficulty;
use stemgen::simulation::{self, FromFile, FromTable, SigmaChoice};
use stemgen::structure::{FrameRange, LARGEST_SIGMA_ANGSTROM, direction, elements};

type Parsed<T> = Result<T, String>;

fn numbers<T: FromStr, const N: usize>(text: &str, separator: char, form: &str) -> Parsed<[T; N]> {
    let parse = |part: &str| part.trim().parse().map_err(|_| format!("write {form}"));
    let parts = text.split(separator).map(parse).collect::<Parsed<Vec<T>>>()?;
    parts.try_into().map_err(|_| format!("write {form}"))
}

/// Reads a finite number.
pub fn finite(text: &str) -> Parsed<f64> {
    let value = text.trim().parse().ok().filter(|v: &f64| v.is_finite());
    value.ok_or_else(|| "write a number, such as 12.5".into())
}

/// Reads a number above 0.
pub fn positive(text: &str) -> Parsed<f64> {
    let value = finite(text)?;
    if value > 0.0 { Ok(value) } else { Err("write a number above 0".into()) }
}

/// A number, or a series `START:END:STEP` with both ends.
#[derive(Debug, Clone, PartialEq)]
pub struct NumberSeries(pub Vec<f64>);

/// Most values of a series.
const LONGEST_SERIES: f64 = 1000.0;

/// Reads `0/16`, or `slurm` for the number of this task in a job array.
pub fn shard(text: &str) -> Parsed<Shard> {
    let shard = match text.trim() {
        "slurm" => Shard::of_slurm(|name| std::env::var(name).ok()),
        text => text.parse(),
    };
    shard.map_err(|e| e.to_string())
}

/// Reads `30` or `0:100:20`.
pub fn series(text: &str) -> Parsed<NumberSeries> {
    if !text.contains(':') {
        return Ok(NumberSeries(vec![finite(text)?]));
    }
    let form = "a number or START:END:STEP, such as 0:100:20";
    let [start, end, step]: [f64; 3] = numbers(text, ':', form)?;
    let count = ((end - start) / step + 1e-9).floor();
    if !(0.0..LONGEST_SERIES).contains(&count) || !(start + step).is_finite() {
        return Err(format!(
            "write {form}; the step leads from START to END in at most {LONGEST_SERIES}"
        ));
    }
    Ok(NumberSeries((0..=count as usize).map(|n| start + n as f64 * step).collect()))
}

/// Doses: a number, or `LOW:HIGH`, one dose for each decade with both ends.
#[derive(Debug, Clone, PartialEq)]
pub struct DoseRange(pub Vec<f64>);

/// Reads `1e4` or `1e2:1e6`.
pub fn doses(text: &str) -> Parsed<DoseRange> {
    let Some((low, high)) = text.split_once(':') else {
        return Ok(DoseRange(vec![positive(text)?]));
    };
    let (low, high) = (positive(low)?, positive(high)?);
    if high < low {
        return Err("the second dose is the higher one, as in 1e2:1e6".into());
    }
    let mut all = Vec::new();
    let mut dose = low;
    while dose < high * (1.0 - 1e-9) {
        all.push(dose);
        dose *= 10.0;
    }
    all.push(high);
    Ok(DoseRange(all))
}

/// Reads `vacancy:O@middle`.
pub fn defect(text: &str) -> Parsed<AskedDefect> {
    text.parse().map_err(|e: stemgen::Error| e.to_string())
}

/// Bits of a grey value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Bits {
    /// Integers from 0 to 255
    #[value(name = "8")]
    Eight,
    /// Integers from 0 to 65535
    #[value(name = "16")]
    Sixteen,
    /// Floating-point numbers, the values unchanged
    #[value(name = "32")]
    ThirtyTwo,
}

impl From<Bits> for TiffDepth {
    fn from(bits: Bits) -> Self {
        match bits {
            Bits::Eight => TiffDepth::Bits8,
            Bits::Sixteen => TiffDepth::Bits16,
            Bits::ThirtyTwo => TiffDepth::Bits32,
        }
    }
}

/// Reads a number with or without a per cent sign.
pub fn percent(text: &str) -> Parsed<f64> {
    let text = text.trim();
    finite(text.strip_suffix('%').unwrap_or(text))
        .map_err(|_: String| "write per cent, such as 1 or 0.5%".into())
}

/// Reads `auto`, `scan` or a length in Angstrom.
pub fn probe_step(text: &str) -> Parsed<ProbeStep> {
    match text.trim() {
        "auto" => Ok(ProbeStep::Auto),
        "scan" => Ok(ProbeStep::Scan),
        length => match finite(length) {
            Ok(step) if step > 0.0 => Ok(ProbeStep::Angstrom(step)),
            _ => Err("write auto, scan or a distance in A, such as 0.25".into()),
        },
    }
}

/// Reads `auto`, `off` or per cent of an amplitude.
pub fn expansion(text: &str) -> Parsed<Expansion> {
    match text.trim() {
        "auto" => Ok(Expansion::Auto),
        "off" => Ok(Expansion::Off),
        percent => match finite(percent.strip_suffix('%').unwrap_or(percent)) {
            Ok(error) if error > 0.0 => Ok(Expansion::Error(error / 100.0)),
            _ => Err("write auto, off or per cent of the amplitude, such as 0.5".into()),
        },
    }
}

/// Reads `X,Y`.
pub fn point(text: &str) -> Parsed<[f64; 2]> {
    let point = numbers(text, ',', "two numbers, such as 0,3.9")?;
    let finite = point.iter().all(|v: &f64| v.is_finite());
    finite.then_some(point).ok_or_else(|| "both numbers must be finite".into())
}

/// Reads `X0,Y0,X1,Y1`.
pub fn rectangle(text: &str) -> Parsed<[f64; 4]> {
    let corners: [f64; 4] = numbers(text, ',', "four numbers X0,Y0,X1,Y1, such as 10,10,20,20")?;
    match corners {
        [x0, y0, x1, y1] if x0 < x1 && y0 < y1 && corners.iter().all(|v| v.is_finite()) => {
            Ok(corners)
        }
        _ => Err("the second corner must lie right of and below the first".into()),
    }
}

/// Reads `LOW,HIGH` in per cent.
pub fn percentiles(text: &str) -> Parsed<[f64; 2]> {
    let form = "two percentages, such as 0.1,99.9";
    match numbers(text, ',', form)? {
        [low, high] if 0.0 <= low && low < high && high <= 100.0 => Ok([low, high]),
        _ => Err("the percentages must rise, from 0 to 100".into()),
    }
}

/// Reads `NX,NY`.
pub fn counts2(text: &str) -> Parsed<[usize; 2]> {
    numbers(text, ',', "two whole numbers, such as 512,512")
}

/// Reads `NX,NY,NZ`.
pub fn counts3(text: &str) -> Parsed<[usize; 3]> {
    numbers(text, ',', "three whole numbers, such as 3,3,10")
}

/// Reads `u,v,w`, or the four indices of a hexagonal lattice, `u,v,t,w`.
pub fn direction(text: &str) -> Parsed<[i32; 3]> {
    let form = "three whole numbers, such as 1,1,0 (or the four of a hexagonal lattice, 2,-1,-1,0)";
    if text.matches(',').count() == 3 {
        return direction::of_four(numbers(text, ',', form)?);
    }
    numbers(text, ',', form)
}

/// Reads `F` or `FX,FY`.
pub fn factors(text: &str) -> Parsed<[usize; 2]> {
    let form = "one or two whole numbers from 1 up, such as 4 or 4,2";
    let both = if text.contains(',') { text.to_owned() } else { format!("{text},{text}") };
    let factors: [usize; 2] = numbers(&both, ',', form)?;
    (!factors.contains(&0)).then_some(factors).ok_or_else(|| format!("write {form}"))
}

/// Reads `RxC`.
pub fn rows_columns(text: &str) -> Parsed<[usize; 2]> {
    numbers(&text.to_ascii_lowercase(), 'x', "rows x columns, such as 2x2")
}

/// Reads `C12=30@0.3`.
pub fn aberration(text: &str) -> Parsed<Aberration> {
    Aberration::parse(text).map_err(|e| e.to_string())
}

/// A detector, or the sectors of one.
#[derive(Debug, Clone)]
pub struct DetectorGroup(pub Vec<Detector>);

/// Reads `HAADF=68-200` or `DPC=0-21:4@45`.
pub fn detector(text: &str) -> Parsed<DetectorGroup> {
    // With sectors, DPC is a good name.
    if let Some(message) = foreign_options(text).filter(|_| !text.contains(':')) {
        return Err(message.into());
    }
    let detectors = Detector::parse_all(text).map_err(|e| e.to_string())?;
    let plain = detectors.iter().try_for_each(simulation::check_detector);
    plausible(plain, DetectorGroup(detectors))
}

/// Reads a semiangle in mrad.
pub fn semiangle(text: &str) -> Parsed<f64> {
    let value = finite(text)?;
    plausible(simulation::check_semiangle(value), value)
}

/// Reads an energy in keV.
pub fn energy(text: &str) -> Parsed<f64> {
    let value = finite(text)?;
    plausible(simulation::check_energy(value), value)
}

/// Refuses an implausible value, such as an energy in eV. The message leaves the value out, since clap prints it.
fn plausible<T>(checked: stemgen::Result<()>, value: T) -> Parsed<T> {
    match checked {
        Ok(()) => Ok(value),
        Err(stemgen::Error::Invalid { expected, .. }) => Err(expected),
        Err(other) => Err(other.to_string()),
    }
}

/// Reads standard deviations of thermal displacements: `from-file`, `table`, `0.08` or `Sr=0.084,O=0.085`.
pub fn sigma_choice(text: &str) -> Parsed<SigmaChoice> {
    match text.trim() {
        "from-file" => Ok(SigmaChoice::FromFile(FromFile::FromFile)),
        "table" => Ok(SigmaChoice::FromTable(FromTable::FromTable)),
        given => sigmas(given),
    }
}

/// Reads `all`, `START:END` or `START:END:STEP`, both ends included.
pub fn frames(text: &str) -> Parsed<FrameRange> {
    let form = "all, START:END or START:END:STEP, such as 10:200:5; frames count from 0";
    if text.trim() == "all" {
        return Ok(FrameRange { start: 0, end: None, step: 1 });
    }
    let whole = if text.matches(':').count() == 1 { format!("{text}:1") } else { text.into() };
    let [start, end, step]: [usize; 3] = numbers(&whole, ':', form)?;
    let range = FrameRange { start, end: Some(end), step };
    (start <= end && step > 0).then_some(range).ok_or_else(|| format!("write {form}"))
}

/// Reads standard deviations of thermal displacements in Angstrom: `0.08` or `Sr=0.084,O=0.085`.
fn sigmas(text: &str) -> Parsed<SigmaChoice> {
    let sigma = |text: &str| {
        let value = finite(text).ok().filter(|v| (0.0..=LARGEST_SIGMA_ANGSTROM).contains(v));
        value
            .ok_or_else(|| format!("`{text}`: write a length from 0 to {LARGEST_SIGMA_ANGSTROM} A"))
    };
    if !text.contains('=') {
        return Ok(SigmaChoice::All(sigma(text)?));
    }
    let mut map = BTreeMap::new();
    for part in text.split(',').filter(|p| !p.trim().is_empty()) {
        let (symbol, value) =
            part.split_once('=').ok_or_else(|| format!("`{part}`: write Sr=0.084,O=0.085"))?;
        let number = elements::atomic_number(symbol).map_err(|e| e.to_string())?;
        let symbol = elements::symbol(number);
        if map.insert(symbol.to_owned(), sigma(value)?).is_some() {
            return Err(format!("{symbol} is given twice"));
        }
    }
    Ok(SigmaChoice::ByElement(map))
}

/// Engines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineName {
    /// Propagates every probe on the full grid: exact
    Multislice,
    /// Propagates plane waves and puts probes together from them; exact with --interpolation 1
    Prism,
    /// Propagates every probe in a window, a small box that follows it
    Window,
    /// For worlds only: columns with the same atoms and the same neighbours use one simulation (in windows). Carbon films are
    /// computed atom by atom, without interference
    Mosaic,
}

/// Box in which the probe has norm 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProbeBoxName {
    /// In the simulated cell
    Cell,
    /// In a box of 75 A or more
    Large,
}

impl From<ProbeBoxName> for stemgen::engine::ProbeBox {
    fn from(name: ProbeBoxName) -> Self {
        match name {
            ProbeBoxName::Cell => Self::Cell,
            ProbeBoxName::Large => Self::Large,
        }
    }
}

/// How an atom is distributed over slices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProjectionName {
    /// Each atom is projected into the slice of its nucleus
    Infinite,
    /// Each atom is divided among the slices that it extends over
    Finite,
}

impl From<ProjectionName> for Projection {
    fn from(name: ProjectionName) -> Self {
        match name {
            ProjectionName::Infinite => Projection::Infinite,
            ProjectionName::Finite => Projection::Finite,
        }
    }
}

/// Tables of scattering factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ParametrizationName {
    /// I. Lobato and D. Van Dyck, 2014
    Lobato,
    /// E. J. Kirkland, 2010
    Kirkland,
    /// L.-M. Peng et al., 1996
    Peng,
}

impl From<ParametrizationName> for Parametrization {
    fn from(name: ParametrizationName) -> Self {
        match name {
            ParametrizationName::Lobato => Parametrization::Lobato,
            ParametrizationName::Kirkland => Parametrization::Kirkland,
            ParametrizationName::Peng => Parametrization::Peng,
        }
    }
}

/// Tiers of a recipe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Tier {
    /// Many defects, high dose
    Easy,
    /// Between easy and hard
    Medium,
    /// Few defects, low dose
    Hard,
}

impl From<Tier> for Difficulty {
    fn from(tier: Tier) -> Self {
        match tier {
            Tier::Easy => Difficulty::Easy,
            Tier::Medium => Difficulty::Medium,
            Tier::Hard => Difficulty::Hard,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_and_bad_ones_explained() {
        assert_eq!(factors("4"), Ok([4, 4]));
        assert_eq!(factors("4,2"), Ok([4, 2]));
        assert!(factors("0").is_err() && factors("1,2,3").is_err());
        assert_eq!(rows_columns("2X3"), Ok([2, 3]));
        assert_eq!(direction("-1,1,0"), Ok([-1, 1, 0]));
        assert_eq!(direction("2,-1,-1,0"), Ok([1, 0, 0]));
        assert_eq!(direction("1,1,-2,0"), Ok([1, 1, 0]));
        assert!(direction("1,1,1,0").unwrap_err().contains("must add to 0"));
        assert!(direction("1,1").is_err() && direction("0,0,0,0").is_err());
        assert_eq!(rectangle("0,1,2,3.5"), Ok([0.0, 1.0, 2.0, 3.5]));
        assert!(rectangle("0,1,0,2").is_err() && rectangle("0,1,2").is_err());
        assert_eq!(percentiles("1,99"), Ok([1.0, 99.0]));
        assert!(percentiles("99,1").is_err() && percentiles("0,101").is_err());
        assert!(point("1,nan").is_err() && finite("inf").is_err());
        assert_eq!(sigmas("0.08"), Ok(SigmaChoice::All(0.08)));
        let both = [("O", 0.085), ("Sr", 0.084)].map(|(symbol, a)| (symbol.to_owned(), a)).into();
        assert_eq!(sigmas("Sr=0.084, O=0.085"), Ok(SigmaChoice::ByElement(both)));
        for bad in ["", "-1", "Xx=0.1", "Sr=", "Sr=0.1,Sr=0.2", "Sr=0.1,O", "5"] {
            assert!(sigmas(bad).is_err(), "{bad}");
        }
        assert!(detector("..=1-2").is_err());
        assert_eq!(percent(" 50% "), Ok(50.0));
        assert!(percent("50%%").is_err() && expansion("0.5%%").is_err());
        assert_eq!(frames("10:200:5"), Ok(FrameRange { start: 10, end: Some(200), step: 5 }));
        assert_eq!(frames("5:5"), Ok(FrameRange { start: 5, end: Some(5), step: 1 }));
        assert!(["5:4", "3", "0:9:0", "-1:4"].iter().all(|f| frames(f).is_err()));
        assert_eq!(sigma_choice("from-file"), Ok(SigmaChoice::FromFile(FromFile::FromFile)));
        assert_eq!(series("30").unwrap().0, [30.0]);
        assert_eq!(series("0:100:20").unwrap().0, [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]);
        assert_eq!(series("10:-10:-10").unwrap().0, [10.0, 0.0, -10.0]);
        assert!(["0:10", "0:10:0", "0:10:-1", "0:1e9:1"].iter().all(|s| series(s).is_err()));
    }
}
