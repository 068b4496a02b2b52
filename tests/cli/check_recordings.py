"""Finds in recordings what they were made with, knowing only the file and the formulas of the documentation."""

import sys

import h5py
import numpy as np


def load(name):
    return h5py.File(f"{FOLDER}/{name}", "r")


def near(name, found, expected, error):
    line = f"{name}: {found:.5g} for {expected:.5g}, +- {error:.2g}"
    print(line)
    assert abs(found - expected) <= error, line


def residual(file):
    """Counts less what is expected, over the root of what is expected."""
    expected = file["stages/moved"][0].astype(float) * file.attrs["electrons_per_pixel"]
    return file["recording"][:].astype(float), expected


def dose():
    file = load("ideal.h5")
    counts, expected = residual(file)
    n = counts.size
    near("electrons", counts.sum() / expected.sum(), 1, 4 / np.sqrt(expected.sum()))
    variance = ((counts - expected) ** 2).sum() / expected.sum()
    near("variance over mean", variance, 1, 4 * np.sqrt(2 / n) + 0.01)
    area = (10 * file.attrs["pixel_size_nm"]) ** 2
    near("dose", file.attrs["electrons_per_pixel"] / area, 1e4, 1e-6 * 1e4)
    moved, ideal = file["stages/moved"][0], file["ideal"][:]
    assert np.abs(moved - ideal).max() < 1e-6 * ideal.max()
    near("pA", file.attrs["beam_current_pa"] * 1e-12 * 1e-5 / 1.602176634e-19,
         file.attrs["electrons_per_pixel"], 1e-6 * file.attrs["electrons_per_pixel"])


def dqe():
    counts, expected = residual(load("dqe.h5"))
    variance = ((counts - expected) ** 2).sum() / expected.sum()
    near("DQE", 1 / variance, 0.6, 0.6 * (4 * np.sqrt(2 / counts.size) + 0.01))


def shift(a, b):
    """How far (x, y) in pixels b is moved against a: the slope of the phases of the cross spectrum."""
    window = np.outer(np.hanning(a.shape[0]), np.hanning(a.shape[1]))
    cross = np.fft.fft2((b - b.mean()) * window) * np.conj(np.fft.fft2((a - a.mean()) * window))
    ky, kx = np.meshgrid(np.fft.fftfreq(a.shape[0]), np.fft.fftfreq(a.shape[1]), indexing="ij")
    low = (np.hypot(kx, ky) < 0.2) & (np.abs(cross) > 1e-3 * np.abs(cross).max())
    weight = np.abs(cross[low])
    design = -2 * np.pi * np.stack([kx[low], ky[low]], axis=1)
    found, *_ = np.linalg.lstsq(design * weight[:, None], np.angle(cross[low]) * weight, rcond=None)
    return found


def small_shift(a, b):
    """The same for patches that are moved by little, from the gradient of their mean."""
    gy, gx = np.gradient(0.5 * (a + b))
    inner = (slice(2, -2), slice(2, -2))
    design = np.stack([-gx[inner].ravel(), -gy[inner].ravel()], axis=1)
    found, *_ = np.linalg.lstsq(design, (b - a)[inner].ravel(), rcond=None)
    return found


def drift():
    file = load("drift.h5")
    a, b = file["recording"][:].astype(float)
    lines = file["ground_truth/drift"][:]
    rows = a.shape[0]
    time = lines[rows, 0] - lines[0, 0]
    pixel = file.attrs["pixel_size_nm"]
    found = shift(a, b)
    # The specimen moves, and its image with it.
    for k, speed in enumerate([0.012, -0.008]):
        near(f"drift {'xy'[k]} (nm/s)", found[k] * pixel / time, speed, 0.03 * abs(speed))
        near("the curve", (lines[rows, 1 + k] - lines[0, 1 + k]) / time, speed, 1e-9)


def displacements(file):
    """How far each line is displaced along x, in nm, from the noise-free image."""
    counts = file["recording"][:].astype(float) / file.attrs["electrons_per_pixel"]
    ideal = file["ideal"][:].astype(float)
    pixel = file.attrs["pixel_size_nm"]
    # the derivative, by differences of eighth order
    steps = enumerate([4 / 5, -1 / 5, 4 / 105, -1 / 280], start=1)
    gx = sum(w * (np.roll(ideal, -n, 1) - np.roll(ideal, n, 1)) for n, w in steps) / pixel
    inner = slice(5, -5)
    rows = [np.dot((c - i)[inner], g[inner]) / np.dot(g[inner], g[inner]) for c, i, g in zip(counts, ideal, gx)]
    return np.array(rows)


def hum():
    file = load("hum.h5")
    moved = displacements(file)
    time = file["ground_truth/drift"][:, 0] + 0.5e-6 * file["ideal"].shape[1]
    best = max(np.arange(20, 120, 0.25), key=lambda f: power(moved, time, f))
    amplitude = np.sqrt(power(moved, time, best))
    near("hum (Hz)", best, 50, 2)
    near("hum (A)", 10 * amplitude, 0.05, 0.004)


