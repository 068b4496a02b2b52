"""Prints type and shape of exit waves, and checks that each wave holds nearly the whole beam."""

import sys

import numpy as np

waves = np.load(sys.argv[1])
power = (np.abs(waves) ** 2).sum(axis=(-1, -2))
assert power.min() > 0.98 and power.max() < 1.0001, (power.min(), power.max())
# Waves of another position, focus or configuration are other waves.
flat = waves.reshape(-1, *waves.shape[-2:])
assert all(np.abs(a - b).max() > 1e-3 for i, a in enumerate(flat) for b in flat[:i])
print(waves.dtype, waves.shape)
