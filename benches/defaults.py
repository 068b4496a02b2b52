"""Holds the plain command against what an expert would type: processor time, and the error against the exact engine.

    cargo build --release -p stemgen-cli
    python benches/defaults.py [--program target/release/stemgen] [--full] [CASE ...]

Needs NumPy and h5py. Each case is simulated three times: by the plain command, by the best command known, and by the exact engine of a
specimen without end (where that takes too long: wide windows, thin slices). It prints the processor seconds of the first two, and the rms
difference of each from the third, of the worst image, in per cent of its mean. Without --full, fewer phonons are taken. The aims: at most
1.5 times the time of the best command, and an error within 0.5 %.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
#: Of a specimen without end, each probe by itself.
EXACT = ["--engine", "multislice", "--probe-box", "large"]
FOUR = ["BF=0-20", "ABF=12-24", "MAADF=40-80", "HAADF=80-200"]


@dataclass(frozen=True)
class Case:
    """Options of all commands, of the best one, and of the exact one; a structure of the repository, or atoms."""

    structure: str | Callable[[], tuple[list[str], np.ndarray, np.ndarray]]
    options: list[str]
    best: list[str]
    exact: list[str]
    phonons: int = 0


def graphene_with_silicon() -> tuple[list[str], np.ndarray, np.ndarray]:
    a = 2.46
    cell = np.array([a, a * 3**0.5, 10.0])
    motif = np.array([[0, 0, 5], [a / 2, a * 3**0.5 / 2, 5], [0, a / 3**0.5, 5], [a / 2, a * 3**0.5 / 2 + a / 3**0.5, 5]])
    return with_middle(motif, ["C"] * 4, cell, (12, 7), "C", "Si")


def disulphide_with_vacancy() -> tuple[list[str], np.ndarray, np.ndarray]:
    a, half = 3.16, 1.595
    cell = np.array([a, a * 3**0.5, 10.0])
    third = a / 3**0.5
    motif = [[0, third / 2, 5], [0, 3 * third / 2, 5 - half], [0, 3 * third / 2, 5 + half]]
    motif += [[x + a / 2, y + 3 * third / 2, z] for x, y, z in motif]
    return with_middle(np.array(motif), ["Mo", "S", "S"] * 2, cell, (9, 5), "S", None)


def with_middle(
    motif: np.ndarray, symbols: list[str], cell: np.ndarray, times: tuple[int, int], near: str, becomes: str | None
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """A sheet, with one atom near its middle replaced or taken out."""
    shifts = [np.array([i * cell[0], j * cell[1], 0]) for i in range(times[0]) for j in range(times[1])]
    positions = np.concatenate([motif + shift for shift in shifts])
    names = symbols * len(shifts)
    box = cell * [*times, 1]
    distance = np.linalg.norm(positions[:, :2] - box[:2] / 2, axis=1)
    distance[[name != near for name in names]] = np.inf
    at = int(np.argmin(distance))
    if becomes is None:
        del names[at]
        return names, np.delete(positions, at, axis=0), box
    names[at] = becomes
    return names, positions, box


def fcc_sphere(a: float, atoms: int) -> np.ndarray:
    """The atoms nearest to the middle of a face-centred cubic crystal, about it."""
    basis = np.array([[0, 0, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0]])
    n = range(-5, 6)
    all_ = a * np.concatenate([basis + [i, j, k] for i in n for j in n for k in n])
    return all_[np.argsort(np.linalg.norm(all_, axis=1), kind="stable")[:atoms]]


def gold_on_carbon() -> tuple[list[str], np.ndarray, np.ndarray]:
    edge, film = 60.0, 30.0
    rng = np.random.default_rng(1)
    carbon = np.empty((0, 3))
    while len(carbon) < int(0.1 * edge * edge * film):
        given = rng.uniform([0, 0, 0], [edge, edge, film], (2000, 3))
        for one in given:
            apart = carbon - one
            apart[:, :2] -= edge * np.round(apart[:, :2] / edge)
            if len(carbon) == 0 or np.min(np.sum(apart**2, axis=1)) > 1.3**2:
                carbon = np.vstack([carbon, one])
    carbon = carbon[: int(0.1 * edge * edge * film)]
    gold = fcc_sphere(4.078, 405)
    gold += [edge / 2, edge / 2, film + 1.5 - gold[:, 2].min()]
    box = np.array([edge, edge, gold[:, 2].max() + 1.0])
    return ["C"] * len(carbon) + ["Au"] * len(gold), np.vstack([carbon, gold]), box


def tilted_platinum() -> tuple[list[str], np.ndarray, np.ndarray]:
    atoms = fcc_sphere(3.924, 400)
    for axis, angle in ((0, 0.11), (1, 0.06)):
        u, v = [k for k in range(3) if k != axis]
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        atoms[:, [u, v]] = atoms[:, [u, v]] @ turned.T
    box = np.array([36.0, 36.0, 28.0])
    return ["Pt"] * len(atoms), atoms + box / 2, box


def detectors(*given: str) -> list[str]:
    return [part for one in given for part in ("--detector", one)]


CASES: dict[str, Case] = {
    "graphene": Case(
        graphene_with_silicon,
        ["--energy", "60", "--semiangle", "30", "--sigma", "0.06", "--scan-step", "0.2", "--scan-start", "8,8", "--scan-end", "22,22", *detectors(*FOUR)],
        [*EXACT, "--probe-step", "0.33"],
        [*EXACT, "--probe-step", "0.3"],
        8,
    ),
    "mos2": Case(
        disulphide_with_vacancy,
        ["--energy", "80", "--semiangle", "25", "--sigma", "0.07", "--scan-step", "0.2", "--scan-start", "8,8", "--scan-end", "20,20", *detectors(*FOUR)],
        [*EXACT, "--probe-step", "0.34"],
        [*EXACT, "--probe-step", "0.3"],
        8,
    ),
    "gold": Case(
        gold_on_carbon,
        ["--scan-start", "36,24", "--scan-end", "48,36", "--scan-step", "0.2", "--defocus", "0,50,100"],
        ["--window", "15.6"],
        ["--window", "32", "--expansion", "off", "--probe-step", "0.28"],
    ),
    "silicon": Case(
        "si.cif --zone 1,1,0 --repeat 3,4,13",
        ["--scan-end", "7.68,5.43"],
        ["--window", "11.7"],
        [*EXACT, "--probe-step", "scan"],
    ),
    "srtio3": Case(
        "srtio3.cif --repeat 8,8,26",
        ["--scan-end", "7.81,7.81", "--scan-step", "0.2", "--sigma", "0.08"],
        ["--window", "11.7"],
        [*EXACT, "--probe-step", "0.28"],
        4,
    ),
    "gaas": Case(
        "gaas.cif --zone 1,1,0 --repeat 5,7,25",
        ["--scan-end", "11.3,7.99", "--scan-step", "0.2"],
        ["--window", "23.4"],
        [*EXACT, "--probe-step", "0.28"],
    ),
    "platinum": Case(
        tilted_platinum,
        ["--scan-start", "24,14", "--scan-end", "34,24", "--scan-step", "0.2"],
        ["--window", "11.7"],
        # Its atoms form no planes: the slices of the exact engine are too thick for them, and these are thin.
        ["--window", "15.6", "--expansion", "off", "--slice-thickness", "0.1", "--probe-step", "0.28"],
    ),
    "thick": Case(
        "si.cif --zone 1,1,0 --repeat 8,11,52",
        ["--scan-end", "7.68,5.43", "--scan-step", "0.2", "--sigma", "0.076"],
        ["--window", "23.4"],
        [*EXACT, "--probe-step", "0.28"],
        2,
    ),
}


def write(folder: Path, name: str, case: Case) -> list[str]:
    """The structure as the command line takes it."""
    if isinstance(case.structure, str):
        file, *options = case.structure.split()
        return [str(ROOT / "structures" / file), *options]
    symbols, positions, box = case.structure()
    path = folder / f"{name}.xyz"
    lattice = " ".join(str(v) for v in np.diag(box).ravel())
    lines = [f"{s} {x:.6f} {y:.6f} {z:.6f}" for s, (x, y, z) in zip(symbols, positions, strict=True)]
    path.write_text("\n".join([str(len(symbols)), f'Lattice="{lattice}" Properties=species:S:1:pos:R:3', *lines]) + "\n")
    return [str(path)]


def run(program: str, out: Path, arguments: list[str]) -> tuple[float, dict[str, np.ndarray], str]:
    """Processor seconds, images, and what was chosen."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [program, "simulate", *arguments, "-o", str(out), "--overwrite", "--quiet", "--json"]
    report = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    with h5py.File(out) as file:
        images = {name: file["images"][name][()].astype(float) for name in file["images"]}
    accuracy = report.get("accuracy")
    one = accuracy[0] if isinstance(accuracy, list) else accuracy
    told = ""
    if one:
        tried = one["tried"][-1] if one["tried"] else None
        told = one["algorithm"]["name"] + (f", told {tried['found_percent']:.2f} %" if tried else "")
        told += "".join(f" {k}={v:.1f}" for k, v in one["algorithm"].items() if isinstance(v, float))
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, images, told


