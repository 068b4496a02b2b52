"""Regenerates the golden arrays of tests/golden from abTEM.

    pip install abtem==1.0.11
    OMP_NUM_THREADS=1 python tests/golden/make_abtem_goldens.py [--only NAME ...] [--plot DIR]

Each case writes NAME.npz (arrays), NAME.json (every setting) and NAME.xyz (the atoms, extended XYZ). See README.md.

Why the settings are what they are
----------------------------------
* Atoms on grid points, atomic planes in the middle of slices: then neither sub-pixel placement nor the
  assignment of atoms to slices can differ between two programs.
* "exact" potentials. abTEM's own Potential divides by a factor meant to undo the spreading of an atom over
  pixels, sin(x)/x with x = |k| dx (no pi). For an atom on a grid point there is nothing to undo, so this raises
  the high frequencies: HAADF 0.4-1.3 % too high here. The arrays without a suffix are therefore made with
  abTEM's scattering factors summed with exact phases (function exact_slices) and handed to abTEM as a PotentialArray;
  probe, transmission, propagation, detection are abTEM's. Arrays with the suffix `_as_shipped` use abtem.Potential.
* Grids: abTEM's anti-aliasing disk ends at 2/3 of Nyquist with a cosine taper from 0.64667 to 0.66667 Nyquist. Every grid
  used with the 200 mrad detector keeps even the start of the taper above 200 mrad.
* Slice thicknesses are given as sequences: from a single number abTEM takes ceil(thickness/number), and rounding
  may add a slice.
* Precision float64 (abTEM's default is float32, which moves these images by 1e-5); results stored as float32.
* PRISM with downsample=False: the S-matrix keeps the grid of the potential. (The default, "cutoff", crops it to the
  square that holds the anti-aliasing disk; it changes nothing here but the grid.)
"""

import argparse
import json
import os
import time
from pathlib import Path

import numpy as np

os.environ.setdefault("OMP_NUM_THREADS", "1")
import abtem  # noqa: E402
import ase.io  # noqa: E402
import dask  # noqa: E402
from abtem.core.energy import energy2sigma, energy2wavelength  # noqa: E402
from abtem.parametrizations import validate_parametrization  # noqa: E402
from ase import Atoms  # noqa: E402

dask.config.set(scheduler="single-threaded")
abtem.config.set({"precision": "float64", "diagnostics.progress_bar": False})

HERE = Path(__file__).resolve().parent
ENERGY = 200e3
SEMIANGLE = 21.0
WAVELENGTH = energy2wavelength(ENERGY)
DETECTORS = {"bf": (0.0, 10.0), "abf": (10.0, 21.0), "adf": (30.0, 68.0), "haadf": (68.0, 200.0)}
A_STO = 3.905
A_SI = 5.431
B_SI = 3.8403  # a/sqrt(2), rounded so that the cell is a short decimal
ORIENTATION = "arrays are [row = y, column = x]; abTEM's own are [x, y] and were transposed"
CONVENTIONS = {
    "wavelength_A": WAVELENGTH,
    "sigma_rad_per_VA": energy2sigma(ENERGY),
    "angle": "alpha = wavelength * k (small angle), k in 1/A",
    "aperture": "amplitude clip((semiangle - alpha)/d_alpha + 1/2, 0, 1), d_alpha = hypot(cos(phi) d_alpha_x, sin(phi) d_alpha_y), "
    "d_alpha_x = wavelength/extent_x: a linear ramp one Fourier pixel wide, centred on the semiangle",
    "probe": "psi(r) = sum_k A(k) exp(-i chi(k)) exp(2 pi i k.(r - r0)), sum of |psi(k)|^2 normalised to 1",
    "chi": "2 pi/wavelength * sum_nm alpha^(n+1)/(n+1) C_nm cos(m (phi - phi_nm)), phi = atan2(ky, kx), C10 = -defocus, defocus > 0 is underfocus",
    "transmission": "exp(i sigma V) on the grid, then multiplied by the anti-aliasing disk in Fourier space",
    "step": "transmit, then propagate by the slice's thickness exp(-i pi wavelength dz k^2), times the disk again; first slice transmits "
    "before any propagation, last slice propagates too",
    "antialias": "kc = 0.6666666 * Nyquist and taper = 0.02 * Nyquist, both of the coarser axis: 1 for k <= kc - taper, "
    "(1 + cos(pi (k - kc + taper)/taper))/2 up to kc, 0 beyond",
    "prism": "beams are the pixels of the window's Fourier grid (1/window apart) where the aperture, one such pixel soft, is above 0; each starts as "
    "exp(2 pi i k.r); a probe is sum_k c(k) exp(-2 pi i k.r0) S_k with c = A exp(-i chi)/sqrt(sum |c|^2), cut to the window whose first pixel is "
    "rint(r0/pixel - n//2), n pixels wide, S periodic; its Fourier transform over the window, sum of |.|^2 in vacuum 1, goes to the detectors",
    "detectors": "pixels of the exit wave's Fourier grid with inner <= alpha < outer, each whole; intensity as a fraction of the beam",
}


# ---------------------------------------------------------------- specimens


