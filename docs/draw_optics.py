"""Draws docs/optics.png: what each setting of the optics makes of the same crystal. Needs matplotlib, h5py and
stemgen on the path.

    python3 docs/draw_optics.py docs/optics.png
"""

import subprocess
import sys
import tempfile

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

CRYSTAL = ["structures/srtio3.cif", "--repeat", "4,4,13", "--engine", "prism", "--phonons", "2", "--sigma", "0.08"]
SCAN = ["--scan-end", "7.81,7.81", "--scan-step", "0.25"]
PANELS = [
    ("HAADF 68-200 mrad", []),
    ("defocus 80 A", ["--defocus", "80"]),
    ("C12 = 50 A (astigmatism)", ["--aberration", "C12=50@0.5"]),
    ("C21 = 3000 A (coma)", ["--aberration", "C21=3000@0.3"]),
    ("C30 = 0.15 mm", ["--aberration", "C30=1.5e6"]),
    ("mistilt 15 mrad", ["--tilt", "15,0"]),
    ("focal spread 70 A", ["--focal-spread", "70"]),
    ("source of 1.5 A", ["--source-size", "1.5"]),
    ("ADF 30-68 mrad", ["--detector", "ADF=30-68"]),
    ("ABF 10-21 mrad", ["--detector", "ABF=10-21"]),
    ("BF 0-10 mrad", ["--detector", "BF=0-10"]),
    ("300 kV", ["--energy", "300"]),
]


def image(folder, options):
    """The image of the crystal with some options."""
    path = f"{folder}/i.h5"
    command = ["stemgen", "simulate", *CRYSTAL, *SCAN, *options, "-q", "--overwrite", "-o", path]
    subprocess.run(command, check=True)
    with h5py.File(path) as file:
        [found] = file["images"].values()
        return found[0]


figure, axes = plt.subplots(3, 4, figsize=(8.4, 6.9), layout="constrained")
with tempfile.TemporaryDirectory() as folder:
    for axis, (title, options) in zip(axes.flat, PANELS):
        axis.imshow(image(folder, options), cmap="gray")
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
figure.savefig(sys.argv[1], dpi=75)
