"""What a series of recordings of a specimen that loses oxygen must hold: arguments are its file and its animation."""

import json
import sys

import h5py
import numpy as np

f = h5py.File(sys.argv[1])
assert f['recording'].shape == f['series/ideal'].shape == (3, 128, 128)
assert f['recording'].dtype == np.uint16, f['recording'].dtype
dose = f['series/dose_before'][:]
assert dose[0] == 0 and abs(dose[1] / 2e5 - 1) < 0.05 and abs(dose[2] / 4e5 - 1) < 0.05, dose
vacant = f['series/vacancies'][:]
assert (vacant[0] == f['ground_truth/columns/vacancies'][:]).all()
assert (np.diff(vacant, axis=0) >= 0).all() and vacant[2].sum() > vacant[0].sum()
lost = f['series/lost/O'][:]
assert lost.sum() == sum(h['lost'].get('O', 0) for h in json.loads(f['series'].attrs['history']))
# columns at the edge are lost outside the first image, or beyond the first pixels
assert lost[:2].sum() >= vacant[2].sum() - vacant[0].sum() > 0
ideal = f['series/ideal'][:]
assert not np.array_equal(ideal[0], ideal[2]) and np.abs(ideal[2] - ideal[0]).max() < 0.5 * ideal[0].max()
assert np.array_equal(f['ideal'][:], ideal[0])
axes = [a.decode() if isinstance(a, bytes) else a for a in f['entry/recording'].attrs['axes']]
assert axes == ['recording', 'y', 'x'], axes
png = open(sys.argv[2], 'rb').read()
assert png.startswith(b'\x89PNG') and b'acTL' in png and png.count(b'fcTL') == 3