def srtio3(nx, ny, nz):
    """SrTiO3 [001], Sr at the corner of the cell; planes at 1/4 and 3/4, i.e. in the middle of slices of a/2."""
    sites = [(0, 0, 0.25), (0.5, 0.5, 0.75), (0.5, 0.5, 0.25), (0.5, 0, 0.75), (0, 0.5, 0.75)]
    return Atoms("SrTiO3", scaled_positions=sites, cell=[A_STO] * 3, pbc=True) * (nx, ny, nz)


def si_110(nx, ny, nz):
    """Si along [110]: x = [001], y = [1-10], z = [110]; planes at 1/4 and 3/4 of the repeat along z."""
    sites = [(0, 0, 0.25), (0.5, 0.5, 0.75), (0.25, 0, 0.75), (0.75, 0.5, 0.25)]
    return Atoms("Si4", scaled_positions=sites, cell=[A_SI, B_SI, B_SI], pbc=True) * (nx, ny, nz)


def rounded(atoms, decimals=8):
    """Positions as the xyz file holds them, so that the file reproduces the calculation exactly."""
    atoms.positions[:] = np.round(atoms.positions, decimals)
    return atoms


def exact_slices(atoms, gpts, dz, num_slices, parametrization="lobato"):
    """Projected potentials (V A) of slices, [slice, x, y], from structure factors with exact phases."""
    extent = atoms.cell.lengths()[:2]
    kx, ky = (np.fft.fftfreq(n, L / n) for n, L in zip(gpts, extent))
    k2 = kx[:, None] ** 2 + ky[None] ** 2
    table = validate_parametrization(parametrization)
    index = np.floor(atoms.positions[:, 2] / dz).astype(int)
    assert index.min() >= 0 and index.max() < num_slices
    factors = {s: table.projected_scattering_factor(s)(k2) for s in set(atoms.symbols)}
    out, seen = np.zeros((num_slices, *gpts)), {}
    for i in range(num_slices):
        here = atoms[index == i]
        key = (tuple(here.numbers), here.positions[:, :2].tobytes())
        if key not in seen:
            total = np.zeros(gpts, complex)
            for s, f in factors.items():
                p = here.positions[here.numbers == ase.data.atomic_numbers[s]]
                total += np.exp(-2j * np.pi * np.outer(kx, p[:, 0])) @ np.exp(-2j * np.pi * np.outer(p[:, 1], ky)) * f
            seen[key] = np.fft.ifft2(total).real * np.prod(gpts) / np.prod(extent)
        out[i] = seen[key]
    return out


def potentials(atoms, gpts, dz, num_slices, parametrization="lobato"):
    """(exact, as shipped): abTEM potentials, see the top of this file."""
    extent = tuple(atoms.cell.lengths()[:2])
    array = exact_slices(atoms, gpts, dz, num_slices, parametrization)
    exact = abtem.PotentialArray(array, slice_thickness=(dz,) * num_slices, extent=extent)
    shipped = abtem.Potential(
        atoms, gpts=gpts, slice_thickness=(dz,) * num_slices, parametrization=parametrization, projection="infinite"
    )
    return exact, shipped


# ---------------------------------------------------------------- running


def grid_scan(cell, gpts):
    """Points over one unit cell from the origin, end point excluded."""
    return abtem.GridScan(start=(0, 0), end=cell, gpts=gpts, endpoint=False)


def detectors():
    return [abtem.AnnularDetector(*limits) for limits in DETECTORS.values()]


def stack(measurements):
    """[detector, row = y, column = x]"""
    return np.stack([m.array.T if m.array.ndim == 2 else m.array for m in measurements])


def multislice(potential, scan, **aberrations):
    probe = abtem.Probe(energy=ENERGY, semiangle_cutoff=SEMIANGLE, **aberrations)
    return stack(probe.scan(potential, scan=scan, detectors=detectors(), lazy=False))


def prism(potential, scan, interpolation, downsample=False):
    s = abtem.SMatrix(
        semiangle_cutoff=SEMIANGLE, energy=ENERGY, potential=potential, interpolation=interpolation, downsample=downsample
    )
    return stack(s.scan(scan=scan, detectors=detectors(), lazy=False)), len(s)


def limits(atoms, gpts):
    """What the anti-aliasing aperture of a grid lets through, and how near a pixel comes to a detector's edge."""
    extent = atoms.cell.lengths()[:2]
    nyquist = min(n / (2 * L) for n, L in zip(gpts, extent))
    kx, ky = (np.fft.fftfreq(n, L / n) for n, L in zip(gpts, extent))
    alpha = np.hypot(kx[:, None], ky[None]).ravel() * WAVELENGTH * 1e3
    edges = sorted({e for lim in DETECTORS.values() for e in lim if e})
    return {
        "antialias_limit_mrad": 0.6666666 * nyquist * WAVELENGTH * 1e3,
        "antialias_taper_starts_mrad": (0.6666666 - 0.02) * nyquist * WAVELENGTH * 1e3,
        "nearest_pixel_to_detector_edge_mrad": {f"{e:g}": float(abs(alpha - e).min()) for e in edges},
    }


