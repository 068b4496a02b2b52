"""Draws docs/acquisition.png: each effect of a recording alone, exaggerated. Needs matplotlib, h5py and stemgen on the path.

    stemgen build test --set "field.fov_nm=[5.04, 7.52]" --keep-clean -o /tmp/w.h5
    python3 docs/draw_acquisition.py /tmp/w.h5 docs/acquisition.png
"""

import subprocess
import sys
import tempfile

import h5py
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

WORLD, OUTPUT = sys.argv[1:3]
PLAIN = ["--dose", "1e8"]
PANELS = [
    ("noise-free", None, PLAIN),
    ("dose 1e4 e/A2", [], ["--dose", "1e4"]),
    ("drift 2 nm/s along x", ["drift_nm_per_s=[2,0]"], PLAIN),
    ("random drift, 0.5 nm after 1 s", ["drift_random_nm_per_sqrt_s=0.5"], PLAIN),
    ("line jitter 0.3 A", ["line_jitter_angstrom=0.3"], PLAIN),
    ("overshoot 4 A, 300 us", ["overshoot_angstrom=4", "overshoot_decay_us=300"], PLAIN),
    ("hum 0.5 A at 50 Hz", ["hum_angstrom=[0.5,0.2]"], PLAIN),
    ("scale 15 %, shear 15 %", ["scale_percent=[15,0]", "shear_percent=15"], PLAIN),
    ("late light 60 %, 40 us", ["afterglow_share=0.6", "afterglow_us=40"], ["--dose", "1e5"]),
    ("saturation at 10 pA", ["saturation_pa=10"], ["--current-pa", "1000"]),
    (
        "carbon, to 5 nm in 16 frames",
        ["contamination_angstrom3_per_electron=5.4e-7", "frames=16"],
        PLAIN,
    ),
    ("poor, dose 1e5 e/A2", ["profile=poor"], ["--dose", "1e5"]),
]

figure, axes = plt.subplots(3, 4, figsize=(8.4, 6.9), layout="constrained")
with tempfile.TemporaryDirectory() as folder:
    for axis, (title, keys, options) in zip(axes.flat, PANELS):
        path = f"{folder}/r.h5"
        command = ["stemgen", "acquire", WORLD, "--region", "2.6,1.3,5.0,3.7", "-q", "--overwrite", "-o", path]
        for key in keys or []:
            command += ["--set", f"acquisition.{key}"]
        subprocess.run(command + options, check=True)
        with h5py.File(path) as file:
            image = file["ideal" if keys is None else "recording"][:]
        axis.imshow(image, cmap="gray")
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
figure.savefig(OUTPUT, dpi=75)
