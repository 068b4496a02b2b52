"""Looks at the page of `stemgen view RECORDING --html` and compares what it says with the file.

    python check_recording.py PAGE.html RECORDING.h5
"""

import sys

import h5py
from page import Page, close
from webdriver import Browser


def main():
    with Browser() as browser, h5py.File(sys.argv[2]) as file:
        page = Page(browser, sys.argv[1])
        shown = browser.run("return [...document.getElementById('image').options].map((o) => o.value)")
        assert shown == ["recording", "noise-free"], shown
        pixel = file.attrs["pixel_size_nm"]
        frames = file["recording"]
        assert frames.ndim == 3 and len(frames) > 1
        assert browser.text("#series").startswith("number")
        for k, frame in enumerate(frames):
            browser.run("const s = document.getElementById('thickness'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))", k)
            browser.still()
            assert browser.text("#thickness-value") == f"{k} of 0 to {len(frames) - 1}"
            got = page.over(5.2 * pixel, 7.1 * pixel)
            assert got["pixel"] == "5 7", got
            close(float(got["intensity"]), frame[7, 5], 1e-9, f"frame {k}")
        browser.run("const s = document.getElementById('image'); s.value = 'noise-free'; s.dispatchEvent(new Event('change'))")
        browser.still()
        got = page.over(5.2 * pixel, 7.1 * pixel)
        close(float(got["intensity"]), file["ideal"][7, 5], 1e-3 * file["ideal"][()].max(), "noise-free")
        log = browser.log()
        assert not log, log


main()
