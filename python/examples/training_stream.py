"""Annotated samples for training, made on the fly, and a file of some of them."""

import numpy as np

import stemworlds as sw

recipe = sw.Recipe("test", set={"field.thickness_nm": 0.4, "phonons.configurations": 2})
stream = sw.stream(recipe, dose=(1e3, 1e5), size=48, pixel_nm=(0.02, 0.03), seed=1, cache=False)
for sample in stream.iterate(count=3):
    columns = sample.targets.columns
    vacant = int(np.count_nonzero(columns["vacancies"]))
    print(f"{sample.index}: {sample.dose:.0f} e/A2, {sample.angle_deg:.0f} degrees, {len(columns)} columns, {vacant} with vacancies")

print(sw.export(stream, "train.npz", count=4))
