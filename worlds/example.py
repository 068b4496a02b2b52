"""Reads a world: python3 worlds/example.py WORLD.h5"""
import sys

import h5py
import numpy as np

with h5py.File(sys.argv[1]) as world:
    about = world["metadata"].attrs
    rows, columns = about["grid_shape"]
    size, overlap, pixel = about["tile_size_px"], about["overlap_px"], about["pixel_size_nm"]
    # Tiles hold values from 0 to 1; the attributes lead back to fractions of the beam.
    tiles = world["tiles"]
    step = size - overlap
    image = np.zeros([step * rows + overlap, step * columns + overlap])
    for row in range(rows):
        for column in range(columns):
            values = tiles[f"{row}_{column}"][()] * tiles.attrs["scale"] + tiles.attrs["offset"]
            image[step * row :, step * column :][:size, :size] = values
    # Electrons counted in each pixel (of a world with noise), from the dose per square Angstrom.
    electrons_per_pixel = about["dose_electrons_per_angstrom2"] * (10 * pixel) ** 2
    counts = np.rint(image * electrons_per_pixel).astype(int)
    # The truth: one row for each atomic column.
    truth = world["ground_truth/columns"]
    x, y = truth["position"][()].T / pixel  # in pixels: image[round(y), round(x)]
    print(f"{image.shape[0]} x {image.shape[1]} pixels, {counts.sum()} electrons")
    print(f"{len(x)} columns, {int(truth['vacancies'][()].sum())} vacant sites")