def power(values, time, frequency):
    """Square of the amplitude of a sine of this frequency, by least squares."""
    wave = 2 * np.pi * frequency * time
    design = np.stack([np.sin(wave), np.cos(wave), np.ones_like(wave)], axis=1)
    found, *_ = np.linalg.lstsq(design, values, rcond=None)
    return found[0] ** 2 + found[1] ** 2


def jitter():
    moved = displacements(load("jitter.h5"))
    # Jitter along y changes lines too, and adds to what is fitted as a displacement along x.
    near("jitter (A)", 10 * moved.std(), 0.05, 0.05 * (4 / np.sqrt(2 * moved.size) + 0.12))


def saturation():
    file = load("saturation.h5")
    counts, expected = residual(file)
    per_pa = file.attrs["dwell_us"] * 1e-18 / 1.602176634e-19
    bright = expected > 0.3 * expected.max()
    current = 1 / np.mean(1 / (counts[bright] / per_pa) - 1 / (expected[bright] / per_pa))
    near("saturation (pA)", current, 40, 0.4)


def afterglow():
    file = load("afterglow.h5")
    counts, expected = residual(file)
    # What comes late is known of the mean too: taken out by the same formulas, what is left is streaks of noise. An electron's
    # light falls as exp(-t / tau) over the pixels that follow, and so does the covariance along a line.
    kept = np.exp(-10 / 15)
    own = 1 - (1 - kept) * 15 / 10
    mean = np.zeros_like(expected)
    stored = 0.0
    for row in range(expected.shape[0]):
        for column in range(expected.shape[1]):
            late = 0.4 * expected[row, column]
            mean[row, column] = expected[row, column] + stored * (1 - kept) - late * (1 - own)
            stored = stored * kept + late * (1 - own)
    noise = counts - mean
    along = [np.mean(noise[:, k:] * noise[:, : noise.shape[1] - k]) for k in range(4)]
    time = -10 / np.log(along[2] / along[1])
    near("afterglow (us)", time, 15, 2.0)
    across = np.mean(noise[1:] * noise[:-1])
    assert abs(across) < 0.03 * along[0], (across, along)


def chain():
    file = load("chain.h5")
    counts, expected = residual(file)
    assert file["recording"].dtype == np.uint16
    design = np.stack([expected.ravel(), np.ones(expected.size)], axis=1)
    (gain, dark), *_ = np.linalg.lstsq(design, counts.ravel(), rcond=None)
    near("gain", gain, 20, 0.3)
    near("dark", dark, 300, 4)
    # variance = gain^2 electrons + read noise^2 + 1/12
    squares = ((counts - 20 * expected - 300) ** 2).ravel()
    (slope, floor), *_ = np.linalg.lstsq(design, squares, rcond=None)
    near("gain from the variance", np.sqrt(slope), 20, 0.6)
    near("read noise", np.sqrt(max(floor, 0)), 30, 8)


