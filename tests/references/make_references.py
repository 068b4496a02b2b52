"""Images as a user of abTEM has them, for tests of `stemgen validate --reference`.

    pip install abtem==1.0.11
    python tests/references/make_references.py

srtio3.xyz      SrTiO3 [001], 2 x 2 x 2 cells, planes at 1/4 and 3/4 of a cell, atoms on grid points
haadf.zarr      HAADF 68-200 mrad, 6 x 4 probes (x, y) over one cell, measurement.to_zarr
square.npy      the same detector, 5 x 5 probes over a whole cell along x and half a cell along y, np.save of measurement.array
haadf.tif       the same by measurement.to_tiff: two ImageDescription tags, abTEM's and one of tifffile's
"""

import shutil
from pathlib import Path

import abtem
import ase.io
import numpy as np
from ase import Atoms

HERE = Path(__file__).resolve().parent
A = 3.905
sites = [(0, 0, 0.25), (0.5, 0.5, 0.75), (0.5, 0.5, 0.25), (0.5, 0, 0.75), (0, 0.5, 0.75)]
atoms = Atoms("SrTiO3", scaled_positions=sites, cell=[A] * 3, pbc=True) * (2, 2, 2)
ase.io.write(HERE / "srtio3.xyz", Atoms(atoms.numbers, atoms.positions, cell=atoms.cell, pbc=True), format="extxyz")

abtem.config.set({"precision": "float64"})
potential = abtem.Potential(atoms, gpts=(200, 200), slice_thickness=(A / 2,) * 4, projection="infinite")
probe = abtem.Probe(energy=200e3, semiangle_cutoff=21)


def image(end, gpts):
    scan = abtem.GridScan(start=(0, 0), end=end, gpts=gpts, endpoint=False)
    return probe.scan(potential, scan=scan, detectors=abtem.AnnularDetector(68, 200)).compute()


oblong = image((A, A), (6, 4))
shutil.rmtree(HERE / "haadf.zarr", ignore_errors=True)
oblong.to_zarr(str(HERE / "haadf.zarr"))
oblong.to_tiff(str(HERE / "haadf.tif"))
np.save(HERE / "square.npy", image((A, A / 2), (5, 5)).array)
