"""Adds 1 to one value of a file of patterns: python3 change_pattern.py FILE.emd"""

import sys

import h5py

with h5py.File(sys.argv[1], "r+") as file:
    file["datacube_root/datacube/data"][0, 0, 3, 4] += 1