def save(name, arrays, described, settings, atoms=None):
    """Arrays as float32 in NAME.npz, settings and a description of each array in NAME.json, atoms in NAME.xyz."""
    arrays = {k: np.ascontiguousarray(v, dtype=np.float32) for k, v in arrays.items()}
    assert arrays.keys() == described.keys(), (arrays.keys(), described.keys())
    np.savez(HERE / f"{name}.npz", **arrays)
    if atoms is not None:
        plain = Atoms(atoms.numbers, atoms.positions, cell=atoms.cell, pbc=True)
        ase.io.write(HERE / f"{name}.xyz", plain, format="extxyz")
        again = ase.io.read(HERE / f"{name}.xyz")
        assert np.array_equal(again.positions, atoms.positions) and np.allclose(again.cell, atoms.cell, atol=1e-12)
        settings = {"atoms": f"{name}.xyz", "cell_A": atoms.cell.lengths().tolist(), **settings}
    doc = {
        "name": name,
        "made_by": f"make_abtem_goldens.py --only {name}",
        "abtem_version": abtem.__version__,
        "abtem_config": {"precision": "float64", "antialias.cutoff": 0.6666666, "antialias.taper": 0.01},
        "energy_eV": ENERGY,
        "semiangle_mrad": SEMIANGLE,
        "orientation": ORIENTATION,
        "conventions": CONVENTIONS,
        **settings,
        "arrays": {k: {"shape": list(v.shape), "dtype": "float32", "what": described[k]} for k, v in arrays.items()},
    }
    (HERE / f"{name}.json").write_text(json.dumps(doc, indent=1) + "\n")
    for k, v in arrays.items():
        print(f"  {k} {v.shape} {v.min():.6g} .. {v.max():.6g}")


def settings_for(atoms, gpts, dz, num_slices, scan=None, **extra):
    out = {
        "gpts_xy": list(gpts),
        "slice_thickness_A": dz,
        "num_slices": num_slices,
        "parametrization": "lobato",
        "projection": "infinite",
        "grid_limits": limits(atoms, gpts),
        "detectors_mrad": DETECTORS,
    }
    if scan is not None:
        nx, ny = scan.gpts
        out["scan"] = {
            "start_A": [0.0, 0.0],
            "end_A": list(scan.end),
            "endpoint": False,
            "points_xy": [nx, ny],
            "step_xy_A": [scan.end[0] / nx, scan.end[1] / ny],
        }
    out.update(extra)
    return out


IMAGES = f"[detector, y, x], detectors in the order {', '.join(DETECTORS)}; fraction of the beam; plain multislice"
SHIPPED = "; potential as abtem.Potential makes it, with its pixel correction (see make_abtem_goldens.py)"


# ---------------------------------------------------------------- cases


def case_srtio3_001():
    """The workhorse: 26 cells (10.2 nm), 3 x 3 cells = 11.7 A wide, 100 pixels to the cell (taper starts at 207 mrad)."""
    name, dz = "srtio3_001", A_STO / 2
    atoms, gpts, n = rounded(srtio3(3, 3, 26)), (300, 300), 52
    exact, shipped = potentials(atoms, gpts, dz, n)
    scan = grid_scan((A_STO, A_STO), (12, 12))
    p1, beams = prism(exact, scan, 1)
    arrays = {"multislice": multislice(exact, scan), "multislice_as_shipped": multislice(shipped, scan), "prism_f1": p1}
    described = {
        "multislice": IMAGES,
        "multislice_as_shipped": IMAGES + SHIPPED,
        "prism_f1": "the same by abtem.SMatrix, interpolation 1, downsample=False",
    }
    print("  PRISM f=1 against multislice:", abs(p1 - arrays["multislice"]).max())
    save(name, arrays, described, settings_for(atoms, gpts, dz, n, scan, prism_beams={"f1": beams}), atoms)


