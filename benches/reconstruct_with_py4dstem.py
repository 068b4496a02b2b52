"""Reconstructs a specimen from a file of `stemgen patterns` with py4DSTEM (ptychography), and draws it beside the virtual images.

    python -m venv venv && venv/bin/pip install py4DSTEM==0.14.18
    stemgen patterns structures/srtio3.cif --repeat 12,12,4 --defocus 60 --scan-start 15.62,15.62 --scan-end 27.335,27.335 \\
        --scan-points 48,48 --pixels 64 --max-angle 50 --phonons 4 --sigma 0.08 --dose 1e5 -o s.emd
    venv/bin/python benches/reconstruct_with_py4dstem.py s.emd docs/reconstruction.png
"""

import argparse

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import py4DSTEM


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("patterns", help="file of stemgen patterns")
    parser.add_argument("picture", help="PNG to write")
    parser.add_argument("--iterations", type=int, default=12)
    arguments = parser.parse_args()
    cube = py4DSTEM.read(arguments.patterns)
    with h5py.File(arguments.patterns) as file:
        optics = {
            "energy": 1e3 * file.attrs["energy_kev"],
            "semiangle_cutoff": file.attrs["semiangle_mrad"],
            "defocus": file.attrs["defocus_angstrom"],
        }
        wavelength_angstrom = file.attrs["wavelength_angstrom"]
    step = cube.calibration.get_R_pixel_size()
    ptychography = py4DSTEM.process.phase.SingleslicePtychography(
        datacube=cube, **optics, verbose=False, device="cpu"
    )
    no_plots = {"plot_center_of_mass": False, "plot_rotation": False, "plot_probe_overlaps": False}
    ptychography.preprocess(**no_plots, force_com_rotation=0, force_com_transpose=False)
    ptychography.reconstruct(num_iter=arguments.iterations, step_size=0.5, reset=True, progress_bar=True, store_iterations=False)
    # A whole phase is free: the median is put at zero.
    found = ptychography.object_cropped
    phase = np.angle(found * np.exp(-1j * np.median(np.angle(found))))
    rows, columns = np.indices(cube.shape[2:])
    radius = np.hypot(rows - cube.shape[2] // 2, columns - cube.shape[3] // 2) * cube.calibration.get_Q_pixel_size()
    angle = radius * wavelength_angstrom * 1e3
    images = {
        "dark field, 30-48 mrad": (cube.data * ((angle > 30) & (angle < 48))).sum(axis=(2, 3)),
        "annular bright field, 10-21 mrad": (cube.data * ((angle > 10) & (angle < 21))).sum(axis=(2, 3)),
        "phase by ptychography (py4DSTEM), root": np.sqrt(phase - phase.min()),
    }
    print("errors of the iterations:", [round(float(e), 5) for e in ptychography.error_iterations])
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.5))
    extent = step * cube.shape[0]
    for ax, (title, image) in zip(axes, images.items(), strict=True):
        sides = [0, extent, extent, 0] if image.shape == cube.shape[:2] else None
        ax.imshow(image, cmap="gray", extent=sides)
        ax.set_title(title, fontsize=9)
        ax.set_xticks([])
        ax.set_yticks([])
    figure.tight_layout()
    figure.savefig(arguments.picture, dpi=110)


if __name__ == "__main__":
    main()
