"""Runs stemgen and abTEM in turn on the same image and prints times, memory and ratios.

    pip install abtem==1.0.11
    cargo build --release
    python benches/compare_abtem.py [--rounds 3] [--threads 1] [--scan 104]

SrTiO3 [001], 31 x 31 x 39 A, PRISM f = 2, 0.05 A, 1 A slices, one configuration, HAADF 68-167 mrad. Both carry scattering to
171 mrad: abTEM on 640 x 640 pixels, stemgen on the same grid (band fraction 2/3) and on 540 x 540 pixels (0.79, as it chooses
by itself). Beside it the windowed engine, with potentials converged in the grid and scattering up to 1.2 times 200 mrad, at
two widths (errors: `cargo bench --bench accuracy`). Wall time of stemgen is that of the whole process.
"""

import argparse
import json
import os
import pathlib
import resource
import statistics
import subprocess
import sys
import tempfile
import time

here = pathlib.Path(__file__).resolve().parent
parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--rounds", type=int, default=3)
parser.add_argument("--threads", type=int, default=1)
parser.add_argument("--scan", type=int, default=104)
parser.add_argument("--cells", type=int, nargs=3, default=(8, 8, 10))
parser.add_argument("--stemgen", default=str(here.parent / "target/release/stemgen"))
args = parser.parse_args()

A = 3.905
BASIS = [("Sr", 0, 0, 0), ("Ti", .5, .5, .5), ("O", .5, .5, 0), ("O", .5, 0, .5), ("O", 0, .5, .5)]


def write_structure(path):
    """As abtem_peer.py: planes a quarter of a cell below the surface, in the middle of 1 A slices."""
    nx, ny, nz = args.cells
    shift = 0.125
    atoms = [
        (s, (i + x) * A, (j + y) * A, (k + z + shift) * A)
        for i in range(nx) for j in range(ny) for k in range(nz) for s, x, y, z in BASIS
    ]
    lattice = f"{nx * A} 0 0 0 {ny * A} 0 0 0 {nz * A}"
    lines = [str(len(atoms)), f'Lattice="{lattice}" Properties=species:S:1:pos:R:3']
    lines += [f"{s} {x:.6f} {y:.6f} {z:.6f}" for s, x, y, z in atoms]
    path.write_text("\n".join(lines) + "\n")


def run(command):
    """(wall seconds, CPU seconds, peak MB, standard output) of a process."""
    start = time.monotonic()
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen(command, stdout=out)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.monotonic() - start
        if status:
            sys.exit(f"failed: {' '.join(map(str, command))}")
        out.seek(0)
        return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, out.read()


def main():
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        structure = folder / "srtio3.xyz"
        write_structure(structure)
        ours = [
            args.stemgen, "simulate", structure, "--algorithm", "prism", "--interpolation", "2",
            "--slice-thickness", "1", "--oversampling", "1", "--detector", "HAADF=68-167",
            "--scan-points", f"{args.scan},{args.scan}", "--threads", str(args.threads),
            "--output", folder / "ours.h5", "--overwrite", "--quiet",
        ]
        pixels = 80 * args.cells[0]
        exact = ["--gpts", f"{pixels},{pixels}", "--band-fraction", str(2 / 3)]
        coarse = round(pixels * 0.84375)
        runs = {
            "abTEM": [sys.executable, here / "abtem_peer.py", "--scan", str(args.scan), "--threads", str(args.threads),
                      "--cells", *map(str, args.cells)],
            "stemgen, same grid": ours + exact,
            "stemgen, 540 x 540": ours + ["--gpts", f"{coarse},{coarse}", "--band-fraction", "0.789"],
        }
        common = ours[:3] + ours[ours.index("--scan-points"):]
        for width in ("5.9", "7.8"):
            runs[f"stemgen, window {width} A"] = common + ["--algorithm", "window", "--window", width,
                                                           "--detector", "HAADF=68-200"]
        figures = {name: [] for name in runs}
        for _ in range(args.rounds):
            for name, command in runs.items():
                wall, cpu, peak, text = run([str(c) for c in command])
                if name == "abTEM":  # without imports and warm-up
                    peer = json.loads(text.strip().splitlines()[-1])
                    wall, cpu, peak = peer["wall_s"], peer["cpu_s"], peer["peak_rss_mb"]
                figures[name].append((wall, cpu, peak))
                print(f"{name:>24}: {wall:8.2f} s wall, {cpu:8.2f} s CPU, {peak:7.0f} MB", flush=True)
        reference = figures["abTEM"]
        for name, values in figures.items():
            column = lambda rows, i: [row[i] for row in rows]
            ratios = [r[0] / v[0] for r, v in zip(reference, values)]
            cpu = [r[1] / v[1] for r, v in zip(reference, values)]
            wall = column(values, 0)
            print(f"{name:>24}: median {statistics.median(wall):.2f} s ({min(wall):.2f}-{max(wall):.2f}), "
                  f"{statistics.median(column(values, 2)):.0f} MB; abTEM takes {statistics.median(ratios):.1f} times as long "
                  f"({statistics.median(cpu):.1f} times the CPU)")


main()
