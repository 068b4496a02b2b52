//! Writes files of patterns other than HDF5: sparse counts (raw CSR of LiberTEM 0.16), and frames of the EMPAD.
//!
//! - raw CSR: a TOML file that names three arrays: the start of each pattern's pixels (int64), the pixels that electrons hit (int32,
//!   row-major) and their electrons (int32). Its table `stemgen` describes the origin of the patterns.
//! - EMPAD: for each probe 130 x 128 float32, of which the last two rows are empty; patterns are upside down, as the detector records them.
//!   `NAME.json` is for phaser, `NAME.xml` for LiberTEM, HyperSpy and py4DSTEM.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use ndarray::{ArrayView2, ArrayView4};
use serde_json::json;

use super::pattern_file::{PatternHeader, PatternOrigin};
use super::pattern_format::{EMPAD_PIXELS, EMPAD_SPARE_ROWS, PatternFormat};
use crate::error::{Error, Result};

/// One of several files, under its temporary name until all are complete.
struct RawPart {
    path: PathBuf,
    file: BufWriter<File>,
}

impl RawPart {
    fn new(temporary: &Path, path: &Path) -> Result<Self> {
        let file = File::options().write(true).truncate(true).open(temporary);
        let file = file.map_err(|e| Error::io(path, "write", e))?;
        Ok(RawPart { path: path.to_owned(), file: BufWriter::new(file) })
    }

    fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|e| Error::io(&self.path, "write", e))
    }

    fn end(&mut self) -> Result<()> {
        self.file.flush().map_err(|e| Error::io(&self.path, "write", e))
    }
}

/// Writes raw CSR.
pub(crate) struct CsrWriter {
    /// The files of index pointers, indices and values.
    parts: [RawPart; 3],
    /// Number of hit pixels so far.
    hit: i64,
}

impl CsrWriter {
    /// Starts the files; `temporaries` are the TOML file and its companions, at `path`.
    pub fn new(
        temporaries: &[PathBuf],
        path: &Path,
        header: &PatternHeader,
        origin: &PatternOrigin<'_>,
    ) -> Result<Self> {
        let names = PatternFormat::SparseCsr.companions(path);
        let name = |n: usize| names[n].file_name().unwrap_or_default().display().to_string();
        let [ky, kx] = header.detector.shape();
        let table = json!({
            "params": { "filetype": "raw_csr", "nav_shape": header.scan.shape, "sig_shape": [ky, kx] },
            "raw_csr": {
                "indptr_file": name(0), "indptr_dtype": "<i8",
                "indices_file": name(1), "indices_dtype": "<i4",
                "data_file": name(2), "data_dtype": "<i4",
            },
            "stemgen": described(header, origin),
        });
        let text = toml::to_string(&table)
            .map_err(|e| Error::invalid(crate::Setting::Output, "description", e.to_string()))?;
        let mut main = RawPart::new(&temporaries[0], path)?;
        main.put(text.as_bytes())?;
        main.end()?;
        let part = |n: usize| RawPart::new(&temporaries[n + 1], &names[n]);
        let mut parts = [part(0)?, part(1)?, part(2)?];
        parts[0].put(&0_i64.to_le_bytes())?;
        Ok(CsrWriter { parts, hit: 0 })
    }

    /// Appends rows, (row, column, ky, kx).
    pub fn counts(&mut self, rows: ArrayView4<'_, u32>) -> Result<()> {
        let [indptr, indices, values] = &mut self.parts;
        for row in rows.outer_iter() {
            for pattern in row.outer_iter() {
                for (at, count) in pattern.iter().enumerate().filter(|(_, count)| **count > 0) {
                    indices.put(&(at as i32).to_le_bytes())?;
                    values.put(&i32::try_from(*count).unwrap_or(i32::MAX).to_le_bytes())?;
                    self.hit += 1;
                }
                indptr.put(&self.hit.to_le_bytes())?;
            }
        }
        Ok(())
    }

    pub fn end(&mut self) -> Result<()> {
        self.parts.iter_mut().try_for_each(RawPart::end)
    }
}

/// Writes frames of the EMPAD.
pub(crate) struct EmpadWriter {
    frames: RawPart,
}

impl EmpadWriter {
    /// Starts the files; `temporaries` are the frames, the JSON and the XML file, at `path`.
    pub fn new(
        temporaries: &[PathBuf],
        path: &Path,
        header: &PatternHeader,
        origin: &PatternOrigin<'_>,
    ) -> Result<Self> {
        let names = PatternFormat::Empad.companions(path);
        for (n, text) in
            [empad_json(path, header, origin), empad_xml(path, header)].iter().enumerate()
        {
            let mut part = RawPart::new(&temporaries[n + 1], &names[n])?;
            part.put(text.as_bytes())?;
            part.end()?;
        }
        Ok(EmpadWriter { frames: RawPart::new(&temporaries[0], path)? })
    }

