"""Holds the .hspy beside a world of one detector against the world; opens it with HyperSpy where that is installed."""

import sys

import h5py
import numpy as np

world = h5py.File(sys.argv[1])
size, overlap = (int(world["metadata"].attrs[k]) for k in ("tile_size_px", "overlap_px"))
scale, offset = (world["tiles"].attrs[k] for k in ("scale", "offset"))


def stitched(group):
    rows, columns = (int(n) for n in world["metadata"].attrs["grid_shape"])
    step = size - overlap
    image = np.zeros((rows * step + overlap, columns * step + overlap), np.float32)
    for row in range(rows):
        for column in range(columns):
            tile = group[f"{row}_{column}"][()]
            image[row * step : row * step + size, column * step : column * step + size] = tile
    return image


path = sys.argv[1].replace(".h5", ".hspy")
expected = {"HAADF": stitched(world["tiles"]) * scale + offset, "HAADF_clean": stitched(world["clean"])}
with h5py.File(path) as file:
    assert file.attrs["file_format"] == "HyperSpy"
    assert sorted(file["Experiments"]) == sorted(expected)
    for name, group in file["Experiments"].items():
        data = group["data"][()]
        assert data.shape == expected[name].shape
        # tiles overlap, each with its own electrons: inside the first one there is no choice
        inner = slice(0, size - overlap)
        assert np.allclose(data[inner, inner], expected[name][inner, inner], rtol=1e-6, atol=1e-9)
        pixel = 10 * world["metadata"].attrs["pixel_size_nm"]
        assert [group[f"axis-{n}"].attrs["name"] for n in range(2)] == ["y", "x"]
        assert all(abs(group[f"axis-{n}"].attrs["scale"] - pixel) < 1e-9 for n in range(2))
try:
    import hyperspy.api as hs
except ImportError:
    pass
else:
    signals = hs.load(path)
    assert sorted(s.metadata.General.title for s in signals) == sorted(expected)
print(", ".join(sorted(expected)))
