"""Names the images of a file that are those of another, to 1e-5 of each pixel: python3 compare_images.py A.h5 B.h5

A holds one thickness, the last of B."""

import sys

import h5py
import numpy as np

with h5py.File(sys.argv[1]) as a, h5py.File(sys.argv[2]) as b:
    names = list(a["images"])
    assert names
    for name in sorted(names, reverse=True):
        ours, theirs = a["images"][name][0], b["images"][name][-1]
        assert ours.shape == theirs.shape, (ours.shape, theirs.shape)
        off = abs(ours / theirs - 1).max()
        assert off < 1e-5, f"{name}: {off}"
    print(*sorted(names, reverse=True))
