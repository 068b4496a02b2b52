"""Explores the page of a world as a user would, and compares what it says with the file.

    python check_world.py PAGE.html WORLD.h5 [FOLDER]

leaves screenshots in FOLDER.
"""

import sys

import h5py
import numpy as np
from page import Page, bilinear, close
from webdriver import Browser

# As in the page.
COLUMN_RADIUS_NM, RING_NM, CELL_NM = 0.06, 0.085, 4
VACANCY, CYAN, YELLOW, PHASE_1 = (213, 94, 0), (86, 220, 233), (240, 228, 66), (0, 114, 178)


class World:
    """The parts of a file that the page shows."""

    def __init__(self, path):
        self.file = h5py.File(path)
        meta = self.file["metadata"].attrs
        self.pixel, self.tile, overlap = meta["pixel_size_nm"], meta["tile_size_px"], meta["overlap_px"]
        self.dose = meta["dose_electrons_per_angstrom2"]
        self.grid, self.stride = meta["grid_shape"], self.tile - overlap
        self.stored = self.stitch("tiles")
        tiles = self.file["tiles"].attrs
        self.scale, self.offset = tiles["scale"], tiles["offset"]
        self.noisy = self.stored * self.scale + self.offset
        self.clean = self.stitch("clean")
        self.truth = self.file["ground_truth"]
        columns = self.truth["columns"]
        self.positions = columns["position"][:].astype(float)
        self.counts = [columns[name][:] for name in ["number_of_sites", "vacancies", "substitutions"]]
        self.compositions = columns["composition"][:].astype(str)

    def stitch(self, group):
        rows, columns = self.grid * self.stride + (self.tile - self.stride)
        image = np.zeros((rows, columns))
        for r in range(self.grid[0]):
            for c in range(self.grid[1]):
                y, x = r * self.stride, c * self.stride
                image[y : y + self.tile, x : x + self.tile] = self.file[f"{group}/{r}_{c}"][:]
        return image

    def inside(self, positions, margin_nm):
        high = np.array(self.stored.shape[::-1]) * self.pixel - margin_nm
        return np.all((positions > margin_nm) & (positions < high), axis=1)

    def lonely(self, wanted, margin_nm=0.6):
        """Index of a wanted column near the middle with no other within 0.1 nm."""
        middle = np.array(self.stored.shape[::-1]) * self.pixel / 2
        order = np.argsort(np.linalg.norm(self.positions - middle, axis=1))
        for index in order[(wanted & self.inside(self.positions, margin_nm))[order]]:
            if np.sum(np.linalg.norm(self.positions - self.positions[index], axis=1) < 0.1) == 1:
                return index
        raise AssertionError("no such column")

    def disc(self, image, position):
        rows, columns = np.indices(image.shape)
        distance = np.hypot(columns * self.pixel - position[0], rows * self.pixel - position[1])
        return image[distance <= COLUMN_RADIUS_NM].mean()


def check_opening(page, world):
    """A page opens with the whole field as large as it fits, what the truth marks, and no empty panel."""
    assert page.empty_panel < 5, page.empty_panel
    rows, columns = world.stored.shape
    room = [(page.width - 52) / (columns * world.pixel), (page.height - 24) / (rows * world.pixel)]
    close(page.scale[0] / min(room), 1.0, 0.01, "the field fills the view")
    run = page.browser.run
    there = run("return [...document.querySelectorAll('#overlays button')].map((b) => b.textContent)")
    pressed = run("return [...document.querySelectorAll('#overlays [aria-pressed=true]')].map((b) => b.textContent)")
    marks = [name for name in there if name not in ("phases", "columns")]
    assert pressed == (marks or there) and "columns" in there, (pressed, there)
    for name in pressed:
        page.toggle(name)


