"""A page opens as the options of `stemgen view` say.

    python check_start.py PAGE.html X0,Y0,X1,Y1 COLOURS LOW,HIGH OVERLAY,...
"""

import sys

from page import Page, close
from webdriver import Browser

path, region, colors, contrast, overlays = sys.argv[1:]
x0, y0, x1, y1 = map(float, region.split(","))
with Browser() as browser:
    page = Page(browser, path)
    # Rulers stand left of and below the image.
    left, bottom = page.x + 52, page.y + page.height - 24
    middle = [(left + page.x + page.width) / 2, (page.y + bottom) / 2]
    close(page.place((x0 + x1) / 2, (y0 + y1) / 2), middle, 1.5, "middle of the region")
    fits = min((page.x + page.width - left) / (x1 - x0), (bottom - page.y) / (y1 - y0))
    close(page.scale[0] / fits, 1.0, 0.01, "the region fills the view")
    value = "return document.getElementById(arguments[0]).value"
    assert browser.run(value, "colormap") == colors
    assert [float(browser.run(value, k)) for k in ("low", "high")] == [float(v) for v in contrast.split(",")]
    pressed = browser.run("return [...document.querySelectorAll('#overlays [aria-pressed=true]')].map((b) => b.textContent)")
    assert sorted(pressed) == sorted(overlays.split(",")), pressed
