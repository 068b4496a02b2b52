"""A small client of the WebDriver protocol (W3C), enough to test pages in headless Chromium.

Needs `chromedriver` and Chromium; STEMGEN_CHROMEDRIVER and STEMGEN_CHROMIUM name others.
"""

import base64
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
import urllib.error
import urllib.request

ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
BROWSERS = ["chromium", "chromium-browser", "google-chrome"]
# As root, and without anything that asks the network.
ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-dev-shm-usage", "--force-device-scale-factor=1",
]
# Seconds after which something hangs. However slow the machine is, nothing else depends on time.
LONGEST = 1800
KEYS = {"escape": "\ue00c", "left": "\ue012", "right": "\ue014", "shift": "\ue008"}


def find():
    """Paths of chromedriver and browser, or None."""
    driver = os.environ.get("STEMGEN_CHROMEDRIVER") or shutil.which("chromedriver")
    named = os.environ.get("STEMGEN_CHROMIUM")
    browser = named or next(filter(None, map(shutil.which, BROWSERS)), None)
    return (driver, browser) if driver and browser else None


class Browser:
    """A window of `size` (width, height) that shows files."""

    def __init__(self, size=(1400, 900), arguments=()):
        driver, browser = find()
        # The profile, and all else that driver and browser leave.
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self.process = subprocess.Popen(
            [driver, "--port=0"],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, "TMPDIR": self.folder.name},
        )
        try:
            self.begin(driver, browser, size, arguments)
        except BaseException:
            self.end()
            raise

    def begin(self, driver, browser, size, arguments):
        for line in self.process.stdout:
            if found := re.search(r"started successfully on port (\d+)", line):
                self.root = f"http://127.0.0.1:{found[1]}"
                break
        else:
            raise RuntimeError(f"{driver} did not start")
        options = {
            "binary": browser,
            "args": [
                *ARGUMENTS,
                f"--window-size={size[0]},{size[1]}",
                f"--user-data-dir={self.folder.name}",
                *arguments,
            ],
        }
        limits = {"script": 1000 * LONGEST, "pageLoad": 1000 * LONGEST}
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}, "timeouts": limits}
        answer = self.ask("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self.root += f"/session/{answer['sessionId']}"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.ask("DELETE", "")
        finally:
            self.end()

    def end(self):
        self.process.terminate()
        self.process.wait(LONGEST)
        self.process.stdout.close()
        self.folder.cleanup()

    def ask(self, method, path, body=None):
        data = None if body is None and method != "POST" else json.dumps(body or {}).encode()
        request = urllib.request.Request(self.root + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            # No proxy: this is our own machine.
            opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
            with opener.open(request, timeout=LONGEST) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(json.load(error)["value"]["message"]) from None

    def open(self, path):
        self.ask("POST", "/url", {"url": "file://" + os.path.abspath(path)})

    def run(self, script, *arguments):
        """Runs JavaScript and returns what it returns."""
        return self.ask("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, script, what):
        """Waits until JavaScript returns something true, and returns that."""
        end = time.monotonic() + LONGEST
        while time.monotonic() < end:
            if value := self.run(script):
                return value
            time.sleep(0.03)
        raise AssertionError(f"waited {LONGEST} s for {what}; log: {self.log()}")

    def still(self):
        """Waits until nothing moves or loads."""
        script = "return document.documentElement.dataset.state === 'still'"
        self.wait(script, "the page to be still")

    def log(self):
        """Errors that the page raised."""
        entries = self.ask("POST", "/se/log", {"type": "browser"})
        return [entry["message"] for entry in entries if entry["level"] == "SEVERE"]

    def element(self, selector):
        found = self.ask("POST", "/element", {"using": "css selector", "value": selector})
        return found[ELEMENT]

    def click(self, selector):
        self.ask("POST", f"/element/{self.element(selector)}/click")

    def text(self, selector):
        return self.ask("GET", f"/element/{self.element(selector)}/text")

    def type(self, selector, text):
        element = self.element(selector)
        self.ask("POST", f"/element/{element}/clear")
        self.ask("POST", f"/element/{element}/value", {"text": text})

    def key(self, name):
        value = KEYS.get(name, name)
        actions = [{"type": "keyDown", "value": value}, {"type": "keyUp", "value": value}]
        self.act({"type": "key", "id": "keys", "actions": actions})

    def act(self, *sources):
        self.ask("POST", "/actions", {"actions": list(sources)})
        self.ask("DELETE", "/actions")

    def pointer(self, *actions, kind="mouse", name="pointer"):
        """One pointer's actions: ("move", x, y[, ms]), ("down",), ("up",), ("pause", ms)."""
        steps = []
        for action, *rest in actions:
            if action == "move":
                x, y, *duration = rest
                steps.append({"type": "pointerMove", "x": round(x), "y": round(y), "duration": (duration or [0])[0]})
            elif action == "pause":
                steps.append({"type": "pause", "duration": rest[0]})
            else:
                steps.append({"type": "pointer" + action.capitalize(), "button": 0})
        return {"type": "pointer", "id": name, "parameters": {"pointerType": kind}, "actions": steps}

    def hover(self, x, y):
        self.ask("POST", "/actions", {"actions": [self.pointer(("move", x, y))]})

    def wheel(self, x, y, amount):
        scroll = {"type": "scroll", "x": round(x), "y": round(y), "deltaX": 0, "deltaY": amount, "duration": 0}
        self.act({"type": "wheel", "id": "wheel", "actions": [scroll]})

    def screenshot(self, path):
        with open(path, "wb") as file:
            file.write(base64.b64decode(self.ask("GET", "/screenshot")))


if __name__ == "__main__":
    print(*(find() or ["no chromedriver and Chromium"]), sep="\n")
    raise SystemExit(0 if find() else 1)
