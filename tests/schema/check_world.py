"""Checks a world file by the published schema: python3 check_world.py WORLD.h5"""

import json
import sys

import h5py
import numpy as np

# Elements, defects, phases, and the element whose columns are bright.
MATERIALS = {
    "srtio3": ({8, 22, 38}, {b"vacancy_O"}, None, 38),
    "batio3": ({8, 22, 56}, {b"vacancy_O"}, {0, 1}, 56),
    "sige": ({14, 32}, {b"substitution_Ge"}, None, 14),
    "gan": ({7, 31, 49}, {b"substitution_In"}, {0, 1}, 31),
    "mos2": ({16, 42}, {b"vacancy_S", b"vacancy_Mo", b"substitution_Mo"}, None, 42),
    "wse2": ({16, 23, 34, 74}, {b"vacancy_Se", b"substitution_V", b"substitution_S"}, None, 74),
    "graphene": ({5, 6, 7, 14}, {b"vacancy_C", b"substitution_Si", b"substitution_N", b"substitution_B"}, None, 6),
    "pt": ({6, 78}, {b"vacancy_Pt"}, None, 78),
}
MATERIALS["test"] = MATERIALS["replay"] = MATERIALS["srtio3"]

faults = []


def check(condition, message):
    if not condition:
        faults.append(message)


def dataset(file, name, shape, dtype):
    if name not in file:
        faults.append(f"{name}: missing")
        return None
    found = file[name]
    check(found.shape == tuple(shape), f"{name}: shape {found.shape}, expected {tuple(shape)}")
    check(found.dtype == np.dtype(dtype), f"{name}: dtype {found.dtype}, expected {dtype}")
    return found


def check_metadata(file):
    m = file["metadata"].attrs
    for name in ["pixel_size_nm", "tile_size_px", "overlap_px", "grid_shape", "fov_nm", "recipe", "seed",
                 "stemgen_version", "engine", "engine_parameters", "dose_electrons_per_angstrom2", "numerics_version",
                 "material", "zone_axis", "noise", "origin_px_in_full_field", "thickness_nm"]:
        check(name in m, f"metadata: no attribute {name}")
    rows, cols = (int(n) for n in m["grid_shape"])
    height, width = 124 * rows + 4, 124 * cols + 4
    check(m["grid_shape"].shape == (2,) and m["fov_nm"].shape == (2,), "grid_shape, fov_nm: not (2,)")
    check(np.issubdtype(type(m["pixel_size_nm"]), np.floating), "pixel_size_nm: not a float scalar")
    check(np.issubdtype(type(m["tile_size_px"]), np.integer), "tile_size_px: not an integer scalar")
    check((m["tile_size_px"], m["overlap_px"]) == (128, 4), "tiles are not 128 px with 4 px overlap")
    check(np.allclose(m["fov_nm"], m["pixel_size_nm"] * np.array([height, width])), "fov_nm is not pixel x shape")
    check(isinstance(m["recipe"], str) and "version = 1" in m["recipe"], "recipe: not a TOML text")
    check(isinstance(json.loads(m["engine_parameters"]), dict), "engine_parameters: not a JSON object")
    check(m["noise"].dtype == np.bool_, "noise: not a bool")
    return rows, cols, height, width, m["pixel_size_nm"]


def check_tiles(file, group, rows, cols):
    check(len(file[group]) == rows * cols, f"{group}: {len(file[group])} tiles of {rows * cols}")
    tiles = {}
    for r in range(rows):
        for c in range(cols):
            tile = dataset(file, f"{group}/{r}_{c}", (128, 128), np.float32)
            check(tile.chunks == (128, 128), f"{tile.name}: chunks {tile.chunks}")
            check(tile.compression == "gzip" and tile.shuffle, f"{tile.name}: not shuffled and deflated")
            tiles[r, c] = tile[...]
            check(np.isfinite(tiles[r, c]).all(), f"{tile.name}: not finite")
    for (r, c), tile in tiles.items():
        if c + 1 < cols:
            check((tile[:, 124:] == tiles[r, c + 1][:, :4]).all(), f"{group}/{r}_{c}: differs from the right")
        if r + 1 < rows:
            check((tile[124:] == tiles[r + 1, c][:4]).all(), f"{group}/{r}_{c}: differs from below")
    return tiles


def stitch(tiles, height, width):
    image = np.zeros((height, width), np.float32)
    for (r, c), tile in tiles.items():
        image[124 * r:124 * r + 128, 124 * c:124 * c + 128] = tile
    return image


