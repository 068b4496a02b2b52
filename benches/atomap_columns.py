"""Compares the columns that atomap finds in a world with the ground truth of the file.

atomap (M. Nord et al., Adv. Struct. Chem. Imaging 3 (2017) 9) looks for peaks at least SEPARATION apart, moves each to the centre of mass of its
surroundings and then to the middle of a fitted Gaussian. A column of the truth is found if a peak lies within 0.05 nm of it. Columns without atoms
are left out, and so are columns and peaks nearer than 0.3 nm to the border.

    pip install atomap h5py
    stemgen build mos2 --difficulty easy --grid 2x2 --keep-clean -o mos2.h5
    python benches/atomap_columns.py mos2.h5
"""

from __future__ import annotations

import argparse
import json
import warnings
from typing import Any

import h5py
import numpy as np

NEAR_NM = 0.05
BORDER_NM = 0.3


def stitched(world: h5py.File, group: str) -> Any:
    """Returns the image of a world, put together from its tiles."""
    about = world["metadata"].attrs
    size, overlap = int(about["tile_size_px"]), int(about["overlap_px"])
    rows, columns = (int(n) for n in about["grid_shape"])
    step = size - overlap
    image = np.zeros((rows * step + overlap, columns * step + overlap), np.float32)
    for row in range(rows):
        for column in range(columns):
            image[row * step : row * step + size, column * step : column * step + size] = world[f"{group}/{row}_{column}"][:]
    return image


def found_by_atomap(image: Any, pixel_nm: float, separation_nm: float, passes: int = 2) -> Any:
    """Returns the places (x, y) in nm at which atomap finds columns, shape (n, 2)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import atomap.api as am
        import hyperspy.api as hs

        hs.preferences.General.show_progressbar = False
        hs.set_log_level("ERROR")
        signal = hs.signals.Signal2D(image)
        peaks = am.get_atom_positions(signal, separation=max(1, round(separation_nm / pixel_nm)))
        lattice = am.Sublattice(peaks, image=signal.data)
        lattice.find_nearest_neighbors()
        for _ in range(passes):
            lattice.refine_atom_positions_using_center_of_mass(show_progressbar=False)
        lattice.refine_atom_positions_using_2d_gaussian(show_progressbar=False)
        return np.column_stack([lattice.x_position, lattice.y_position]) * pixel_nm


def compared(found_nm: Any, truth_nm: Any, names: Any, size_nm: tuple[float, float]) -> dict[str, Any]:
    """Pairs peaks with columns one to one, the nearest first; returns the shares found and false, and the errors of places in pm.

    `names` are the compositions of the columns. `of` lists the number of columns of each composition, and the share found.
    """
    inside = [((p >= BORDER_NM) & (p <= np.array(size_nm) - BORDER_NM)).all(axis=1) for p in (found_nm, truth_nm)]
    apart = np.linalg.norm(found_nm[:, None, :] - truth_nm[None, :, :], axis=2)
    pairs = np.argwhere(apart <= NEAR_NM)
    partner: dict[int, int] = {}
    taken: set[int] = set()
    for peak, column in pairs[np.argsort(apart[tuple(pairs.T)])]:
        if peak not in taken and column not in partner:
            partner[int(column)] = int(peak)
            taken.add(int(peak))
    columns = np.flatnonzero(inside[1])
    peaks = np.flatnonzero(inside[0])
    hits = [n for n in columns if n in partner]
    errors = np.array([apart[partner[n], n] for n in hits])
    kinds = {name: [n in partner for n in columns if names[n] == name] for name in sorted(set(names[columns]))}
    return {
        "of": {name: [len(own), round(float(np.mean(own)), 4)] for name, own in kinds.items()},
        "columns": len(columns),
        "found": len(hits) / len(columns),
        "false": float(np.mean([peak not in taken for peak in peaks])),
        "rms_pm": float(1e3 * np.sqrt(np.mean(errors**2))),
        "median_pm": float(1e3 * np.median(errors)),
    }


def measured(path: str, separation_nm: float) -> list[dict[str, Any]]:
    """Compares the stored image of a world, and its noise-free image if the file has one."""
    rows = []
    with h5py.File(path) as world:
        pixel_nm = float(world["metadata"].attrs["pixel_size_nm"])
        columns = world["ground_truth/columns"]
        atoms = columns["number_of_sites"][:] - columns["vacancies"][:]
        truth, names = columns["position"][:][atoms > 0], columns["composition"].asstr()[:][atoms > 0]
        for name, group in (("counted", "tiles"), ("noise-free", "clean")):
            if group not in world:
                continue
            image = stitched(world, group)
            found = found_by_atomap(image, pixel_nm, separation_nm)
            height, width = (n * pixel_nm for n in image.shape)
            rows.append({"image": name, **compared(found, truth, names, (width, height))})
    return rows


def main() -> None:
    """Prints one line of JSON for each image."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world")
    parser.add_argument("--separation", type=float, default=0.08, help="least distance of two peaks in nm (default 0.08)")
    given = parser.parse_args()
    for row in measured(given.world, given.separation):
        print(json.dumps(row))


if __name__ == "__main__":
    main()