def check_values(page, world):
    """Values under the pointer, with the whole field on the screen and near."""
    rows, columns = world.stored.shape
    electrons = world.dose * (10 * world.pixel) ** 2
    for zoom, places in [(0, [(0.3, 0.2), (0.9, 0.7), (0.51, 0.5)]), (120, [(0.51, 0.5)])]:
        if zoom:
            page.zoom_to(0.5 * columns * world.pixel, 0.5 * rows * world.pixel, zoom)
        for across, down in places:
            x, y = across * columns * world.pixel, down * rows * world.pixel
            got = page.over(x, y)
            i, j = map(int, got["pixel"].split())
            close(np.array([i, j]) * world.pixel, [x, y], 0.5 * world.pixel + 0.8 / page.scale[0], "pixel under the pointer")
            close(float(got["stored"]), world.stored[j, i], 1e-7, "stored value")
            close(float(got["intensity"]), world.noisy[j, i], 1e-7, "intensity")
            close(float(got["electrons"]), round(world.noisy[j, i] * electrons), 0.01, "electrons")
            close(float(got["other"]), world.clean[j, i], 3e-4 * world.clean.max(), "noise-free value")
            r, c = (min(k // world.stride, n - 1) for k, n in zip((j, i), world.grid))
            assert got["tile"] == f"{r}_{c}", got


def check_column(page, world, index):
    """The truth of a column, and that a click holds it."""
    x, y = world.positions[index]
    page.zoom_to(x, y, 250)
    got = page.over(x + 0.02, y)
    close(np.array(got["column"].split(), float), [x, y], 6e-4, "position of the column")
    assert got["composition"] == world.compositions[index], got
    for name, counts in zip(["sites", "vacancies", "substitutions"], world.counts):
        assert int(got[name]) == counts[index], (name, got)
    close(float(got["mean"]), world.disc(world.noisy, (x, y)), 1e-6, "mean of the column")
    mine = world.truth["atom_columns"][:] == index
    defects = mine & world.truth["defect_mask"][:]
    if defects.any():
        depths = [float(v) for v in got["depths"].split(",")]
        close(sorted(depths), np.sort(world.truth["atom_z"][:][defects]), 0.006, "depths")
    held = got["position"]
    page.browser.act(page.browser.pointer(("down",), ("up",)))
    assert page.at(page.x + 200, page.y + 200)["position"] == held, "a click holds the readout"
    page.browser.key("escape")
    assert page.at(page.x + 200, page.y + 200)["position"] != held, "Esc frees it"


def near(color, wanted, tolerance):
    return np.abs(color - np.array(wanted)).max() <= tolerance


def ring(page, x, y, radius_nm):
    """Colours on a circle."""
    angles = np.arange(0, 2 * np.pi, np.pi / 12)
    return [page.color(x + radius_nm * np.cos(a), y + radius_nm * np.sin(a)) for a in angles]


def check_overlays(page, world, column):
    x, y = world.positions[column]
    page.zoom_to(x, y, 250)
    page.away()
    cells = np.unique(np.floor((world.positions - np.floor(world.positions.min(axis=0))) / CELL_NM), axis=0)
    density = len(world.positions) / (len(cells) * CELL_NM**2)
    radius = min(RING_NM, 0.42 / density**0.5)
    before = ring(page, x, y, radius)
    for name, color in [("columns", CYAN), ("defects", VACANCY)]:
        if name == "defects" and world.counts[1][column] == 0:
            continue
        page.toggle(name)
        pressed = page.browser.run(f"return document.getElementById('overlay-{name}').getAttribute('aria-pressed')")
        assert pressed == "true", name
        moved = [np.abs(a - b).max() for a, b in zip(ring(page, x, y, radius), before)]
        assert np.median(moved) > 40, f"{name}: no ring, {moved}"
        toward = [np.dot(a - b, np.array(color) - b) for a, b in zip(ring(page, x, y, radius), before)]
        assert np.median(toward) > 0, f"{name}: a ring of another colour"
        page.toggle(name)
        assert all(near(a, b, 2) for a, b in zip(ring(page, x, y, radius), before)), f"{name} goes away"
    text = page.browser.text("#side")
    assert str(world.truth["atom_types"].shape[0]) in text, "number of sites"


def check_phases(page, world):
    if "phase_map" not in world.truth:
        assert not page.browser.run("return document.getElementById('overlay-phases')"), "no phases, no button"
        return
    page.browser.key("0")
    page.browser.still()
    page.calibrate()
    phases = world.truth["phase_map"][:]
    for code in [0, 1]:
        # The pixel that lies deepest in the phase, along x.
        row = phases.shape[0] // 2
        runs = np.split(np.arange(phases.shape[1]), np.flatnonzero(np.diff(phases[row])) + 1)
        run = max((r for r in runs if phases[row, r[0]] == code), key=len)
        x, y = run[len(run) // 2] * world.pixel, row * world.pixel
        name = world.truth["phase_map"].attrs["codes"].split(", ")[code].split(" ", 1)[1]
        assert page.over(x, y)["phase"] in (name, str(code)), name
        page.away()
        before = page.color(x, y)
        page.toggle("phases")
        after = page.color(x, y)
        page.toggle("phases")
        expected = before + 0.3 * (np.array(PHASE_1) - before) * code
        assert near(after, expected, 3), f"phase {code}: {before} became {after}, not {expected}"


def check_lines(page, world):
    """Boundaries and particles are yellow lines where the file has them."""
    page.browser.key("0")
    page.browser.still()
    page.calibrate()
    lines = [
        (name, world.truth[f"{name}/{key}"][:]) for name in ["grain_boundaries", "phase_boundaries"] for key in world.truth[name]
    ]
    places = [("boundaries", (line[0] + line[-1]) / 2) for name, line in lines if len(line) == 2]
    if "particles" in world.truth:
        particles = world.truth["particles"]
        angles = np.linspace(0, 2 * np.pi, 30)
        rim = np.stack([np.cos(angles), np.sin(angles)], 1) * particles["diameter"][0] / 2 + particles["centre"][0, :2]
        seen = rim[world.inside(rim, 0.1)]
        places += [("particles", p) for p in seen[:3]]
    for name, (x, y) in places:
        page.toggle(name)
        color = page.color(x, y)
        page.toggle(name)
        assert near(color, YELLOW, 70), f"{name} at {x}, {y}: {color}"
    return len(places)


def check_profile(page, world):
    rows, columns = world.stored.shape
    middle = np.array([columns, rows]) * world.pixel / 2
    page.zoom_to(*middle, 60)
    # Ends on whole CSS pixels, as the pointer has them.
    a, b = ((np.round(page.place(*(middle + d))) - page.corner) / page.scale for d in ([-1.3, -0.4], [1.1, 0.5]))
    samples, header = page.profile(a, b)
    assert header.startswith('"distance (nm)"') and "fraction of the incident beam" in header, header
    length = np.hypot(*(b - a))
    close(samples[-1, 0], length, 1e-3, "length")
    points = (a + (b - a) * (samples[:, :1] / length)) / world.pixel
    close(samples[:, 1], bilinear(world.noisy, *points.T), 1e-3 * world.noisy.max(), "profile")
    close(samples[:, 2], bilinear(world.clean, *points.T), 1e-3 * world.clean.max(), "noise-free profile")
    labels = page.browser.run("return [...document.querySelectorAll('#plot .label-x, #plot .label-y')].map((t) => t.textContent)")
    assert labels == ["distance (nm)", "fraction of beam"], labels
    curve = page.browser.run("return document.querySelectorAll('#plot polyline').length")
    assert curve == 2, "a curve of each image"
    # The mean over five pixels across.
    page.browser.run("const w = document.getElementById('profile-width'); w.value = 5; w.dispatchEvent(new Event('change'))")
    wide = page.curves()[0]
    aside = np.array([-(b - a)[1], (b - a)[0]]) / length
    lines = [bilinear(world.noisy, *(points + k * aside).T) for k in (-2, -1, 0, 1, 2)]
    close(wide[:, 1], np.mean(lines, axis=0), 1e-3 * world.noisy.max(), "profile of five pixels")
    page.browser.click("#profile-close")


def check_controls(page, world):
    browser = page.browser
    browser.key("0")
    browser.still()
    page.calibrate()
    rows, columns = world.stored.shape
    at = (0.4 * columns * world.pixel, 0.4 * rows * world.pixel)
    # The other image.
    browser.run("const s = document.getElementById('image'); s.value = 'noise-free'; s.dispatchEvent(new Event('change'))")
    browser.still()
    got = page.over(*at)
    i, j = map(int, got["pixel"].split())
    close(float(got["intensity"]), world.clean[j, i], 3e-4 * world.clean.max(), "noise-free image")
    browser.key("n")
    browser.still()
    # Contrast: the ends of single pixels' values.
    page.zoom_to(*at, 150)
    browser.run("for (const [id, v] of [['low', 0], ['high', 100]]) document.getElementById(id).value = v; document.getElementById('low').dispatchEvent(new Event('change'))")
    browser.still()
    close(page.ends(), [world.noisy.min(), world.noisy.max()], 1e-6, "limits of contrast")
    browser.click("#lock")
    browser.key("n")
    browser.still()
    close(page.ends(), [world.noisy.min(), world.noisy.max()], 1e-6, "limits that are locked, of the other image")
    browser.click("#lock")
    browser.still()
    assert page.ends()[1] < 0.99 * world.noisy.max(), "limits of its own"
    browser.key("n")
    browser.still()
    # Colours: the place of a pixel on the bar is its value.
    page.away()
    x, y = i * world.pixel, j * world.pixel
    fraction = (world.noisy[j, i] - world.noisy.min()) / np.ptp(world.noisy)
    bar = "return [...document.querySelector('#colorbar canvas').getContext('2d').getImageData(arguments[0], 0, 1, 1).data]"
    for _ in range(4):
        wanted = browser.run(bar, int(round(255 * fraction)))[:3]
        assert near(page.color(x, y), wanted, 2), f"{page.color(x, y)} for {wanted}"
        browser.key("m")
        browser.still()
    # Keys and a finger move the view; the lengths stay right.
    scale = page.scale[0]
    browser.key("+")
    browser.still()
    page.calibrate()
    close(page.scale[0] / scale, 1.6, 0.02, "zoom by key")
    bar = browser.run("const b = document.getElementById('scalebar'); return [Number(b.dataset.length), b.children[1].getBoundingClientRect().width]")
    close(bar[1] / bar[0], page.scale[0], 0.01 * page.scale[0], "scale bar")
    corner = page.corner.copy()
    middle = (page.x + page.width / 2, page.y + page.height / 2)
    finger = [("move", *middle), ("down",), ("move", middle[0] + 90, middle[1] - 40, 100), ("up",)]
    browser.act(browser.pointer(*finger, kind="touch", name="finger"))
    browser.still()
    browser.key("escape")
    page.calibrate()
    close(page.corner - corner, [90, -40], 1.5, "moved by a finger")
    spread = [
        browser.pointer(("move", middle[0] + s * 60, middle[1]), ("down",), ("move", middle[0] + s * 120, middle[1], 150), ("up",), kind="touch", name=f"finger{s}")
        for s in (-1, 1)
    ]
    scale = page.scale[0]
    browser.act(*spread)
    browser.still()
    page.calibrate()
    assert 1.6 < page.scale[0] / scale < 2.4, f"pinch: {page.scale[0] / scale}"
    before = browser.run("return getComputedStyle(document.body).backgroundColor")
    browser.click("#theme")
    assert browser.run("return getComputedStyle(document.body).backgroundColor") != before, "light and dark"


def main():
    path, world = sys.argv[1], World(sys.argv[2])
    folder = sys.argv[3] if len(sys.argv) > 3 else None
    with Browser() as browser:
        page = Page(browser, path)
        check_opening(page, world)
        check_values(page, world)
        sites, vacancies, substitutions = world.counts
        defective = world.lonely((vacancies + substitutions > 0) & (sites > 1))
        check_column(page, world, defective)
        check_overlays(page, world, defective)
        if folder:
            browser.screenshot(f"{folder}/near.png")
        check_phases(page, world)
        lines = check_lines(page, world)
        check_profile(page, world)
        check_controls(page, world)
        log = browser.log()
        assert not log, f"the page complains: {log}"
    print(f"{len(world.positions)} columns, {lines} lines")


main()
