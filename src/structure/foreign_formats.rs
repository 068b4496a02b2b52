//! Recognises formats of other programs that are not read, and names the program and the conversion.

use std::path::Path;

/// Number of rows of a file that are inspected.
const FIRST_ROWS: usize = 40;

/// Returns the message for a file whose name belongs to another format.
pub(super) fn by_name(path: &Path) -> Option<String> {
    let ending = path.extension()?.to_string_lossy().to_ascii_lowercase();
    Some(match ending.as_str() {
        "pdb" | "ent" => pdb(),
        "lmp" | "lammps" | "data" => lammps_data(),
        "dump" | "lammpstrj" => lammps_dump(),
        "mrc" | "mrcs" | "ccp4" | "map" | "rec" => mrc(),
        "ser" | "emi" => ser(),
        "dm3" | "dm4" | "emd" | "tif" | "tiff" | "png" => image("an image file"),
        "xsf" | "cell" | "res" | "mol" | "mol2" | "sdf" | "gro" | "traj" | "cfg" | "json"
        | "gen" | "castep" => {
            let read = format!("read(\"FILE.{ending}\")");
            format!("a .{ending} file of another program; {}", by_ase(&read))
        }
        _ => return None,
    })
}

/// Returns the message for bytes of another format.
pub(super) fn by_bytes(bytes: &[u8]) -> Option<String> {
    if bytes.get(208..212) == Some(b"MAP ".as_slice()) {
        return Some(mrc());
    }
    let begins = |magic: &[u8]| bytes.starts_with(magic);
    if begins(&[0x49, 0x49, 0x97, 0x01]) || begins(b"JI") {
        return Some(ser());
    }
    None
}

/// Returns the message for a text of another format; `xyz` is set if the text should be XYZ.
pub(super) fn by_text(body: &str, xyz: bool) -> Option<String> {
    let rows: Vec<&str> = body.lines().take(FIRST_ROWS).collect();
    let any = |what: &dyn Fn(&str) -> bool| rows.iter().any(|row| what(row));
    if any(&|row| row.starts_with("ITEM: TIMESTEP")) {
        return Some(lammps_dump());
    }
    if any(&|row| row.contains("xlo xhi")) {
        return Some(lammps_data());
    }
    let record = |row: &str| ["CRYST1", "HETATM", "ATOM  "].iter().any(|r| row.starts_with(r));
    let begins = rows.iter().find(|row| !row.trim().is_empty());
    let head = ["HEADER", "TITLE", "REMARK", "CRYST1", "MODEL", "ATOM  ", "HETATM", "COMPND"];
    if begins.is_some_and(|row| head.iter().any(|h| row.starts_with(h))) && any(&record) {
        return Some(pdb());
    }
    if xyz { prismatic(body, &rows) } else { None }
}

/// Recognises Prismatic and computem: a comment, the cell, one row per atom (Z, x, y, z, occupancy, rms displacement), and -1.
fn prismatic(body: &str, rows: &[&str]) -> Option<String> {
    let numbers = |row: &str| -> Option<Vec<f64>> {
        row.split_whitespace().map(|word| word.parse().ok()).collect()
    };
    let (first, cell, atom) = (rows.first()?, numbers(rows.get(1)?)?, numbers(rows.get(2)?)?);
    let has_count = first.trim().parse::<usize>().is_ok();
    if has_count || cell.len() != 3 || !(5..=6).contains(&atom.len()) || atom[0].fract() != 0.0 {
        return None;
    }
    let is_atom = |row: &&str| row.split_whitespace().count() >= 5;
    let count = body.lines().skip(2).filter(is_atom).count();
    let last = if atom.len() == 6 { ":displacement:R:1" } else { "" };
    let [x, y, z] = [cell[0], cell[1], cell[2]];
    Some(format!(
        "this is the XYZ format of Prismatic and computem, not extended XYZ; replace its first two lines by `{count}` and \
         `Lattice=\"{x} 0 0 0 {y} 0 0 0 {z}\" Properties=Z:I:1:pos:R:3:occupancy:R:1{last}`, and remove the -1 at its end"
    ))
}

fn by_ase(read: &str) -> String {
    format!(
        "convert it with ASE (pip install ase): from ase.io import read, write; write(\"atoms.xyz\", {read})"
    )
}

fn pdb() -> String {
    let read = "read(\"FILE.pdb\")";
    format!("a PDB file, which is not read; {}", by_ase(read))
}

fn lammps_data() -> String {
    let read =
        "read(\"FILE.data\", format=\"lammps-data\", style=\"atomic\", Z_of_type={1: 38, 2: 8})";
    format!(
        "a data file of LAMMPS, which is not read: its types are numbers, not elements; {}",
        by_ase(read)
    )
}

fn lammps_dump() -> String {
    let read =
        "read(\"FILE.dump\", format=\"lammps-dump-text\", index=\":\", specorder=[\"Sr\", \"O\"])";
    format!(
        "a dump file of LAMMPS, which is not read: its types are numbers, not elements; {}",
        by_ase(read)
    )
}

fn mrc() -> String {
    image("an MRC file (a map or a stack of images)")
}

fn ser() -> String {
    image("a SER or EMI file (images of TIA)")
}

fn image(what: &str) -> String {
    format!(
        "{what} holds images, not atoms; a structure is a CIF, extended XYZ or POSCAR file. Recorded images become worlds by \
         `import`, from TIFF, DM3, DM4, EMD or HyperSpy files; HyperSpy converts others: \
         hyperspy.api.load(\"FILE\").save(\"image.hspy\")"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_formats_are_named() {
        for (name, what) in [
            ("a.pdb", "a PDB file"),
            ("x.lmp", "LAMMPS"),
            ("x.LAMMPSTRJ", "dump"),
            ("x.mrc", "MRC"),
            ("x.emi", "SER or EMI"),
            ("x.xsf", ".xsf file"),
        ] {
            assert!(by_name(Path::new(name)).unwrap().contains(what), "{name}");
        }
        assert_eq!(by_name(Path::new("x.cif")), None);
    }

    #[test]
    fn contents_tell_the_format() {
        let text = |body: &str| by_text(body, true);
        let dump = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n1\n";
        assert!(text(dump).unwrap().contains("dump file of LAMMPS"));
        assert!(text("LAMMPS data\n\n2 atoms\n0 4 xlo xhi\n").unwrap().contains("data file"));
        assert!(text("REMARK x\nATOM      1  N   MET A   1\n").unwrap().contains("PDB"));
        let sto = "STO\n3.9 3.9 4\n38 0 0 0 1 0.08\n22 1 1 1 1 0.08\n-1\n";
        let message = text(sto).unwrap();
        assert!(message.contains("Prismatic") && message.contains("by `2` and"), "{message}");
        assert!(message.contains("Lattice=\"3.9 0 0 0 3.9 0 0 0 4\""), "{message}");
        for other in ["1\nLattice\nSi 0 0 0\n", "data_x\nATOM 1 2\n", "", "x\ny\nz"] {
            assert_eq!(text(other), None, "{other}");
        }
        assert_eq!(by_text(sto, false), None);
        let mut map = vec![0; 1024];
        map[208..212].copy_from_slice(b"MAP ");
        assert!(by_bytes(&map).unwrap().contains("MRC"));
    }
}
