"""Compares compositions as stemgen reads them with those of gemmi and pymatgen, over a folder of CIF and POSCAR files.

    pip install gemmi pymatgen
    cargo build --release
    python tests/structures/compare_readers.py FOLDER [--stemgen target/release/stemgen] [--all]

Run by hand; no other test needs it. Atoms of each element are counted per volume, so that orthogonal supercells of oblique cells
compare too, and mixed sites are drawn in 4 x 4 x 4 boxes. Prints one line for each file that differs or is refused (--all: for each
file), and a table of how many there are.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import warnings
from collections import Counter
from pathlib import Path

#: Densities that differ by less than this share are one; mixed sites are drawn, so theirs scatter.
SAME, SAME_MIXED = 0.01, 0.08
CIF, POSCAR = (".cif", ".mcif"), (".vasp", ".poscar", ".contcar")

Density = dict[str, float]


class Refused(Exception):
    """A reader does not take a file; the text says why."""


def by_stemgen(program: str, path: Path) -> tuple[Density, list[str]]:
    """Atoms per cubic Angstrom by element, and what the program says of the file."""
    failure = ""
    for more in ([], ["--zone", "0,0,1"], ["--zone", "0,0,1", "--max-strain", "2"]):
        command = [program, "simulate", str(path), "--dry-run", "--json", "--scan-points", "2,2", "--repeat", "4,4,4", *more]
        run = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        if run.returncode == 0:
            plan = json.loads(run.stdout)
            x, y, z = plan["box_angstrom"]
            return {symbol: count / (x * y * z) for symbol, count in plan["composition"].items()}, plan["warnings"]
        failure = run.stderr.strip().splitlines()[0].removeprefix("error: ") if run.stderr.strip() else "no message"
        if run.returncode < 0 or "panicked" in run.stderr:
            raise SystemExit(f"{path}: the program crashed: {run.stderr}")
    raise Refused(failure)


def by_gemmi(path: Path) -> tuple[Density, bool]:
    """Atoms per cubic Angstrom by element, and whether there are mixed sites."""
    import gemmi

    if path.suffix.lower() not in CIF:
        raise Refused("gemmi reads no POSCAR")
    try:
        blocks = [gemmi.make_small_structure_from_block(block) for block in gemmi.cif.read(str(path))]
    except Exception as fault:
        raise Refused(str(fault)) from fault
    filled = [block for block in blocks if block.sites]
    if len(filled) != 1:
        raise Refused(f"{len(filled)} data blocks with atoms")
    structure = filled[0]
    counts: Counter[str] = Counter()
    for site in structure.get_all_unit_cell_sites():
        counts["H" if site.element.name == "D" else site.element.name] += site.occ
    mixed = any(site.occ < 1 for site in structure.sites)
    return {symbol: count / structure.cell.volume for symbol, count in counts.items()}, mixed


def by_pymatgen(path: Path) -> tuple[Density, bool]:
    """Atoms per cubic Angstrom by element, and whether there are mixed sites."""
    from pymatgen.core import Structure
    from pymatgen.io.cif import CifParser

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if path.suffix.lower() in CIF:
                structure = CifParser(str(path)).parse_structures(primitive=False)[0]
            else:
                structure = Structure.from_file(str(path))
    except Exception as fault:
        raise Refused(str(fault).splitlines()[0] if str(fault) else type(fault).__name__) from fault
    counts: Counter[str] = Counter()
    for site in structure:
        for species, share in site.species.items():
            counts["H" if species.symbol == "D" else species.symbol] += share
    return {symbol: count / structure.volume for symbol, count in counts.items()}, not structure.is_ordered


def verdict(ours: Density, theirs: Density, mixed: bool) -> str:
    """Empty where both agree; else which elements differ, as ratios."""
    allowed = SAME_MIXED if mixed else SAME
    differing = []
    for symbol in sorted(ours.keys() | theirs.keys()):
        here, there = ours.get(symbol, 0.0), theirs.get(symbol, 0.0)
        if abs(here - there) > allowed * max(here, there):
            differing.append(f"{symbol} {here / there:.3f}" if there else f"{symbol} only here")
    return ", ".join(differing)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--stemgen", default="target/release/stemgen", help="the program")
    parser.add_argument("--all", action="store_true", help="also files that agree")
    asked = parser.parse_args()
    readers = {"gemmi": by_gemmi, "pymatgen": by_pymatgen}
    totals: Counter[tuple[str, str]] = Counter()
    named = lambda path: path.name.upper().startswith(("POSCAR", "CONTCAR"))  # noqa: E731
    files = [p for p in sorted(asked.folder.rglob("*")) if p.is_file() and (p.suffix.lower() in CIF + POSCAR or named(p))]
    for path in files:
        try:
            ours, said = by_stemgen(asked.stemgen, path)
        except Refused as fault:
            ours, said = None, [f"refused: {fault}"]
        told, agreed = [], True
        for name, read in readers.items():
            try:
                theirs, mixed = read(path)
            except Refused as fault:
                outcome = "both refuse" if ours is None else "only here"
                told.append(f"{name} refuses ({fault})")
            except ImportError:
                continue
            else:
                differing = "" if ours is None else verdict(ours, theirs, mixed)
                outcome = "refused here" if ours is None else "differs" if differing else "agrees"
                agreed &= outcome == "agrees"
                told.append(f"{name} {differing or outcome}")
            totals[name, outcome] += 1
        if asked.all or not agreed:
            about = [note for note in said if any(word in note for word in ("refused", "formula", "multiplicity", "hydrogen", "sites"))]
            print(f"{path.relative_to(asked.folder)}: {'; '.join(told + about)}")
    print(f"\n{len(files)} files")
    outcomes = ["agrees", "differs", "refused here", "only here", "both refuse"]
    print(f"{'':10}" + "".join(f"{outcome:>14}" for outcome in outcomes))
    for name in readers:
        print(f"{name:10}" + "".join(f"{totals[name, outcome]:>14}" for outcome in outcomes))


if __name__ == "__main__":
    main()