def check_overview(file, image):
    height, width = image.shape
    h, w = -(-height // 8), -(-width // 8)
    overview = dataset(file, "overview", (h, w), np.float32)
    padded = np.full((8 * h, 8 * w), np.nan)
    padded[:height, :width] = image
    mean = np.nanmean(padded.reshape(h, 8, w, 8), axis=(1, 3))
    check(np.allclose(overview, mean, atol=1e-6), "overview: not the area average by 8")


def check_sites(file, height, width, pixel):
    truth = file["ground_truth"]
    n = truth["atom_positions"].shape[0]
    xy = dataset(truth, "atom_positions", (n, 2), np.float32)
    types = dataset(truth, "atom_types", (n,), np.int32)[...]
    mask = dataset(truth, "defect_mask", (n,), np.bool_)[...]
    z = dataset(truth, "atom_z", (n,), np.float32)[...]
    numbers = dataset(truth, "atomic_numbers", (n,), np.int32)[...]
    names = dataset(truth, "defect_types", (n,), "S16")[...]
    columns = dataset(truth, "atom_columns", (n,), np.int32)[...]
    for name in ["unit", "origin"]:
        check(name in xy.attrs, f"atom_positions: no attribute {name}")
    xy = xy[...]
    inside = (xy > -0.51 * pixel) & (xy < (np.array([width, height]) - 0.49) * pixel)
    check(inside.all(), "atom_positions: outside the field")
    check(n > 0 and set(types) <= {0, 1, 2} and (mask == (types != 0)).all(), "atom_types, defect_mask: differ")
    check((names[types == 0] == b"").all(), "defect_types: a pristine site has one")
    material = file["metadata"].attrs["material"]
    elements, defects, phases, _ = MATERIALS[material]
    check(set(names[types != 0]) == defects, f"defect_types: {set(names[types != 0])}, expected {defects}")
    for name in set(names[types != 0]):
        check(set(names[types == {b"v": 1, b"s": 2}[name[:1]]]) == {name}, f"{name}: wrong atom_types")
    check(set(numbers) == elements, f"atomic_numbers: not those of {material}")
    check(z.min() > 0 and z.max() < 11, "atom_z: outside the specimen")
    check_columns(truth["columns"], columns, types, xy)
    if phases:
        found = dataset(truth, "phase_map", (height, width), np.int32)
        check(set(np.unique(found)) <= phases and "codes" in found.attrs, "phase_map: wrong values")
    else:
        check("phase_map" not in truth, "phase_map: there is but one phase")


def check_registration(file, image, pixel):
    """Heavy columns are bright where the ground truth says they are, to half a pixel on average."""
    truth = file["ground_truth"]
    heavy = MATERIALS[file["metadata"].attrs["material"]][3]
    sites = truth["atom_positions"][...][truth["atomic_numbers"][...] == heavy]
    near = np.rint(sites / pixel).astype(int)
    height, width = image.shape
    near = near[((near >= 10) & (near < [width - 10, height - 10])).all(axis=1)]
    check(image[near[:, 1], near[:, 0]].mean() > 1.5 * image.mean(), "columns are not bright: x, y or origin differ")
    reach = int(0.13 / pixel)
    steps = np.arange(-reach, reach + 1)
    patches = image[near[:, 1, None, None] + steps[:, None], near[:, 0, None, None] + steps]
    mean = patches.mean(axis=0) - patches.mean(axis=0).min()
    mean = np.where(mean > 0.6 * mean.max(), mean, 0)
    shift = np.array([(mean.sum(axis=0) * steps).sum(), (mean.sum(axis=1) * steps).sum()]) / mean.sum()
    check((abs(shift) < 0.5).all(), f"the image is shifted by {shift} px against the ground truth")


def check_columns(group, columns, types, xy):
    m = group["position"].shape[0]
    position = dataset(group, "position", (m, 2), np.float32)[...]
    check(columns.min() == 0 and columns.max() == m - 1, "atom_columns: not indices of columns")
    mean = np.stack([np.bincount(columns, weights=xy[:, k]) for k in (0, 1)], axis=1)
    mean /= np.bincount(columns)[:, None]
    check(np.allclose(position, mean, atol=1e-5), "columns/position: not the mean of the sites")
    for name, members in [("number_of_sites", types >= 0), ("vacancies", types == 1), ("substitutions", types == 2)]:
        counts = dataset(group, name, (m,), np.int32)[...]
        check((counts == np.bincount(columns[members], minlength=m)).all(), f"columns/{name}: wrong counts")
    composition = dataset(group, "composition", (m,), "S32")[...]
    check(composition[0].decode()[0].isalpha(), "columns/composition: empty")


def main(path):
    with h5py.File(path, "r") as file:
        rows, cols, height, width, pixel = check_metadata(file)
        tiles = check_tiles(file, "tiles", rows, cols)
        image = stitch(tiles, height, width)
        check(image.min() == 0 and image.max() == 1, "tiles: not scaled to [0, 1]")
        scale, offset = file["tiles"].attrs["scale"], file["tiles"].attrs["offset"]
        if "clean" in file:
            clean = stitch(check_tiles(file, "clean", rows, cols), height, width)
            error = image * scale + offset - clean
            sigma = np.sqrt(clean.mean() / (file["metadata"].attrs["dose_electrons_per_angstrom2"] * (10 * pixel)**2))
            check(abs(error.std() / sigma - 1) < 0.05, f"noise {error.std()}, expected {sigma}")
            check(abs(error.mean()) < 5 * sigma / np.sqrt(image.size), "noise: its mean is not 0")
        check_overview(file, image)
        check_registration(file, image * scale + offset, pixel)
        check_sites(file, height, width, pixel)
        valid = dataset(file, "valid_region", (height, width), np.bool_)
        check(valid[...].all(), "valid_region: not all true")
        for group, names in [("grain_boundaries", {"misorientation_deg", "sigma"}),
                             ("phase_boundaries", {"left", "right", "sharpness_sigma_nm"})]:
            for line in file["ground_truth"][group].values():
                check(line.dtype == np.float32 and line.shape[1:] == (2,), f"{line.name}: not a polyline")
                check(line.attrs["unit"] == "nm" and set(line.attrs) == names | {"unit"}, f"{line.name}: attributes")


main(sys.argv[1])
print("\n".join(faults) or "the schema holds")
sys.exit(bool(faults))