def case_srtio3_prism_f2():
    """PRISM f = 2, windows of 11.7 A in a cell of 23.4 A. In a perfect crystal every beam of the f = 2 set has the period of
    the window, so f = 2 would equal f = 1 of the half-sized cell exactly and test no cropping. Hence a quarter of the Sr atoms
    are removed at random; the others stay on the grid. Scan points lie on pixels, so rounding the window's corner is not
    ambiguous (abTEM: corner = rint(position/pixel - n//2), n the window's pixels)."""
    name, dz = "srtio3_prism_f2", A_STO / 2
    atoms, gpts, n = srtio3(6, 6, 10), (600, 600), 20
    rng = np.random.default_rng(1)
    sr = np.flatnonzero(atoms.numbers == 38)
    keep = np.ones(len(atoms), bool)
    keep[rng.choice(sr, len(sr) // 4, replace=False)] = False
    atoms = rounded(atoms[keep])
    exact, _ = potentials(atoms, gpts, dz, n)
    scan = abtem.GridScan(start=(0, 0), end=(2 * A_STO, 2 * A_STO), gpts=(10, 10), endpoint=False)
    p2, beams = prism(exact, scan, 2)
    d2, _ = prism(exact, scan, 2, downsample="cutoff")
    ms = multislice(exact, scan)
    print("  downsample='cutoff' against False:", abs(d2 - p2).max(), " f=2 against multislice:", abs(p2 - ms).max())
    arrays = {"prism_f2": p2, "multislice": ms}
    described = {
        "prism_f2": "[detector, y, x] as in multislice; abtem.SMatrix, interpolation 2, downsample=False",
        "multislice": IMAGES + ", in the whole cell",
    }
    extra = {"prism_beams": {"f2": beams}, "window_A": [3 * A_STO] * 2, "window_gpts_xy": [300, 300]}
    save(name, arrays, described, settings_for(atoms, gpts, dz, n, scan, **extra), atoms)


def case_si_110():
    """Si [110]: neither cell, grid, pixel nor scan is square, so a transposition shows. 26 repeats (10.0 nm)."""
    name, dz = "si_110", B_SI / 2
    atoms, gpts, n = rounded(si_110(3, 4, 26)), (420, 400), 52
    exact, shipped = potentials(atoms, gpts, dz, n)
    scan = grid_scan((A_SI, B_SI), (14, 10))
    arrays = {"multislice": multislice(exact, scan), "multislice_as_shipped": multislice(shipped, scan)}
    described = {"multislice": IMAGES, "multislice_as_shipped": IMAGES + SHIPPED}
    save(name, arrays, described, settings_for(atoms, gpts, dz, n, scan), atoms)


def case_si_110_prism_f2():
    """PRISM f = 2 of Si [110], 10.0 nm, a quarter of the atoms missing (see srtio3_prism_f2), windows of 10.9 x 11.5 A."""
    name, dz = "si_110_prism_f2", B_SI / 2
    atoms, gpts, n = si_110(4, 6, 26), (560, 600), 52
    rng = np.random.default_rng(2)
    keep = np.ones(len(atoms), bool)
    keep[rng.choice(len(atoms), len(atoms) // 4, replace=False)] = False
    atoms = rounded(atoms[keep])
    exact, _ = potentials(atoms, gpts, dz, n)
    # every 14th and 10th pixel
    scan = abtem.GridScan(start=(0, 0), end=(2 * A_SI, 2 * B_SI), gpts=(20, 20), endpoint=False)
    p2, beams = prism(exact, scan, 2)
    print("  f=2 beams:", beams)
    described = {"prism_f2": "[detector, y, x], fractions of the beam; abtem.SMatrix, interpolation 2, downsample=False"}
    extra = {"prism_beams": {"f2": beams}, "window_A": [2 * A_SI, 3 * B_SI], "window_gpts_xy": [280, 300]}
    save(name, {"prism_f2": p2}, described, settings_for(atoms, gpts, dz, n, scan, **extra), atoms)


# Each term turns the edge of a 21 mrad aperture by about a radian or more, so that a wrong sign, order or angle shows.
THIRD_ORDER = dict(C10=-80.0, C12=30.0, phi12=0.3, C21=2e3, phi21=0.7, C23=1.5e3, phi23=0.2, C30=1e5)
ALL_ORDERS = dict(
    C10=60.0, C12=20.0, phi12=-0.5, C21=1.5e3, phi21=2.1, C23=1.2e3, phi23=-0.4,
    C30=-8e4, C32=8e4, phi32=0.9, C34=6e4, phi34=0.25,
    C41=4e6, phi41=-1.3, C43=3e6, phi43=0.55, C45=5e6, phi45=0.1,
    C50=5e8, C52=2e8, phi52=1.1, C54=1.5e8, phi54=-0.35, C56=2.5e8, phi56=0.45,
)  # fmt: skip
ABERRATIONS = {"third_order": THIRD_ORDER, "all_orders": ALL_ORDERS}


def case_srtio3_001_aberrated():
    """Aberrated probes, 10 cells (3.9 nm), plain multislice."""
    name, dz = "srtio3_001_aberrated", A_STO / 2
    atoms, gpts, n = rounded(srtio3(3, 3, 10)), (300, 300), 20
    exact, _ = potentials(atoms, gpts, dz, n)
    scan = grid_scan((A_STO, A_STO), (8, 8))
    arrays = {"perfect": multislice(exact, scan)}
    arrays.update({k: multislice(exact, scan, **v) for k, v in ABERRATIONS.items()})
    matrix = abtem.SMatrix(semiangle_cutoff=SEMIANGLE, energy=ENERGY, potential=exact, downsample=False)
    ctf = abtem.CTF(energy=ENERGY, semiangle_cutoff=SEMIANGLE, **THIRD_ORDER)
    prism3 = stack(matrix.scan(scan=scan, detectors=detectors(), ctf=ctf, lazy=False))
    print("  PRISM f=1 with aberrations against multislice:", abs(prism3 - arrays["third_order"]).max())
    described = {k: IMAGES + "; aberrations: " + k for k in arrays}
    save(name, arrays, described, settings_for(atoms, gpts, dz, n, scan, aberrations_A_rad={"perfect": {}, **ABERRATIONS}), atoms)


# Mistilts (x, y) in mrad of 3 and 8 mrad in all; abTEM's `tilt` multiplies its propagators by exp(-2 pi i dz (kx tan tx + ky tan ty))
# and leaves probe and detectors as they are.
TILTS = {"tilt_3": (2.4, 1.8), "tilt_8": (-6.4, 4.8)}
FOCAL_SPREAD = 25.0  # standard deviation, A
SOURCE_FWHM = 0.9  # A


def case_srtio3_001_optics():
    """Mistilt, focal spread and source size, 10 cells (3.9 nm), plain multislice. Focal spread: abTEM's own Gaussian distribution, 33 foci evenly spaced up to
    4 standard deviations, about an underfocus of 20 A. Source size: abTEM's gaussian_filter of a scan of the whole cell."""
    name, dz = "srtio3_001_optics", A_STO / 2
    atoms, gpts, n = rounded(srtio3(3, 3, 10)), (300, 300), 20
    exact, _ = potentials(atoms, gpts, dz, n)
    scan = grid_scan((A_STO, A_STO), (10, 12))
    arrays = {k: multislice(exact, scan, tilt=v) for k, v in TILTS.items()}
    foci = abtem.distributions.gaussian(FOCAL_SPREAD, num_samples=33, center=20.0, sampling_limit=4.0)
    # abTEM reduces an ensemble to sum(w I) / sum(w); one focus after the other takes less memory
    at_foci = [w * multislice(exact, scan, defocus=float(d)) for d, w in zip(foci.values, foci.weights)]
    arrays["focal_spread"] = sum(at_foci) / sum(foci.weights)
    arrays["focus_20"] = multislice(exact, scan, defocus=20.0)
    print("  focal spread changes by", abs(arrays["focal_spread"] - arrays["focus_20"]).max(axis=(1, 2)))
    fine = grid_scan((A_STO, A_STO), (26, 26))
    probe = abtem.Probe(energy=ENERGY, semiangle_cutoff=SEMIANGLE)
    images = probe.scan(exact, scan=fine, detectors=detectors(), lazy=False, max_batch=64)
    sigma = SOURCE_FWHM / np.sqrt(8 * np.log(2))
    arrays["source"] = stack([i.gaussian_filter(sigma, boundary="periodic") for i in images])
    described = {k: IMAGES + f"; tilt {v} mrad" for k, v in TILTS.items()}
    described["focal_spread"] = IMAGES + "; mean over 33 foci, weighted by abtem.distributions.gaussian"
    described["focus_20"] = IMAGES + "; defocus 20 A, no focal spread"
    described["source"] = IMAGES + "; 26 x 26 points of the same cell, blurred by the source"
    settings = settings_for(atoms, gpts, dz, n, scan, tilts_mrad=TILTS, focal_spread_A=FOCAL_SPREAD, defocus_A=20.0, source_fwhm_A=SOURCE_FWHM)
    same = {"atoms": "srtio3_001_aberrated.xyz", "cell_A": atoms.cell.lengths().tolist()}
    assert np.array_equal(ase.io.read(HERE / same["atoms"]).positions, atoms.positions)
    save(name, arrays, described, {**same, **settings})


def case_exit_intensity():
    """One exit wave, pixel by pixel: the diffraction pattern at a position without symmetry, 3.9 nm."""
    name, dz, at = "exit_intensity", A_STO / 2, (0.3 * A_STO, 0.2 * A_STO)
    atoms, gpts, n = rounded(srtio3(3, 3, 10)), (300, 300), 20
    exact, _ = potentials(atoms, gpts, dz, n)
    probe = abtem.Probe(energy=ENERGY, semiangle_cutoff=SEMIANGLE)
    wave = probe.multislice(exact, scan=np.array(at), lazy=False).array.reshape(gpts)
    pattern = abs(np.fft.fft2(wave)) ** 2
    kept = int(120e-3 / WAVELENGTH * 3 * A_STO)
    order = np.r_[-kept : kept + 1]
    arrays = {"intensity": pattern[np.ix_(order, order)].T}
    described = {
        "intensity": f"[ky, kx], both from {-kept} to {kept} times 1/{3 * A_STO:g} 1/A, zero at index {kept}; fraction of the beam per pixel "
        f"(total beam 1; after all slices {pattern.sum():.6f} within the anti-aliasing disk)"
    }
    save(name, arrays, described, settings_for(atoms, gpts, dz, n, position_A=at), atoms)


def pixel_integrals(wave, at, extent, pixels, max_mrad):
    """A diffraction pattern [ky, kx] integrated over square detector pixels, k = 0 in the middle of pixel n // 2, of an exit wave [y, x].

    The wave is cut half a cell from `at` (x, y). Around it there is nothing, so the intensity is the Fourier series of its
    autocorrelation, and its integral over a pixel is exact: each lag times sinc(width lag)."""
    n = wave.shape[0]
    middle = [round(float(p / length * n)) for p, length in zip(at, extent)]
    box = np.zeros((2 * n, 2 * n), complex)
    box[:n, :n] = np.roll(wave, (n // 2 - middle[1], n // 2 - middle[0]), axis=(0, 1))
    lags = np.fft.ifft2(abs(np.fft.fft2(box)) ** 2)
    width = 2e-3 * max_mrad / pixels / WAVELENGTH
    k = (np.arange(pixels) - pixels // 2) * width
    steps = [np.fft.fftfreq(2 * n, 1 / (2 * n)) * length / n for length in extent]
    x, y = (width * length * np.exp(-2j * np.pi * np.outer(k, r)) * np.sinc(width * r) for r, length in zip(steps, extent))
    return (y @ lags @ x.T).real


def case_srtio3_patterns():
    """Diffraction patterns of three probes in the atoms of srtio3_prism_f2 (a quarter of Sr is missing, so that no probe stands on an axis
    of symmetry): integrals over pixels, sums over rings, and the centre of mass."""
    name, dz, gpts, n = "srtio3_patterns", A_STO / 2, (300, 300), 20
    atoms = ase.io.read(HERE / "srtio3_prism_f2.xyz")
    pixels, most, ring, rings = 32, 60.0, 2.0, 50
    step = A_STO / 50
    places = [(126 * step, 139 * step), (150 * step, 150 * step), (173 * step, 157 * step)]
    exact, _ = potentials(atoms, gpts, dz, n)
    probe = abtem.Probe(energy=ENERGY, semiangle_cutoff=SEMIANGLE)
    extent = atoms.cell.lengths()[:2]
    kx, ky = (np.fft.fftfreq(g, length / g) * WAVELENGTH * 1e3 for g, length in zip(gpts, extent))
    angle = np.hypot(ky[:, None], kx[None])
    arrays = {"patterns": [], "rings": [], "centre_of_mass_mrad": []}
    for at in places:
        wave = probe.multislice(exact, scan=np.array(at), lazy=False).array.reshape(gpts).T
        spectrum = abs(np.fft.fft2(wave)) ** 2
        arrays["patterns"].append(pixel_integrals(wave, at, extent, pixels, most))
        arrays["rings"].append([spectrum[(i * ring <= angle) & (angle < (i + 1) * ring)].sum() for i in range(rings)])
        held = np.where(angle < most, spectrum, 0)
        arrays["centre_of_mass_mrad"].append([(held * kx[None]).sum() / held.sum(), (held * ky[:, None]).sum() / held.sum()])
    described = {
        "patterns": f"[probe, ky, kx], integrals over {pixels} x {pixels} pixels to {most:g} mrad, k = 0 in the middle of pixel {pixels // 2}; "
        "fraction of the beam",
        "rings": f"[probe, ring], {rings} rings of {ring:g} mrad from 0 on, each pixel of the Fourier grid whole; fraction of the beam",
        "centre_of_mass_mrad": f"[probe, (x, y)], of the pixels of the Fourier grid below {most:g} mrad",
    }
    extra = {"positions_A": places, "pixels": pixels, "max_angle_mrad": most, "ring_mrad": ring}
    same = {"atoms": "srtio3_prism_f2.xyz", "cell_A": atoms.cell.lengths().tolist()}
    save(name, arrays, described, {**same, **settings_for(atoms, gpts, dz, n, **extra)})


def case_srtio3_waves():
    """Exit waves of two probes in the atoms of srtio3_prism_f2, with a defocus: their complex Fourier coefficients at low angles."""
    name, dz, gpts, n, most, defocus = "srtio3_waves", A_STO / 2, (300, 300), 20, 40.0, 50.0
    atoms = ase.io.read(HERE / "srtio3_prism_f2.xyz")
    places = [(126 * A_STO / 50, 139 * A_STO / 50), (173 * A_STO / 50, 157 * A_STO / 50)]
    exact, _ = potentials(atoms, gpts, dz, n)
    probe = abtem.Probe(energy=ENERGY, semiangle_cutoff=SEMIANGLE, defocus=defocus)
    extent = atoms.cell.lengths()[:2]
    kept = int(most * 1e-3 / WAVELENGTH * extent[0])
    order = np.r_[-kept : kept + 1]
    waves = [probe.multislice(exact, scan=np.array(at), lazy=False).array.reshape(gpts).T for at in places]
    held = np.array([np.fft.fft2(wave)[np.ix_(order, order)] for wave in waves])
    arrays = {"real": held.real, "imaginary": held.imag}
    described = {
        part: f"[probe, ky, kx], both from {-kept} to {kept} times 1/{extent[0]:g} 1/A, zero at index {kept}: {part} part of the Fourier "
        "coefficients sum psi(r) exp(-2 pi i k.r); the squares of all coefficients add to the fraction of the beam"
        for part in arrays
    }
    extra = {"positions_A": places, "defocus_A": defocus}
    same = {"atoms": "srtio3_prism_f2.xyz", "cell_A": atoms.cell.lengths().tolist()}
    save(name, arrays, described, {**same, **settings_for(atoms, gpts, dz, n, **extra)})


def case_potential_srtio3():
    """Projected potentials of single planes (V A) on the grid of one cell, and of atoms off the grid on an oblong grid."""
    name, dz = "potential_srtio3", A_STO / 2
    atoms, gpts = rounded(srtio3(1, 1, 1)), (100, 100)
    arrays, described = {}, {}
    for table in ("lobato", "kirkland", "peng"):
        exact, shipped = potentials(atoms, gpts, dz, 2, table)
        arrays[f"sr_o_{table}"] = exact.array[0].T
        described[f"sr_o_{table}"] = f"[y, x] Sr-O plane, V A, {table}, exact phases, all frequencies of the grid"
        if table == "lobato":
            arrays["ti_o2_lobato"] = exact.array[1].T
            described["ti_o2_lobato"] = "[y, x] Ti-O2 plane, V A, lobato"
            arrays["sr_o_lobato_as_shipped"] = shipped.build(lazy=False).array[0].T
            described["sr_o_lobato_as_shipped"] = "[y, x] Sr-O plane, V A, lobato, from abtem.Potential with its pixel correction"
    off = Atoms("SrTiO", [(0.513, 0.171, 1.0), (2.207, 3.049, 1.0), (3.333, 1.618, 1.0)], cell=[4.0, 5.0, 2.0], pbc=True)
    arrays["off_grid"] = exact_slices(off, (80, 120), 2.0, 1)[0].T
    described["off_grid"] = (
        "[y, x] V A, lobato; Sr (0.513, 0.171), Ti (2.207, 3.049), O (3.333, 1.618) A in a 4 x 5 A cell on 80 x 120 pixels (x, y); "
        "exact phases by this script from abTEM's scattering factors, real part of the inverse FFT over all frequencies of the grid"
    )
    settings = {"gpts_xy": gpts, "slice_thickness_A": dz, "projection": "infinite"}
    save(name, arrays, described, settings, atoms)


def case_displaced_refined():
    """Displaced atoms. abTEM's own placement converges only slowly with the grid; values per position on finer and finer grids, and
    what abTEM gives with exact potentials, which depends on the grid only through its anti-aliasing limit and the aliasing of exp(i sigma V)."""
    name, dz, n = "displaced_refined", A_STO / 2, 20
    atoms = srtio3(5, 5, 10)
    sigma = {"Sr": 0.084, "Ti": 0.060, "O": 0.085}  # per Cartesian component, A
    rng = np.random.default_rng(20240607)
    shift = rng.normal(size=(len(atoms), 3)) * np.array([sigma[s] for s in atoms.symbols])[:, None]
    planes = np.floor(atoms.positions[:, 2] / dz)
    atoms.positions += shift
    assert np.array_equal(planes, np.floor(atoms.positions[:, 2] / dz))
    atoms.wrap()
    rounded(atoms, 6)
    # columns of the middle cell, the middles between them, and two points without symmetry
    fractions = [(0, 0), (0.5, 0.5), (0.5, 0), (0, 0.5), (0.25, 0), (0.25, 0.25), (0, 0.25), (0.25, 0.5), (0.1, 0.33), (0.37, 0.18)]
    at = np.array([(2 + fx, 2 + fy) for fx, fy in fractions]) * A_STO
    probe = abtem.Probe(energy=ENERGY, semiangle_cutoff=SEMIANGLE)

    def run(potential):
        rows = []
        for r in at:  # one probe at a time: a wave at 2400 x 2400 is 92 MB
            measured = probe.scan(potential, scan=abtem.CustomScan(r[None]), detectors=detectors(), lazy=False)
            rows.append([np.ravel(m.array)[0] for m in measured])
        return np.array(rows)

    arrays, described = {}, {}
    for pixels in (480, 720, 960, 1920):
        array = exact_slices(atoms, (pixels, pixels), dz, n)
        exact = abtem.PotentialArray(array, slice_thickness=(dz,) * n, extent=tuple(atoms.cell.lengths()[:2]))
        arrays[f"exact_{pixels}"] = run(exact)
        described[f"exact_{pixels}"] = f"[position, detector] exact potentials, {pixels} x {pixels} pixels"
        print("  exact", pixels, arrays[f"exact_{pixels}"][:3, 3], flush=True)
    for pixels in (480, 960, 1920, 2400):
        start = time.time()
        shipped = abtem.Potential(atoms, gpts=(pixels, pixels), slice_thickness=(dz,) * n, projection="infinite").build(lazy=False)
        arrays[f"as_shipped_{pixels}"] = run(shipped)
        described[f"as_shipped_{pixels}"] = f"[position, detector] abtem.Potential, {pixels} x {pixels} pixels"
        print("  as shipped", pixels, arrays[f"as_shipped_{pixels}"][:3, 3], f"{time.time() - start:.0f} s", flush=True)
        del shipped
    settings = {
        "slice_thickness_A": dz,
        "num_slices": n,
        "parametrization": "lobato",
        "projection": "infinite",
        "sigma_per_component_A": sigma,
        "rng": "numpy default_rng(20240607); the displaced positions are in the xyz file",
        "detectors_mrad": DETECTORS,
        "positions_A": np.round(at, 6).tolist(),
        "positions_in_cell": fractions,
        "grid_limits": {str(p): limits(atoms, (p, p)) for p in (480, 720, 960, 1920, 2400)},
    }
    save(name, arrays, described, settings, atoms)


def case_displaced_bandlimit():
    """How t = exp(i sigma V) is limited to 205 mrad matters by percents on heavy columns. The atoms and positions of displaced_refined,
    propagated in the same band (that of 480 pixels) in three ways; `exact_1920` of displaced_refined is the limit of no limit."""
    base = json.loads((HERE / "displaced_refined.json").read_text())
    atoms, dz, n = ase.io.read(HERE / base["atoms"]), base["slice_thickness_A"], base["num_slices"]
    extent = tuple(atoms.cell.lengths()[:2])
    probe = abtem.Probe(energy=ENERGY, semiangle_cutoff=SEMIANGLE)

    def run(array):
        potential = abtem.PotentialArray(array, slice_thickness=(dz,) * n, extent=extent)
        scans = [abtem.CustomScan(np.array([r])) for r in base["positions_A"]]
        rows = [[np.ravel(m.array)[0] for m in probe.scan(potential, scan=s, detectors=detectors(), lazy=False)] for s in scans]
        return np.array(rows)

    coarse = exact_slices(atoms, (480, 480), dz, n)
    k = np.fft.fftfreq(480, extent[0] / 480)
    disk = np.hypot(k[:, None], k[None]) <= 0.6666666 * 480 / (2 * extent[0])
    arrays = {
        "t_480": run(coarse),
        "v_limited_480": run(np.fft.ifft2(np.fft.fft2(coarse) * disk).real),
    }
    fine = exact_slices(atoms, (960, 960), dz, n)
    with abtem.config.set({"antialias.cutoff": 0.6666666 / 2, "antialias.taper": 0.01 / 2}):
        arrays["t_960_limited"] = run(fine)
    what = "[position, detector] "
    described = {
        "t_480": what + "abTEM's way: V with all frequencies of 480 pixels, t on 480 pixels, its aliased part stays",
        "v_limited_480": what + "V limited to the disk first, then t on 480 pixels",
        "t_960_limited": what + "V and t on 960 pixels, t then limited to the disk of 480 pixels (antialias.cutoff and taper halved)",
    }
    settings = {k: base[k] for k in ("slice_thickness_A", "num_slices", "detectors_mrad", "positions_A", "positions_in_cell")}
    save("displaced_bandlimit", arrays, described, {"atoms": base["atoms"], "cell_A": base["cell_A"], **settings})


def case_displaced_image():
    """An image of displaced atoms, against which abTEM's grid error and the place of slice boundaries are measured. `exact_*` are to be
    extrapolated to an infinitely fine grid; `as_shipped_*` is what a user of abTEM gets; `boundary_*` is the same with the atomic planes on the
    boundaries of slices, as in a cell whose first plane lies at z = 0 (here one slice below the surface, so that no atom changes sides)."""
    name, dz, n = "displaced_image", A_STO / 2, 20
    atoms = srtio3(3, 3, 10)
    sigma = {"Sr": 0.084, "Ti": 0.060, "O": 0.085}  # per Cartesian component, A
    rng = np.random.default_rng(20261121)
    shift = rng.normal(size=(len(atoms), 3)) * np.array([sigma[s] for s in atoms.symbols])[:, None]
    atoms.positions += shift
    x, y, z = atoms.positions.T
    atoms.positions[:] = np.stack([x % (3 * A_STO), y % (3 * A_STO), z], axis=1)
    rounded(atoms, 6)
    assert 0 < z.min() and z.max() < n * dz
    scan = grid_scan((A_STO, A_STO), (10, 8))
    moved = atoms.copy()
    moved.positions[:, 2] += dz / 2
    moved.cell[2, 2] += dz
    arrays, described = {}, {}

    def shipped(atoms, pixels, n, projection):
        return abtem.Potential(atoms, gpts=(pixels, pixels), slice_thickness=(dz,) * n, projection=projection)

    def add(key, potential, what):
        start = time.time()
        arrays[key] = multislice(potential, scan)
        described[key] = f"{IMAGES}; {what}"
        print(f"  {key} {time.time() - start:.0f} s", flush=True)

    for pixels in (288, 576):
        add(f"as_shipped_{pixels}", shipped(atoms, pixels, n, "infinite"), f"abtem.Potential, {pixels} x {pixels} pixels")
        for projection in ("infinite", "finite"):
            what = f"abtem.Potential, {pixels} x {pixels} pixels, {projection} projection, planes on slice boundaries"
            add(f"boundary_{projection}_{pixels}", shipped(moved, pixels, n + 1, projection), what)
    for pixels in (576, 1152):
        array = exact_slices(atoms, (pixels, pixels), dz, n)
        exact = abtem.PotentialArray(array, slice_thickness=(dz,) * n, extent=tuple(atoms.cell.lengths()[:2]))
        add(f"exact_{pixels}", exact, f"exact potentials, {pixels} x {pixels} pixels")
    add("as_shipped_1152", shipped(atoms, 1152, n, "infinite"), "abtem.Potential, 1152 x 1152 pixels")
    extra = {"sigma_per_component_A": sigma, "rng": "numpy default_rng(20261121); the displaced positions are in the xyz file"}
    settings = settings_for(atoms, (1152, 1152), dz, n, scan, **extra)
    save(name, arrays, described, settings, atoms)


CASES = {k[5:]: v for k, v in globals().items() if k.startswith("case_")}


def plot(name, folder):
    """Every array of a case as a picture, to look at."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels = []
    for key, v in np.load(HERE / f"{name}.npz").items():
        panels += [(f"{key} {d}", v[i]) for i, d in enumerate(DETECTORS)] if v.ndim == 3 else [(key, v)]
    columns = 4
    rows = -(-len(panels) // columns)
    fig, axes = plt.subplots(rows, columns, figsize=(3.2 * columns, 3 * rows), squeeze=False)
    for ax, (title, v) in zip(axes.flat, panels):
        im = ax.imshow(v**0.25 if name == "exit_intensity" else v, origin="lower")
        fig.colorbar(im, ax=ax)
        ax.set_title(title, fontsize=8)
    fig.tight_layout()
    fig.savefig(Path(folder) / f"{name}.png", dpi=70)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=sorted(CASES), help="cases to make (default: all)")
    parser.add_argument("--plot", metavar="DIR", help="also write a PNG per case into DIR")
    args = parser.parse_args()
    for case in args.only or CASES:
        begin = time.time()
        print(case)
        CASES[case]()
        print(f"  {time.time() - begin:.0f} s")
        if args.plot:
            plot(case, args.plot)
