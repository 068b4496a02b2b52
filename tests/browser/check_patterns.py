"""Looks at the page of `stemgen view PATTERNS.emd --html` and compares what it says with the file, and with the images of `stemgen integrate`.

    python check_patterns.py PAGE.html PATTERNS.emd IMAGES.h5 [SCREENSHOT.png]

IMAGES.h5 holds the images ring (15-32.5 mrad), com_x and com_y.
"""

import sys

import h5py
import numpy as np
from page import close
from webdriver import Browser


class PatternPage:
    def __init__(self, browser, path):
        self.browser = browser
        browser.open(path)
        browser.still()
        self.scan, self.pattern = map(self.rect, ["scan", "pattern"])

    def rect(self, name):
        script = "const r = document.getElementById(arguments[0]).getBoundingClientRect(); return [r.x, r.y, r.width, r.height]"
        return np.array(self.browser.run(script, name))

    def readout(self, element="readout"):
        script = (
            "return Object.fromEntries([...document.querySelectorAll('#' + arguments[0] + ' dd')]"
            ".map((d) => [d.dataset.key, d.dataset.value]))"
        )
        self.browser.still()
        return self.browser.run(script, element)

    def choose(self, name, value):
        script = "const s = document.getElementById(arguments[0]); s.value = arguments[1]; s.dispatchEvent(new Event('change'))"
        self.browser.run(script, name, value)
        self.browser.still()


def main():
    page_path, patterns_path, images_path = sys.argv[1:4]
    with Browser() as browser, h5py.File(patterns_path) as file, h5py.File(images_path) as images:
        page = PatternPage(browser, page_path)
        data = file["datacube_root/datacube/data"][:].astype(float)
        rows, columns, pixels, _ = data.shape
        most = file.attrs["max_angle_mrad"]
        dx, dy = file.attrs["step_angstrom"]
        # The image fills the width or the height of its canvas.
        x, y, w, h = page.scan
        width = min(w, h * columns * dx / (rows * dy))
        cell = width / columns, width * rows * dy / (columns * dx) / rows
        probe = lambda column, row: (x + (column + 0.5) * cell[0], y + (row + 0.5) * cell[1])
        side = min(page.pattern[2:])
        place = lambda mrad_x, mrad_y: [
            page.pattern[k] + side * ((mrad + most) / (2 * most) + 0.5 / pixels) for k, mrad in enumerate((mrad_x, mrad_y))
        ]
        browser.hover(*probe(2, 1))
        got = page.readout()
        assert got["probe"] == "2 1", got
        origin = file.attrs["origin_angstrom"]
        close(np.array(got["position"].split(), float), [origin[0] + 2 * dx, origin[1] + dy], 1e-9, "position")
        # A click holds the probe; then the pattern can be read.
        browser.click("#scan")
        browser.act(browser.pointer(("move", *probe(2, 1)), ("down",), ("up",)))
        browser.hover(*place(10, -5))
        got = page.readout()
        held = got["probe"].split()
        kx, ky = np.array(got["angle"].split(), float)
        i, j = (round(k / (2 * most / pixels)) + pixels // 2 for k in (ky, kx))
        assert abs(kx - 10) <= most / pixels and abs(ky + 5) <= most / pixels, got
        expected = data[int(held[1]), int(held[0]), i, j]
        close(float(got["intensity"]), expected, 2e-4 * expected, "intensity")
        # Angles that are typed in, then every image at every probe.
        for name, mrad in [("inner", "15"), ("outer", "32.5"), ("inner", "15")]:
            browser.type(f"#{name}", mrad)
            browser.run("document.activeElement.blur()")
        assert page.readout("detector")["angles"] == "15 32.5", page.readout("detector")
        browser.key("escape")
        for choice, name, tolerance in [("detector", "ring", 4e-3), ("com_x", "com_x", 2e-3), ("com_y", "com_y", 2e-3)]:
            page.choose("image", choice)
            image = images[f"images/{name}"][0]
            for row in range(rows):
                for column in range(columns):
                    browser.hover(*probe(column, row))
                    got = page.readout()
                    assert got["probe"] == f"{column} {row}", got
                    close(float(got["value"]), image[row, column], tolerance * np.abs(image).max(), f"{name} at {column}, {row}")
        # A disc that is drawn away from the axis, its edge then dragged outwards.
        a, b, c = place(30, 0), place(38, 0), place(42, 0)
        browser.act(browser.pointer(("move", *a), ("down",), ("move", *b, 60), ("up",)))
        got = page.readout("detector")
        close(np.array(got["centre"].split(), float), [30, 0], 2 * most / side, "centre")
        close(np.array(got["angles"].split(), float), [0, 8], 2 * most / side, "disc")
        browser.act(browser.pointer(("move", *b), ("down",), ("move", *c, 60), ("up",)))
        close(np.array(page.readout("detector")["angles"].split(), float), [0, 12], 4 * most / side, "larger disc")
        # The usual detectors lie on the axis.
        browser.click("#usual-ABF")
        got = page.readout("detector")
        semiangle = file.attrs["semiangle_mrad"]
        close(np.array(got["angles"].split(), float), [semiangle / 2, semiangle], 1e-9, "ABF")
        close(np.array(got["centre"].split(), float), [0, 0], 1e-9, "on the axis")
        if len(sys.argv) > 4:
            browser.screenshot(sys.argv[4])
        log = browser.log()
        assert not log, log
        print(rows, columns, pixels)


main()
