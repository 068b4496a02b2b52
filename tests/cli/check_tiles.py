"""Reads tiles for training as a user would."""
import sys

import numpy as np

train = np.load(sys.argv[1])
images, clean, heat, mask = (train[k] for k in ("images", "clean", "heat_maps", "class_masks"))
n, size = 6, 16
assert images.shape == clean.shape == heat.shape == mask.shape == train["phase_masks"].shape == (n, size, size)
dose, pixel = train["dose"], 10 * train["pixel_nm"][0]
assert dose.shape == (n,) and (dose >= 1e5).all() and (dose <= 1e7).all() and dose.std() > 0
counts = images * (dose * pixel**2)[:, None, None]
assert np.allclose(counts, counts.round(), atol=0.2)
expected = clean * (dose * pixel**2)[:, None, None]
off = (counts - expected) / np.sqrt(expected)
assert 0.85 < off.std() < 1.15, off.std()
columns = train["columns"]
fields = ("sample", "x_px", "y_px", "class", "number", "occupancy", "sites", "vacancies", "substitutions")
assert columns.dtype.names == fields and len(columns) > 6
for tile, x, y, kind, z, share, sites, vacant, substituted in columns.tolist():
    i, j = min(round(y), size - 1), min(round(x), size - 1)
    assert heat[tile, i, j] > 0.85
    assert kind == 1 + (vacant > 0) + 2 * (substituted > 0) and sites > 0 and z in (0, 8, 22, 38)
    assert abs(share - (1 - vacant / sites)) < 1e-6
assert heat.max() <= 1 and set(np.unique(mask)) <= {0, 1, 2} and (mask == 2).any()
# bright columns stand where the heat map is high
assert np.mean([np.corrcoef(c.ravel(), h.ravel())[0, 1] for c, h in zip(clean, heat)]) > 0.2
centres = train["centre_nm"]
assert centres.shape == (n, 2) and (train["angle_deg"] == 0).all() and (train["source"] == 0).all()
assert list(train["index"]) == list(range(n)) and "[field]" in str(train["recipes"][0])
corners = centres / train["pixel_nm"][:, None] - (size - 1) / 2
assert np.allclose(corners, corners.round(), atol=1e-6) and np.ptp(corners, axis=0).max() <= 28 - size
print(len(np.unique(centres, axis=0)) > 1)
