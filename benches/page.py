"""Measures a page of `stemgen view --html` in headless Chromium: size, opening, frames while panning and zooming.

    python benches/page.py world.html [--rounds 3]

Prints medians and the slowest; times in ms. "first" is the first picture, "truth" when columns can be read, "sharp" when
everything that is seen is there, each from the start of the navigation. Chromium draws without a GPU here.
"""

import argparse
import os
import statistics
import sys

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "../tests/browser"))
from webdriver import Browser  # noqa: E402

RECORD = """
window.frames_ = []; let last = performance.now();
const tick = (now) => { window.frames_.push(now - last); last = now; if (window.recording) requestAnimationFrame(tick); };
window.recording = true; requestAnimationFrame(tick);
"""
MARKS = "return Object.fromEntries(performance.getEntriesByType('mark').map((m) => [m.name.slice(8), m.startTime]))"


def frames(browser, gesture):
    """Times between frames in ms during a gesture."""
    browser.run(RECORD)
    gesture()
    times = browser.run("window.recording = false; return window.frames_")[2:]
    return times


def describe(times):
    times = sorted(times)
    late = sum(t > 34 for t in times) / len(times)
    return f"median {statistics.median(times):5.1f}  95 % {times[int(0.95 * len(times))]:5.1f}  longest {times[-1]:5.1f}  over 34 ms {late:4.0%}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page")
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    print(f"{arguments.page}: {os.path.getsize(arguments.page) / 1e6:.1f} MB")
    opened = []
    for _ in range(arguments.rounds):
        with Browser() as browser:
            browser.open(arguments.page)
            browser.still()
            browser.wait("return performance.getEntriesByName('stemgen-truth').length || !document.querySelector('#overlay-columns')", "the truth")
            opened.append(browser.run(MARKS) | {"loaded": browser.run("return performance.timing.loadEventEnd - performance.timing.navigationStart")})
    for name in ["first-paint", "truth", "sharp", "loaded"]:
        times = [o[name] for o in opened if name in o]
        if times:
            print(f"{name:12} median {statistics.median(times):6.0f}  longest {max(times):6.0f}")
    with Browser() as browser:
        browser.open(arguments.page)
        browser.still()
        x, y, width, height = browser.run("const r = document.getElementById('field').getBoundingClientRect(); return [r.x, r.y, r.width, r.height]")
        middle = (x + width / 2, y + height / 2)
        for overlays in [[], ["defects"], ["defects", "columns", "phases", "boundaries", "particles"]]:
            for name in overlays:
                pressed = f"const b = document.getElementById('overlay-{name}'); return b && b.getAttribute('aria-pressed')"
                if browser.run(pressed) == "false":
                    browser.click(f"#overlay-{name}")
            browser.key("0")
            for turns in [0, 4, 4, 5]:
                for _ in range(turns):
                    browser.wheel(*middle, -150)
                browser.still()
                bar = browser.text("#scalebar")
                path = [("move", x + 0.85 * width, middle[1]), ("down",)]
                path += [("move", x + 0.15 * width, y + 0.3 * height, 900), ("move", x + 0.8 * width, y + 0.8 * height, 900), ("up",)]
                times = frames(browser, lambda: browser.act(browser.pointer(*path)))
                print(f"pan   {'+'.join(overlays) or 'image only':20.20} bar {bar:7} {describe(times)}")
                browser.still()
        browser.key("0")
        browser.still()

        def zoom():
            for amount in [-150] * 12 + [150] * 12:
                browser.wheel(*middle, amount)

        print(f"zoom  all overlays {'':20} {describe(frames(browser, zoom))}")


if __name__ == "__main__":
    main()
