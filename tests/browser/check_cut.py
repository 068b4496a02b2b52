"""A page that was cut off says so.

    python check_cut.py PAGE.html
"""

import sys

from webdriver import Browser

with Browser() as browser:
    browser.open(sys.argv[1])
    browser.wait("return !document.getElementById('message').hidden", "a message")
    text = browser.text("#message")
    assert "cut off" in text, text
