"""Speed of our transforms and propagation loop beside Intel MKL's transforms, interleaved.

    pip install mkl_fft numpy
    python benches/compare_mkl.py [--rounds 5] [--threads 1] [SIZE ...]

Complex single precision, forward and inverse of one wave after the other, in place, nominal GFLOP/s (5 N log2 N a
transform). Each round runs `cargo bench --bench propagation` and MKL for one size; the table gives medians, and the
spread of the ratio over rounds.
"""
import argparse
import os
import statistics
import subprocess
import sys
import time

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("sizes", nargs="*", type=int, default=[120, 160, 192, 256, 320, 512, 768])
parser.add_argument("--rounds", type=int, default=5)
parser.add_argument("--threads", type=int, default=1, choices=[1, 2])
args = parser.parse_args()
os.environ["MKL_NUM_THREADS"] = str(args.threads)
try:
    import mkl_fft
    import numpy as np
except ImportError:
    sys.exit("error: mkl_fft and numpy are missing; pip install mkl_fft numpy")


def mkl(n, seconds=1.0):
    rng = np.random.default_rng(1)
    wave = (rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))).astype(np.complex64)
    out = np.empty_like(wave)
    flops = 2 * 5 * n * n * np.log2(n * n)
    done, begun = 0, time.perf_counter()
    while time.perf_counter() - begun < seconds:
        for _ in range(4):
            mkl_fft.fft2(wave, out=out)
            mkl_fft.ifft2(out, out=wave)
        done += 4 * flops
    return done / (time.perf_counter() - begun) / 1e9


def ours(n):
    command = ["cargo", "bench", "-q", "--bench", "propagation", "--", str(n), "band=0.95"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    for line in text.splitlines():
        fields = line.split()
        if len(fields) == 7 and fields[3] == str(args.threads):
            return float(fields[4]), float(fields[5])
    sys.exit("error: no figures in what the bench printed:\n" + text)


print(f"{'grid':>11} {'MKL':>7} {'our FFT':>8} {'our loop':>9} {'FFT / MKL':>10} {'loop / MKL':>11}   (spread over rounds)")
for n in args.sizes:
    rounds = [(mkl(n), *ours(n)) for _ in range(args.rounds)]
    m, f, l = (statistics.median(r[k] for r in rounds) for k in range(3))
    ratios = [r[2] / r[0] for r in rounds]
    print(
        f"{n:5} x {n:<4} {m:7.1f} {f:8.1f} {l:9.1f} {f / m:10.2f} {statistics.median(ratios):11.2f}"
        f"   {min(ratios):.2f}-{max(ratios):.2f}",
        flush=True,
    )
