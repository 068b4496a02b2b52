"""Draws docs/live.png: silicon, 3 nm thick, that loses its atoms at 200 kV.

    stemgen live sige --difficulty easy --grid 3x3 --set alloy.rate=0 --set field.thickness_nm=3 \
      --dose-series 20 --dose 5e4 -o si.h5
    python docs/draw_live.py si.h5 docs/live.png        # needs h5py and matplotlib
"""

import sys

import h5py
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SHOWN = [0, 6, 12, 19]

with h5py.File(sys.argv[1]) as file:
    recordings = file["recording"][:].astype(float)
    doses = file["series/dose_before"][:]
    vacant = file["series/vacancies"][:].sum(axis=1)
    sites = file["ground_truth/columns/number_of_sites"][:].sum()

bright = np.percentile(recordings[0], 99.9)
figure, axes = plt.subplots(1, len(SHOWN), figsize=(12, 3.4), dpi=80)
for axis, number in zip(axes, SHOWN):
    axis.imshow(recordings[number], cmap="gray", vmin=0, vmax=bright)
    share = 100 * vacant[number] / sites
    axis.set_title(f"{doses[number] / 1e5:.1f}e5 e/A$^2$: {share:.0f} % lost", fontsize=11)
    axis.axis("off")
figure.subplots_adjust(left=0.005, right=0.995, bottom=0.01, top=0.9, wspace=0.02)
figure.savefig(sys.argv[2])