def sampled(image, x, y):
    """Values between pixels, by cubic convolution (Keys)."""
    def weights(t):
        return np.array([((-0.5 * t + 1) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1,
                         ((-1.5 * t + 2) * t + 0.5) * t, (0.5 * t - 0.5) * t * t])
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    part = image[y0 - 1 : y0 + 3, x0 - 1 : x0 + 3]
    return weights(y - y0) @ part @ weights(x - x0)


def positions():
    file = load("poor.h5")
    pixel = file.attrs["pixel_size_nm"]
    recording, ideal = file["recording"][:].astype(float), file["ideal"][:].astype(float)
    recording = (recording - 10) / 0.01
    recording *= ideal.mean() / recording.mean()
    places = file["ground_truth/columns/position"][:] / pixel
    seen = file["ground_truth/columns/position_in_image"][:]
    size = np.array(ideal.shape[::-1])
    inside = np.all((places > 8) & (places < size - 9) & (seen > 8) & (seen < size - 9), axis=1)
    offsets = np.arange(-4, 5)
    found = []
    for (x, y), (u, v) in zip(places[inside], seen[inside]):
        a = np.array([[sampled(ideal, x + i, y + j) for i in offsets] for j in offsets])
        if a.max() < 0.5 * ideal.max():
            continue
        b = np.array([[sampled(recording, u + i, v + j) for i in offsets] for j in offsets])
        found.append(small_shift(a, b))
    found = np.array(found)
    moved = np.linalg.norm((seen - places)[inside], axis=1)
    print(f"{len(found)} bright columns, moved by {moved.mean():.2f} px, up to {moved.max():.2f}; "
          f"found within {np.sqrt((found ** 2).mean()):.3f} px rms, mean {found.mean(axis=0)}")
    assert len(found) > 50 and moved.max() > 3
    assert np.sqrt((found ** 2).mean()) < 0.35 and np.abs(found.mean(axis=0)).max() < 0.15


def alike():
    world, again, recipe = load("w1.h5"), load("w2.h5"), load("r.h5")
    assert np.array_equal(world["recording"][:], again["recording"][:])
    a, b = world["stages/moved"][:], recipe["stages/moved"][:]
    print(f"the world's own image and the recipe's: {np.abs(a - b).max() / b.max():.2g} of the maximum")
    # The world was blended from its sub-tiles, and windows are right to 1 % of bright columns or so.
    assert np.abs(a - b).max() < 0.025 * b.max() and abs(a.mean() / b.mean() - 1) < 3e-3
    for name in ["position", "position_in_image", "vacancies"]:
        assert np.array_equal(world[f"ground_truth/columns/{name}"][:], recipe[f"ground_truth/columns/{name}"][:])


def whole(file, group):
    """The image of a world, put together from its tiles; tiles agree where they overlap."""
    rows, columns = file["metadata"].attrs["grid_shape"]
    size, overlap = file["metadata"].attrs["tile_size_px"], file["metadata"].attrs["overlap_px"]
    step = size - overlap
    image = np.full((rows * step + overlap, columns * step + overlap), np.nan)
    for r in range(rows):
        for c in range(columns):
            part = image[r * step : r * step + size, c * step : c * step + size]
            tile = file[f"{group}/{r}_{c}"][:]
            known = ~np.isnan(part)
            assert np.array_equal(part[known], tile[known]), (r, c)
            part[:] = tile
    return image


def world():
    plain, poor = load("plain.h5"), load("poor.h5")
    about = poor["metadata"].attrs
    clean = whole(poor, "clean")
    assert clean.shape == whole(plain, "clean").shape
    fraction = whole(poor, "tiles") * poor["tiles"].attrs["scale"] + poor["tiles"].attrs["offset"]
    counts = fraction * about["counts_of_whole_beam"] + about["counts_of_no_beam"]
    near("counts are whole numbers", np.abs(counts - np.round(counts)).max(), 0, 0.02)
    near("most counts of 8 bits", counts.max(), 128, 127.5)
    valid = poor["valid_region"][:]
    # 0.2 nm/s for 1 s or so: 10 pixels, and scale and shear beside
    print(f"{100 * (1 - valid.mean()):.1f} % of the pixels are not valid")
    assert 0.01 < 1 - valid.mean() < 0.25 and valid[100:150, 100:250].all()
    assert np.all(plain["valid_region"][:])
    assert "acquisition" in about and "acquisition" not in plain["metadata"].attrs
    places = poor["ground_truth/columns/position"][:] / about["pixel_size_nm"]
    seen = poor["ground_truth/columns/position_in_image"][:]
    drift = poor["ground_truth/drift"][:]
    assert seen.shape == places.shape and drift.shape == (clean.shape[0], 3)
    moved = (seen - places).mean(axis=0)
    # the specimen drifts by the mean of the curve
    mean = drift[:, 1:].mean(axis=0) / about["pixel_size_nm"]
    for k in range(2):
        near(f"mean displacement {'xy'[k]} (px)", moved[k], mean[k], 1.5)
    # The recording at the places that are told shows the columns: brighter than its mean.
    u, v = np.round(seen).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < clean.shape[1]) & (v < clean.shape[0])
    heavy = np.array([b"Sr" in c for c in poor["ground_truth/columns/composition"][:]])
    there = inside & heavy
    bright = fraction[v[there], u[there]].mean() / fraction.mean()
    u, v = np.round(places).astype(int).T
    astray = fraction[v[there], u[there]].mean() / fraction.mean()
    print(f"Sr columns: {bright:.2f} of the mean where they appear, {astray:.2f} where they are")
    assert bright > 1.5 and bright > 1.3 * astray


def coarse():
    plain, ideal = load("coarse_plain.h5"), load("coarse.h5")
    a, b = whole(plain, "clean"), whole(ideal, "clean")
    print(f"the image at half the pixel: {np.abs(a - b).max() / a.max():.2g} of the maximum")
    # Windows are right to 1 % of bright columns or so; half a pixel astray would be 40 %.
    assert np.abs(a - b).max() < 0.025 * a.max() and abs(a.mean() / b.mean() - 1) < 3e-3
    fraction = whole(ideal, "tiles") * ideal["tiles"].attrs["scale"] + ideal["tiles"].attrs["offset"]
    electrons = ideal["metadata"].attrs["electrons_per_pixel"]
    squares = ((fraction - b) ** 2).sum() * electrons / b.sum()
    near("variance over mean", squares, 1, 4 * np.sqrt(2 / b.size) + 0.02)
    assert ideal["valid_region"][:].all()


if sys.argv[1] in ("alike", "world", "coarse"):
    FOLDER = sys.argv[2]
    {"alike": alike, "world": world, "coarse": coarse}[sys.argv[1]]()
else:
    FOLDER = sys.argv[1]
    for check in [dose, dqe, drift, hum, jitter, saturation, afterglow, chain, positions]:
        check()
