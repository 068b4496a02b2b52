"""Draws docs/live.png: a layer of MoS2 that loses sulphur at 120 kV.

    stemgen live mos2 --difficulty easy --grid 1x1 --set optics.energy_kv=120 --dose-series 10 --dose 1e5 -o dying.h5
    python docs/draw_live.py dying.h5 docs/live.png        # needs h5py and matplotlib
"""

import sys

import h5py
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SHOWN = [0, 3, 6, 9]

with h5py.File(sys.argv[1]) as file:
    recordings = file["recording"][:].astype(float)
    doses = file["series/dose_before"][:]
    vacant = file["series/vacancies"][:].sum(axis=1)

# Molybdenum is brighter than a pair of sulphur atoms: the scale ends below molybdenum, so that sulphur shows.
bright = 0.45 * np.percentile(recordings[0], 99.9)
figure, axes = plt.subplots(1, len(SHOWN), figsize=(12, 3.4), dpi=80)
for axis, number in zip(axes, SHOWN):
    axis.imshow(recordings[number], cmap="gray", vmin=0, vmax=bright)
    title = f"after {doses[number] / 1e5:.1f}e5 e/A$^2$: {vacant[number]} vacancies"
    axis.set_title(title, fontsize=11)
    axis.axis("off")
figure.subplots_adjust(left=0.005, right=0.995, bottom=0.01, top=0.9, wspace=0.02)
figure.savefig(sys.argv[2])
