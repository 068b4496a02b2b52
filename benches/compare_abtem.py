"""Time, memory and error of stemgen and abTEM on the same images.

    pip install abtem==1.0.11 h5py
    cargo build --release
    python benches/compare_abtem.py                                    # SrTiO3 of 39 A; about 15 minutes
    python benches/compare_abtem.py --case srtio3-98 --runs window-7.8,prism2-0.05 --rounds 3 --threads 2
    python benches/compare_abtem.py --results results.jsonl --report   # the table of what was measured before

A case is a crystal whose atoms are displaced once (two codes, the same atoms); every run makes its whole HAADF image
68-167 mrad with probes at the Nyquist distance of the image. Errors are taken over one cell of the crystal in the middle, against
stemgen's plain multislice on the full grid with all scattering to 250 mrad, which agrees within 0.08 % with abTEM refined in the grid
until it no longer changes (tests/physics/golden.rs): rms difference and mean difference, both divided by the mean.

Runs of abTEM: prismF-S is PRISM with interpolation F on pixels of at most S Angstrom, multislice-S plain multislice. All have slices
of one atomic plane, as ours have; -thin: 1 A slices, as published images have. Plain multislice and PRISM with F = 1 are timed on the
probes of the one cell; the time for the image is the time of these times the number of cells, plus that of potentials and plane waves.
abTEM starts to time after imports and warm-up; stemgen's time is that of its process, start and file included. Runs go in turn, round
by round.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import h5py
import numpy as np

here = pathlib.Path(__file__).resolve().parent
SIGMA = {"Sr": 0.084, "Ti": 0.060, "O": 0.085, "Ga": 0.090, "As": 0.085}
SRTIO3 = [("Sr", 0, 0, 0.25), ("O", 0.5, 0.5, 0.25), ("Ti", 0.5, 0.5, 0.75), ("O", 0, 0.5, 0.75), ("O", 0.5, 0, 0.75)]
# zinc blende along [110]: x along [001], y along [1-10]
GAAS = [("Ga", 0, 0, 0.25), ("Ga", 0.5, 0.5, 0.75), ("As", 0.25, 0.5, 0.25), ("As", 0.75, 0, 0.75)]


class Case:
    def __init__(self, basis, cell, cells, probes):
        self.basis, self.cell, self.cells, self.probes = basis, cell, cells, probes
        self.size = np.multiply(cell, cells)
        self.scan = [cells[i] * probes[i] for i in (0, 1)]
        # the cell in the middle
        self.part = [probes[i] * (cells[i] // 2) for i in (0, 1)] + list(probes)

    def gpts(self, sampling):
        return [int(np.ceil(self.size[i] / sampling / 16 - 1e-6)) * 16 for i in (0, 1)]

    def write(self, path, seed=None):
        """The crystal; displaced if there is a seed, wrapped into the cell along x and y."""
        random = np.random.default_rng(seed)
        lines = []
        for index in np.ndindex(*self.cells):
            for symbol, *fraction in self.basis:
                r = np.add(index, fraction) * self.cell
                if seed is not None:
                    r += random.normal(0, SIGMA[symbol], 3)
                    r[:2] %= self.size[:2]
                lines.append(f"{symbol} {r[0]:.6f} {r[1]:.6f} {r[2]:.6f}")
        x, y, z = self.size
        head = f'{len(lines)}\nLattice="{x} 0 0 0 {y} 0 0 0 {z}" Properties=species:S:1:pos:R:3\n'
        path.write_text(head + "\n".join(lines) + "\n")
        return path


A = 3.905
D = 5.6533
CASES = {
    "srtio3-39": Case(SRTIO3, (A, A, A), (8, 8, 10), (13, 13)),
    "srtio3-98": Case(SRTIO3, (A, A, A), (8, 8, 25), (13, 13)),
    "gaas-100": Case(GAAS, (D, D / 2**0.5, D / 2**0.5), (6, 8, 25), (19, 14)),
}
DEFAULT_RUNS = "window-5.9,window-7.8,window-11.7,prism2,multislice,prism2-0.05,multislice-0.05,multislice-0.02"


class Bench:
    def __init__(self, args, folder):
        self.args, self.folder, self.case = args, folder, CASES[args.case]
        seeds = range(1, args.configurations + 1)
        self.displaced = [self.case.write(folder / f"displaced{seed}.xyz", seed) for seed in seeds]
        self.ideal = self.case.write(folder / "ideal.xyz")
        self.reference = None

    def plane(self):
        return self.case.cell[2] / 2

    def stemgen(self, structure, options, part=False):
        """(figures, image [y, x])"""
        case, out = self.case, self.folder / "ours.h5"
        x, y, columns, rows = case.part if part else [0, 0, *case.scan]
        step = case.size[:2] / case.scan
        command = [
            self.args.stemgen, "simulate", structure, "--detector", "HAADF=68-167", "--threads", self.args.threads,
            f"--scan-start={x * step[0]},{y * step[1]}", f"--scan-end={(x + columns) * step[0]},{(y + rows) * step[1]}",
            "--scan-points", f"{columns},{rows}", "--output", out, "--overwrite", "--quiet", *options,
        ]
        figures, _ = run(command)
        with h5py.File(out) as file:
            return figures, file["images/HAADF"][-1]

    def ours(self, name):
        kind, _, value = name.partition("-")
        # abTEM's probe has norm 1 in the cell
        options = {"window": ["--window", value, "--probe-box", "cell"], "multislice": ["--engine", "multislice"],
                   "prism2": ["--engine", "prism", "--interpolation", "2"]}[kind]
        phonons = self.args.configurations
        structure = self.displaced[0]
        if phonons > 1:
            structure = self.ideal
            sigma = ",".join(f"{s}={SIGMA[s]}" for s in sorted({b[0] for b in self.case.basis}))
            options += ["--phonons", phonons, "--sigma", sigma]
        part = kind == "multislice"
        figures, image = self.stemgen(structure, options, part)
        if part:
            figures = self.whole_image(figures)
        return figures, image if phonons == 1 else None

    def abtem(self, name):
        engine, sampling, *thin = name.split("-")
        gpts = ",".join(map(str, self.case.gpts(float(sampling))))
        command = [
            sys.executable, here / "abtem_peer.py", *self.displaced, "--gpts", gpts, "--scan", ",".join(map(str, self.case.scan)),
            "--slice", 1.0 if thin else self.plane(), "--threads", self.args.threads, "--fft", self.args.fft,
            "--image", self.folder / "abtem.npy",
        ]
        part = engine in ("multislice", "prism1")
        if part:
            command += ["--part", ",".join(map(str, self.case.part))]
        if engine == "multislice":
            command += ["--engine", "multislice"]
        else:
            command += ["--interpolation", engine.removeprefix("prism")]
        _, text = run(command)
        told = json.loads(text.strip().splitlines()[-1])
        figures = {"wall_s": told["wall_s"], "cpu_s": told["cpu_s"], "mb": told["peak_rss_mb"], "parts_s": told["parts_s"]}
        if part:
            parts = told["parts_s"]
            figures = self.whole_image(figures, parts["potential"] + parts.get("s_matrix", 0.0))
        return figures, np.load(self.folder / "abtem.npy") if self.args.configurations == 1 else None

    def whole_image(self, figures, once_s=0.0):
        """`once_s`: wall time of what the image takes once; as much of the CPU time."""
        cells = self.case.cells[0] * self.case.cells[1]
        once = {k: once_s / figures["wall_s"] * figures[k] for k in ("wall_s", "cpu_s")}
        times = {k: once[k] + (figures[k] - once[k]) * cells for k in once}
        return {**figures, **times, "extrapolated": True}

    def errors(self, image):
        if self.reference is None:
            exact = ["--engine", "multislice", "--angle-margin", "1.5"]
            self.reference = self.stemgen(self.displaced[0], exact, part=True)[1]
        x, y, columns, rows = self.case.part
        if image.shape != (rows, columns):
            image = image[y : y + rows, x : x + columns]
        difference, mean = image - self.reference, self.reference.mean()
        bright = self.reference > 0.5 * self.reference.max()
        return {
            "rms_percent": 100 * float(np.sqrt((difference**2).mean()) / mean),
            "mean_percent": 100 * float(difference.mean() / mean),
            "bright_percent": 100 * float(difference[bright].sum() / self.reference[bright].sum()),
        }

    def one(self, name):
        ours = name.partition("-")[0] == "window" or name in ("prism2", "multislice")
        figures, image = self.ours(name) if ours else self.abtem(name)
        errors = {} if image is None else self.errors(image)
        keys = {"case": self.args.case, "threads": self.args.threads, "configurations": self.args.configurations}
        return {**keys, "code": "stemgen" if ours else f"abTEM ({self.args.fft})", "run": name, **figures, **errors}


def run(command):
    start = time.monotonic()
    with tempfile.TemporaryFile("w+") as out:
        process = subprocess.Popen([str(c) for c in command], stdout=out)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.monotonic() - start
        if status:
            sys.exit(f"failed: {' '.join(map(str, command))}")
        out.seek(0)
        cpu = usage.ru_utime + usage.ru_stime
        return {"wall_s": wall, "cpu_s": cpu, "mb": usage.ru_maxrss / 1024}, out.read()


def report(rows):
    groups = {}
    for row in rows:
        key = (row["case"], row["configurations"], row["threads"])
        groups.setdefault(key, {}).setdefault((row["code"], row["run"]), []).append(row)
    median = lambda rows, key: statistics.median(r[key] for r in rows)
    for (case, configurations, threads), runs in groups.items():
        print(f"\n{case}, {configurations} configuration(s), {threads} thread(s)")
        print(f"{'':>32} {'wall s':>9} {'from - to':>17} {'CPU s':>9} {'MB':>6}   {'rms':>6} {'mean':>7} {'bright':>7} %")
        for (code, name), rows in runs.items():
            wall = [r["wall_s"] for r in rows]
            spread = f"{min(wall):.1f} - {max(wall):.1f}" if len(wall) > 1 else ""
            errors = ""
            if "rms_percent" in rows[0]:
                errors = "{rms_percent:6.2f} {mean_percent:+7.2f} {bright_percent:+7.2f}".format(**rows[0])
            note = "  (from one cell)" if rows[0].get("extrapolated") else ""
            print(f"{code + ' ' + name:>32} {median(rows, 'wall_s'):9.1f} {spread:>17} {median(rows, 'cpu_s'):9.1f} "
                  f"{median(rows, 'mb'):6.0f}   {errors}{note}")
        ours = {n: r for (c, n), r in runs.items() if c == "stemgen"}
        for (code, name), rows in runs.items():
            if code != "stemgen":
                ratios = ", ".join(f"{n} {median(rows, 'cpu_s') / median(r, 'cpu_s'):.1f}" for n, r in ours.items())
                print(f"  CPU time of {code} {name} over ours: {ratios}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=CASES, default="srtio3-39")
    parser.add_argument("--runs", default=DEFAULT_RUNS, help="comma-separated; window-WIDTH, prism2 and multislice are stemgen's")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--configurations", type=int, default=1, help="phonon configurations; errors are told for one only")
    parser.add_argument("--fft", choices=["fftw", "mkl"], default="fftw", help="abTEM's transforms; mkl needs pip install mkl_fft")
    parser.add_argument("--stemgen", default=str(here.parent / "target/release/stemgen"))
    parser.add_argument("--results", type=pathlib.Path, help="append every run to this file (JSON lines)")
    parser.add_argument("--report", action="store_true", help="run nothing")
    args = parser.parse_args()
    rows = []
    if not args.report:
        with tempfile.TemporaryDirectory() as folder:
            bench = Bench(args, pathlib.Path(folder))
            for _ in range(args.rounds):
                for name in args.runs.split(","):
                    row = bench.one(name)
                    rows.append(row)
                    print(json.dumps(row), flush=True)
                    if args.results:
                        with args.results.open("a") as file:
                            file.write(json.dumps(row) + "\n")
    if args.results and args.results.exists():
        rows = [json.loads(line) for line in args.results.read_text().splitlines()]
    report(rows)


if __name__ == "__main__":
    main()
