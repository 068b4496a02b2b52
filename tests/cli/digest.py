"""Prints a digest of every dataset of HDF5 files, so that files can be compared."""
import hashlib
import sys

import h5py
import numpy as np

for name in sys.argv[1:]:
    with h5py.File(name) as f:
        found = {}
        f.visititems(lambda n, o: found.update({n: o}) if isinstance(o, h5py.Dataset) else None)
        for key in sorted(found):
            data = np.ascontiguousarray(found[key][()])
            print(key, data.shape, data.dtype, hashlib.sha256(data.tobytes()).hexdigest())