def error_percent(images: dict[str, np.ndarray], exact: dict[str, np.ndarray]) -> dict[str, float]:
    return {n: 100 * float(np.sqrt(np.mean((images[n] - e) ** 2)) / np.mean(e)) for n, e in exact.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default=str(ROOT / "target/release/stemgen"))
    parser.add_argument("--full", action="store_true")
    parser.add_argument("case", nargs="*", default=list(CASES))
    given = parser.parse_args()
    missed = 0
    for name in given.case:
        case = CASES[name]
        with tempfile.TemporaryDirectory() as folder:
            structure = write(Path(folder), name, case)
            options = list(case.options)
            if case.phonons:
                options += ["--phonons", str(case.phonons if given.full else min(2, case.phonons))]
            out = Path(folder) / "out.h5"
            exact_s, exact, _ = run(given.program, out, [*structure, *options, *case.exact])
            best_s, best, _ = run(given.program, out, [*structure, *options, *case.best])
            plain_s, plain, told = run(given.program, out, [*structure, *options])
        ours, theirs = error_percent(plain, exact), error_percent(best, exact)
        met = plain_s <= 1.5 * best_s and max(ours.values()) <= 0.5
        missed += not met
        print(f"{name}: plain {plain_s:.1f} s ({told}), best known {best_s:.1f} s, exact {exact_s:.1f} s: {'met' if met else 'MISSED'}")
        for image in exact:
            print(f"    {image}: plain {ours[image]:.3f} %, best known {theirs[image]:.3f} %", flush=True)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
