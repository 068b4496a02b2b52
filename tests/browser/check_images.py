"""Looks at the page of `stemgen simulate --html` and compares what it says with the file.

    python check_images.py PAGE.html IMAGES.h5
"""

import sys

import h5py
import numpy as np
from page import Page, bilinear, close
from webdriver import Browser


def main():
    with Browser() as browser, h5py.File(sys.argv[2]) as file:
        page = Page(browser, sys.argv[1])
        names = sorted(file["images"])
        shown = browser.run("return [...document.getElementById('image').options].map((o) => o.value)")
        assert sorted(shown) == names, shown
        for name in names:
            data = file["images"][name]
            (dy, dx), (y0, x0) = data.attrs["sampling_angstrom"], data.attrs["origin_angstrom"]
            browser.run("const s = document.getElementById('image'); s.value = arguments[0]; s.dispatchEvent(new Event('change'))", name)
            for k, thickness in enumerate(data.attrs["thicknesses_angstrom"]):
                browser.run("const s = document.getElementById('thickness'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))", k)
                browser.still()
                assert browser.text("#thickness-value") == f"{thickness:.2f} Å"
                got = page.over(x0 + 3.2 * dx, y0 + 4.1 * dy)
                assert got["pixel"] == "3 4", got
                close(float(got["intensity"]), data[k, 4, 3], 1e-9, f"{name} at {thickness} A")
        a, b = np.array([x0 + dx, y0 + 2 * dy]), np.array([x0 + 6 * dx, y0 + 5 * dy])
        a, b = ((np.round(page.place(*p)) - page.corner) / page.scale for p in (a, b))
        samples, header = page.profile(a, b)
        assert header.startswith('"distance (Å)"') and names[-1] in header, header
        points = a + (b - a) * (samples[:, :1] / np.hypot(*(b - a)))
        expected = bilinear(data[-1].astype(float), (points[:, 0] - x0) / dx, (points[:, 1] - y0) / dy)
        close(samples[:, 1], expected, 2e-3 * expected.max(), "profile")
        log = browser.log()
        assert not log, log
        print(*names)


main()
