"""Reads tiles for training as a user would."""
import sys

import numpy as np

train = np.load(sys.argv[1])
images, clean, heat, mask = (train[k] for k in ("images", "clean", "heat_maps", "class_masks"))
n, size = 6, 16
assert images.shape == clean.shape == heat.shape == mask.shape == train["phase_masks"].shape == (n, size, size)
dose, pixel = train["dose"], train["pixel_angstrom"][0]
assert dose.shape == (n,) and (dose >= 1e5).all() and (dose <= 1e7).all() and dose.std() > 0
counts = images * (dose * pixel**2)[:, None, None]
assert np.allclose(counts, counts.round(), atol=0.2)
expected = clean * (dose * pixel**2)[:, None, None]
off = (counts - expected) / np.sqrt(expected)
assert 0.85 < off.std() < 1.15, off.std()
tiles, places, columns = (train[k] for k in ("column_tiles", "column_positions_px", "columns"))
assert tiles.shape == (len(places),) and places.shape[1] == 2 and columns.shape == (len(places), 5)
for tile, (row, column), (kind, sites, vacant, substituted, z) in zip(tiles, places, columns):
    i, j = min(round(float(row)), size - 1), min(round(float(column)), size - 1)
    assert heat[tile, i, j] > 0.85
    assert kind == 1 + (vacant > 0) + 2 * (substituted > 0) and sites > 0 and z in (0, 8, 22, 38)
assert heat.max() <= 1 and set(np.unique(mask)) <= {0, 1, 2} and (mask == 2).any()
# bright columns stand where the heat map is high
assert np.mean([np.corrcoef(c.ravel(), h.ravel())[0, 1] for c, h in zip(clean, heat)]) > 0.2
origins = train["origins_px"]
assert origins.shape == (n, 2) and (origins >= 0).all() and (origins <= 28 - size).all()
print(len(np.unique(origins, axis=0)) > 1)
