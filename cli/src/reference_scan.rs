//! The scan of a reference: from its file, and from options where the file does not state it.

use super::hints::hinted;
use super::scan_args::ScanArgs;
use stemgen::engine::Scan;
use stemgen::io::arrays::ForeignArray;
use stemgen::optics::Optics;
use stemgen::simulation::ScanRequest;
use stemgen::validate::user::Reference;

/// Largest relative difference between the pixels of a file and of the options.
const SAME_PIXEL: f64 = 1e-3;

/// Returns the numbers of pixels (x, y) that follow from the options without the file, if they do.
pub fn asked_pixels(args: &ScanArgs, optics: &Optics) -> anyhow::Result<Option<[usize; 2]>> {
    if args.scan_points.is_some() {
        return Ok(args.scan_points);
    }
    match (args.scan_start, args.scan_end, args.scan_step) {
        (Some(_), Some(end), Some(_)) => {
            let [rows, columns] = ScanRequest::from(args).scan(end, optics)?.shape;
            Ok(Some([columns, rows]))
        }
        _ => Ok(None),
    }
}

/// Returns the scan of a reference. The error asks for parts of it that neither the file nor the options state.
pub fn reference_scan(
    args: Option<&ScanArgs>,
    optics: &Optics,
    array: &ForeignArray,
    reference: &Reference,
) -> anyhow::Result<Scan> {
    let none = ScanArgs { scan_start: None, scan_end: None, scan_step: None, scan_points: None };
    let args = args.unwrap_or(&none);
    let (rows, columns) = reference.data.dim();
    let same_count = |shape: [usize; 2]| match shape == [rows, columns] {
        true => Ok(()),
        false => {
            let fault = array.error(format!(
                "has {columns} x {rows} pixels (x, y), but the scan has {} x {}",
                shape[1], shape[0]
            ));
            let hint = "change --scan-points or --scan-step, or leave them out; check --axes too";
            Err(hinted(fault, hint))
        }
    };
    if let Some([x, y]) = args.scan_points {
        same_count([y, x])?;
    }
    let stated = reference.step_angstrom;
    let start = args.scan_start.or(stated.and(reference.origin_angstrom));
    let pixel = stated.or(args.scan_step.map(|step| [step; 2]));
    let scan = match (start, args.scan_end, pixel) {
        (Some(_), Some(end), _) => {
            let points = args.scan_points.or(args.scan_step.is_none().then_some([columns, rows]));
            let scan = ScanArgs { scan_start: start, scan_points: points, ..args.clone() };
            ScanRequest::from(&scan).scan(end, optics)?
        }
        (Some(origin_angstrom), None, Some(step_angstrom)) => {
            Scan { origin_angstrom, step_angstrom, shape: [rows, columns] }
        }
        _ => return Err(unknown_scan(args, array, [columns, rows], stated.is_some())),
    };
    same_count(scan.shape)?;
    same_pixels(&scan, stated, array)?;
    Ok(scan)
}

/// Returns the error for a scan that is not fully stated. abTEM's arrays hold neither the start nor the end of a scan, and none is guessed.
fn unknown_scan(
    args: &ScanArgs,
    array: &ForeignArray,
    [x, y]: [usize; 2],
    tells_pixels: bool,
) -> anyhow::Error {
    let missing = match (args.scan_start.is_some(), args.scan_end.is_some()) {
        (false, _) if tells_pixels => "--scan-start X,Y",
        (true, _) => "--scan-end X,Y, or --scan-step A for square pixels",
        (false, true) => "--scan-start X,Y",
        (false, false) => "--scan-start X,Y and --scan-end X,Y",
    };
    hinted(
        array.error(format!("does not state the place of its {x} x {y} pixels (x, y)")),
        format!(
            "give {missing}, as in abtem.GridScan(start, end, endpoint=False). Files of to_zarr and to_tiff state the pixels, but not the start"
        ),
    )
}

fn same_pixels(scan: &Scan, stated: Option<[f64; 2]>, array: &ForeignArray) -> anyhow::Result<()> {
    let Some(stated) = stated else { return Ok(()) };
    let step = scan.step_angstrom;
    if (0..2).all(|i| (step[i] / stated[i] - 1.0).abs() <= SAME_PIXEL) {
        return Ok(());
    }
    let fault = array.error(format!(
        "has pixels of {:.4} x {:.4} A, but the scan has {:.4} x {:.4} A",
        stated[0], stated[1], step[0], step[1]
    ));
    Err(hinted(fault, "leave out --scan-end and --scan-step: the file states the pixels"))
}
