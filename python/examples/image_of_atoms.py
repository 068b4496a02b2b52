"""An image of atoms: from ASE to a file for HyperSpy."""

from ase.build import bulk

import stemworlds as sw

atoms = bulk("Au", cubic=True) * (4, 4, 5)
plan = sw.plan_simulation(atoms, phonons=2, sigma=0.08)
print(f"{plan.probes} probes, {plan.memory_bytes / 1e6:.0f} MB")

scan = sw.Scan(end=(0.25, 0.25), points=(12, 12))
images = sw.simulate(atoms, detectors={"HAADF": (68, 200), "BF": (0, 20)}, phonons=2, sigma=0.08, scan=scan, dose=1e4)
haadf = images["HAADF"]
dy, dx = haadf.sampling_nm
print(f"{haadf.name}: {haadf.array.shape}, {dx:.4f} nm per pixel, up to {haadf.array.max():.3f} of the beam")
images.to_hspy("gold.hspy")
