"""What one does with a page of stemgen, and reads there."""

import urllib.parse

import numpy as np


class Page:
    """An open page in a browser."""

    def __init__(self, browser, path):
        self.browser = browser
        browser.open(path)
        browser.still()
        rect = "const r = document.getElementById('field').getBoundingClientRect(); return [r.x, r.y, r.width, r.height]"
        self.x, self.y, self.width, self.height = browser.run(rect)
        # Before anything is pointed at.
        self.empty_panel = browser.run("return document.getElementById('readout').getBoundingClientRect().height")
        self.calibrate()

    def calibrate(self):
        """Finds the position on the screen of a position in the field, by pointing at two places."""
        a = np.array([round(self.x + 0.4 * self.width), round(self.y + 0.4 * self.height)])
        b = np.array([round(self.x + 0.6 * self.width), round(self.y + 0.6 * self.height)])
        at = [np.array(self.at(*p)["position"].split(), float) for p in (a, b)]
        self.scale = (b - a) / (at[1] - at[0])
        self.corner = a - at[0] * self.scale

    def place(self, x, y):
        """CSS pixels of a position in the field."""
        return np.array([x, y]) * self.scale + self.corner

    def at(self, px, py):
        """Points at a pixel of the screen; the raw values of the readout."""
        self.browser.hover(px, py)
        self.browser.still()
        return self.readout()

    def over(self, x, y):
        return self.at(*self.place(x, y))

    def readout(self):
        script = (
            "return Object.fromEntries([...document.querySelectorAll('#readout dd')]"
            ".map((d) => [d.dataset.key, d.dataset.value ?? d.textContent]))"
        )
        return self.browser.run(script)

    def zoom_to(self, x, y, scale):
        """Zooms about a position until a unit has at least `scale` CSS pixels."""
        for _ in range(60):
            if self.scale[0] >= scale:
                return
            self.browser.wheel(*self.place(x, y), -250)
            self.browser.still()
            self.calibrate()
        raise AssertionError("the wheel does not zoom")

    def color(self, x, y):
        """Red, green and blue of the canvas at a position of the field."""
        px, py = self.place(x, y) - [self.x, self.y]
        script = "return [...document.getElementById('field').getContext('2d').getImageData(arguments[0], arguments[1], 1, 1).data]"
        return np.array(self.browser.run(script, int(px), int(py))[:3], float)

    def away(self):
        """Takes the pointer off the image, so that no mark hides it."""
        self.browser.hover(self.x + self.width + 40, self.y + 30)
        self.browser.still()

    def toggle(self, overlay):
        self.browser.click(f"#overlay-{overlay}")
        self.away()

    def profile(self, start, end):
        """Drags a line; its samples as an array (distance, curves ...), and the header."""
        if self.browser.run("return document.getElementById('profile-mode').getAttribute('aria-pressed')") == "false":
            self.browser.click("#profile-mode")
        a, b = self.place(*start), self.place(*end)
        self.browser.act(self.browser.pointer(("move", *a), ("down",), ("move", *(a + b) / 2, 60), ("move", *b, 60), ("up",)))
        self.browser.wait("return !document.getElementById('profile').hidden", "the profile")
        self.browser.click("#profile-mode")
        return self.curves()

    def curves(self):
        """What the page saves as CSV, and its header."""
        self.browser.still()
        link = self.browser.run("return document.getElementById('profile-csv').href")
        rows = urllib.parse.unquote(link.split(",", 1)[1]).strip().split("\n")
        return np.array([[float(v) for v in row.split(",")] for row in rows[1:]]), rows[0]

    def ends(self):
        """Values of the first and the last colour."""
        return [
            float(self.browser.run(f"return document.getElementById('colorbar-{name}').dataset.value"))
            for name in ["low", "high"]
        ]


def bilinear(image, x, y):
    """Values between pixels."""
    rows, columns = image.shape
    x, y = np.clip(x, 0, columns - 1), np.clip(y, 0, rows - 1)
    i, j = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), rows - 2)
    s, t = x - i, y - j
    top = image[j, i] * (1 - s) + image[j, i + 1] * s
    return top * (1 - t) + (image[j + 1, i] * (1 - s) + image[j + 1, i + 1] * s) * t


def close(a, b, tolerance, what):
    a, b = np.asarray(a, float), np.asarray(b, float)
    assert a.shape == b.shape, f"{what}: shapes {a.shape} and {b.shape}"
    worst = np.abs(a - b).max()
    assert worst <= tolerance, f"{what}: {a} and {b} differ by {worst}, more than {tolerance}"
