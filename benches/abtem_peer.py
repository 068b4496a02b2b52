"""Times abTEM on the specimen that the Rust benches use, so that both can be run interleaved.

    pip install abtem==1.0.11
    python benches/abtem_peer.py [--engine prism|multislice] [--interpolation 2] [--scan 104] [--threads 1] [--image FILE.npy]

SrTiO3 [001], 8 x 8 x 10 cells (31.24 x 31.24 x 39.05 A), one static configuration, 200 kV, 21 mrad, 640 x 640 pixels (0.0488 A; the
usual 0.05 A would be 625, which f = 2 does not divide and whose limit falls just short of 167 mrad), 1 A slices,
HAADF 68-167 mrad, scan over the whole cell (104 points: 0.30 A). Prints one line of JSON:
wall_s (everything after the imports and a warm-up that compiles functions), cpu_s (all threads), parts, peak_rss_mb, settings.
abTEM's defaults are kept (float32, downsample "cutoff", chunk sizes) except the number of threads.
"""

import argparse
import json
import os
import resource
import sys
import time

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--engine", choices=["prism", "multislice"], default="prism")
parser.add_argument("--interpolation", type=int, default=2, help="PRISM interpolation factor")
parser.add_argument("--scan", type=int, default=104, help="scan points per axis over the whole cell")
parser.add_argument("--points", type=int, help="take only a corner of the scan, this many points per axis, at the same step")
parser.add_argument("--threads", type=int, default=1)
parser.add_argument("--cells", type=int, nargs=3, default=(8, 8, 10), metavar=("X", "Y", "Z"))
parser.add_argument("--pixels", type=int, default=80, help="grid pixels per cell of the crystal (80: 0.0488 A)")
parser.add_argument("--slice", type=float, default=1.0, help="A")
parser.add_argument("--detector", type=float, nargs=2, default=(68.0, 167.0), metavar=("INNER", "OUTER"), help="mrad")
parser.add_argument("--image", help="save the image here, [row = y, column = x], float32 .npy")
args = parser.parse_args()

# Before numpy is imported: BLAS must not start threads of its own.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1" if variable != "OPENBLAS_NUM_THREADS" else str(args.threads)

import abtem  # noqa: E402
import dask  # noqa: E402
import numpy as np  # noqa: E402
from ase import Atoms  # noqa: E402

abtem.config.set({"diagnostics.progress_bar": False, "fftw.threads": 1, "mkl.threads": 1})
if args.threads == 1:
    dask.config.set(scheduler="single-threaded")
else:
    dask.config.set(scheduler="threads", num_workers=args.threads)

A = 3.905
# Planes at 1/8 and 5/8: in the middle of slices, with four slices to the cell (abTEM rounds 1 A to 0.976 A).
sites = [(0, 0, 0.125), (0.5, 0.5, 0.625), (0.5, 0.5, 0.125), (0.5, 0, 0.625), (0, 0.5, 0.625)]
unit = Atoms("SrTiO3", scaled_positions=sites, cell=[A] * 3, pbc=True)


def simulate(atoms, scan_points, points, parts):
    """The image; parts, if given, receives the seconds that building and reducing the S-matrix took."""
    extent = atoms.cell.lengths()[:2]
    step = extent / scan_points
    gpts = tuple(int(round(e / A)) * args.pixels for e in extent)
    potential = abtem.Potential(atoms, gpts=gpts, slice_thickness=args.slice, projection="infinite")
    # Built once: given lazily, abTEM would make it anew for every batch of waves.
    begin = time.perf_counter()
    potential = potential.build().compute()
    parts["potential_s"] = time.perf_counter() - begin
    scan = abtem.GridScan(start=(0, 0), end=tuple(step * points), gpts=(points, points), endpoint=False)
    detector = abtem.AnnularDetector(*args.detector)
    if args.engine == "multislice":
        probe = abtem.Probe(energy=200e3, semiangle_cutoff=21)
        image = probe.scan(potential, scan=scan, detectors=detector).compute()
    else:
        s = abtem.SMatrix(potential=potential, energy=200e3, semiangle_cutoff=21, interpolation=args.interpolation)
        begin = time.perf_counter()
        matrix = s.build().compute()
        parts["s_matrix_s"] = time.perf_counter() - begin
        begin = time.perf_counter()
        image = matrix.reduce(scan=scan, detectors=detector)
        image = image.compute() if hasattr(image, "compute") else image
        parts["reduction_s"] = time.perf_counter() - begin
        parts["beams"] = len(s)
        parts["s_matrix_gpts"] = list(map(int, s.downsampled_gpts))
    parts["gpts"] = list(map(int, potential.gpts))
    parts["slices"] = len(potential)
    return image.array


simulate(unit * (args.interpolation * 2, args.interpolation * 2, 1), 4, 2, {})
points = args.points or args.scan
parts = {}
begin, cpu = time.perf_counter(), time.process_time()
image = simulate(unit * tuple(args.cells), args.scan, points, parts)
wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
if args.image:
    np.save(args.image, np.ascontiguousarray(image.T, dtype=np.float32))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024**2 if sys.platform == "darwin" else 1024)
print(
    json.dumps(
        {
            "wall_s": round(wall, 3),
            "cpu_s": round(cpu, 3),
            **{k: round(v, 3) if isinstance(v, float) else v for k, v in parts.items()},
            "probes": points * points,
            "peak_rss_mb": round(peak, 1),
            "mean": float(image.mean()),
            "settings": {**vars(args), "abtem": abtem.__version__},
        }
    )
)
