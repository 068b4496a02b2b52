"""Changes one pixel of the first image of a file."""

import sys

import h5py

with h5py.File(sys.argv[1], "r+") as file:
    image = next(iter(file["images"].values()))
    image[0, 1, 2] *= 1.0001
