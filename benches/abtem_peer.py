"""Times abTEM on structures that stemgen reads too; compare_abtem.py calls it.

    pip install abtem==1.0.11
    python benches/abtem_peer.py a.xyz [b.xyz ...] --gpts 640,640 --scan 104,104 [--engine prism|multislice] ...

Each file (extended XYZ, orthogonal cell, beam along z) is one phonon configuration; images are averaged. 200 kV, 21 mrad,
infinite projection. Prints one line of JSON: wall_s (everything after imports, reading and a warm-up that compiles functions
and plans transforms), cpu_s (all threads), parts_s, peak_rss_mb. abTEM's defaults are kept (float32, downsample "cutoff",
chunk sizes) except the number of threads and, with --fft mkl, the library of its Fourier transforms. Potentials are built
once for each configuration: given lazily, abTEM would make them anew for every batch of waves.
"""

import argparse
import json
import os
import resource
import sys
import time


def pair(kind):
    return lambda text: tuple(kind(v) for v in text.split(","))


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("structures", nargs="+")
parser.add_argument("--gpts", type=pair(int), required=True, metavar="NX,NY")
parser.add_argument("--scan", type=pair(int), required=True, metavar="NX,NY", help="probes over the whole cell")
parser.add_argument("--part", type=pair(int), metavar="X,Y,NX,NY", help="only these probes: first column and row, and how many")
parser.add_argument("--engine", choices=["prism", "multislice"], default="prism")
parser.add_argument("--interpolation", type=int, default=2, help="PRISM interpolation factor")
parser.add_argument("--slice", type=float, default=1.0, help="A")
parser.add_argument("--detector", type=pair(float), default=(68.0, 167.0), metavar="INNER,OUTER", help="mrad")
parser.add_argument("--threads", type=int, default=1)
parser.add_argument("--fft", choices=["fftw", "mkl"], default="fftw")
parser.add_argument("--image", help="save the mean image here, [row = y, column = x], float32 .npy")
args = parser.parse_args()

# Before numpy is imported: BLAS must not start threads of its own.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[variable] = "1" if variable != "OPENBLAS_NUM_THREADS" else str(args.threads)

import abtem  # noqa: E402
import ase.io  # noqa: E402
import dask  # noqa: E402
import numpy as np  # noqa: E402

abtem.config.set({"diagnostics.progress_bar": False, "fftw.threads": 1, "mkl.threads": 1, "fft": args.fft})
if args.threads == 1:
    dask.config.set(scheduler="single-threaded")
else:
    dask.config.set(scheduler="threads", num_workers=args.threads)

if args.fft == "mkl":
    import mkl_fft

    def transform(function):
        """abTEM 1.0.11 passes `overwrite_x`, which mkl_fft 2 replaced by `out`."""
        return lambda x, overwrite_x=False, **rest: function(x, out=x if overwrite_x else None, **rest)

    for name in ("fft2", "ifft2", "fftn", "ifftn"):
        setattr(mkl_fft, name, transform(getattr(mkl_fft, name)))


def computed(lazy):
    return lazy.compute() if hasattr(lazy, "compute") else lazy


def simulate(atoms, interpolation, part, parts):
    """Image [x, y] of one configuration; `parts` gathers seconds."""
    clock = time.perf_counter
    lap = clock()

    def stop(name):
        nonlocal lap
        parts[name] = parts.get(name, 0.0) + clock() - lap
        lap = clock()

    step = atoms.cell.lengths()[:2] / args.scan
    first, count = np.array(part[:2]), np.array(part[2:])
    scan = abtem.GridScan(start=tuple(step * first), end=tuple(step * (first + count)), gpts=tuple(part[2:]), endpoint=False)
    detector = abtem.AnnularDetector(*args.detector)
    potential = abtem.Potential(atoms, gpts=args.gpts, slice_thickness=args.slice, projection="infinite")
    potential = potential.build().compute()
    stop("potential")
    if args.engine == "multislice":
        probe = abtem.Probe(energy=200e3, semiangle_cutoff=21)
        image = computed(probe.scan(potential, scan=scan, detectors=detector))
        stop("probes")
        return image.array
    s = abtem.SMatrix(potential=potential, energy=200e3, semiangle_cutoff=21, interpolation=interpolation)
    matrix = s.build().compute()
    stop("s_matrix")
    image = computed(matrix.reduce(scan=scan, detectors=detector))
    stop("reduction")
    parts["beams"] = len(s)
    return image.array


configurations = [ase.io.read(path) for path in args.structures]
part = args.part or (0, 0, *args.scan)
# Few atoms, beams and probes, on the grid that is timed.
simulate(configurations[0][:4], 8, (0, 0, 2, 2), {})
parts = {}
begin, cpu = time.perf_counter(), time.process_time()
image = np.mean([simulate(atoms, args.interpolation, part, parts) for atoms in configurations], axis=0)
wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
if args.image:
    np.save(args.image, np.ascontiguousarray(image.T, dtype=np.float32))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024**2 if sys.platform == "darwin" else 1024)
rounded = {k: round(v, 3) if isinstance(v, float) else v for k, v in parts.items()}
print(json.dumps({"wall_s": round(wall, 3), "cpu_s": round(cpu, 3), "parts_s": rounded, "peak_rss_mb": round(peak, 1)}))