    /// Appends rows, (row, column, ky, kx).
    pub fn put<T: Copy>(
        &mut self,
        rows: ArrayView4<'_, T>,
        value: impl Fn(T) -> f32,
    ) -> Result<()> {
        for row in rows.outer_iter() {
            for pattern in row.outer_iter() {
                self.frames.put(&frame(pattern, &value))?;
            }
        }
        Ok(())
    }

    pub fn end(&mut self) -> Result<()> {
        self.frames.end()
    }
}

/// Returns a pattern upside down, with the spare rows.
fn frame<T: Copy>(pattern: ArrayView2<'_, T>, value: &impl Fn(T) -> f32) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 * EMPAD_PIXELS * (EMPAD_PIXELS + EMPAD_SPARE_ROWS));
    for row in pattern.outer_iter().rev() {
        for v in row {
            bytes.extend_from_slice(&value(*v).to_le_bytes());
        }
    }
    bytes.resize(4 * EMPAD_PIXELS * (EMPAD_PIXELS + EMPAD_SPARE_ROWS), 0);
    bytes
}

/// Describes the origin of the patterns.
fn described(header: &PatternHeader, origin: &PatternOrigin<'_>) -> serde_json::Value {
    let mut all = json!({
        "energy_kev": header.energy_kev,
        "semiangle_mrad": header.semiangle_mrad,
        "defocus_angstrom": header.defocus_angstrom,
        "thickness_angstrom": header.thickness_angstrom,
        "max_angle_mrad": header.detector.max_angle_mrad(),
        "step_angstrom": header.scan.step_angstrom,
        "origin_angstrom": header.scan.origin_angstrom,
        "engine": origin.engine,
        "coherent_tail": origin.coherent_tail,
        "command_line": origin.origin.command_line,
        "request": origin.origin.request.clone().unwrap_or_default(),
    });
    if let (Some((electrons, _)), Some(table)) = (header.counted, all.as_object_mut()) {
        table.insert("electrons_per_pattern".to_owned(), electrons.into());
    }
    all
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().display().to_string()
}

/// Returns the keys of phaser's `EmpadMetadata`: volts and metres, defocus positive for overfocus.
fn empad_json(path: &Path, header: &PatternHeader, origin: &PatternOrigin<'_>) -> String {
    let ([x, y], [rows, columns]) = (header.scan.step_angstrom, header.scan.shape);
    let metres = |angstrom: f64| 1e-10 * angstrom;
    let pixel = header.detector.pixels().map(|detector| detector.pixel_mrad());
    let all = json!({
        "file_type": "empad_metadata",
        "version": "2.0",
        "name": path.file_stem().unwrap_or_default().display().to_string(),
        "raw_filename": file_name(path),
        "voltage": 1e3 * header.energy_kev,
        "conv_angle": header.semiangle_mrad,
        "defocus": metres(-header.defocus_angstrom),
        "diff_step": pixel,
        "scan_rotation": 0.0,
        "scan_shape": [columns, rows],
        "scan_fov": [metres(x * columns as f64), metres(y * rows as f64)],
        "scan_step": [metres(x), metres(y)],
        "adu": header.counted.map(|_| 1.0),
        "notes": serde_json::to_string(&described(header, origin)).unwrap_or_default(),
    });
    format!("{all:#}\n")
}

fn empad_xml(path: &Path, header: &PatternHeader) -> String {
    let ([x, y], [rows, columns]) = (header.scan.step_angstrom, header.scan.shape);
    let escaped =
        |text: String| text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    let raw = escaped(file_name(path));
    let (width, height) = (1e-10 * x * columns as f64, 1e-10 * y * rows as f64);
    // The text is on one line: HyperSpy reads white space as the content of an element.
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\
         <root>\
         <raw_file filename=\"{raw}\"/>\
         <pix_x>{columns}</pix_x><pix_y>{rows}</pix_y>\
         <type>scan</type>\
         <timestamp isoformat=\"1970-01-01T00:00:00+00:00\" timestamp=\"0\"/>\
         <exposure_time>0</exposure_time>\
         <post_exposure_time>0</post_exposure_time>\
         <scan_parameters mode=\"acquire\">\
         <scan_resolution_x>{columns}</scan_resolution_x>\
         <scan_resolution_y>{rows}</scan_resolution_y>\
         <scan_size>1</scan_size>\
         </scan_parameters>\
         <iom_measurements>\
         <high_voltage>{voltage}</high_voltage>\
         <scan_rotation>0</scan_rotation>\
         <nominal_camera_length>0</nominal_camera_length>\
         <full_scan_field_of_view><x>{width:e}</x><y>{height:e}</y><scale_factor>1</scale_factor></full_scan_field_of_view>\
         </iom_measurements>\
         </root>\n",
        voltage = 1e3 * header.energy_kev
    )
}
