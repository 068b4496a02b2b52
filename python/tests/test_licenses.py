"""The wheel takes the licences of what is linked into it along."""

from __future__ import annotations

import importlib.metadata
import re
import shutil
import subprocess
import sys

import pytest
from conftest import SOURCES


def test_the_wheel_holds_the_licences_of_its_crates() -> None:
    files = importlib.metadata.files("stemworlds") or []
    held = {path.name: path for path in files if "licenses" in path.parts}
    assert {"LICENSE-MIT", "LICENSE-APACHE", "LICENSE-HDF5", "LICENSE-zlib", "RUST-CRATES.txt"} <= held.keys()
    text = held["RUST-CRATES.txt"].read_text(encoding="utf-8")
    for crate in ("ndarray", "rustfft", "pyo3", "hdf5-metno"):
        assert re.search(rf"^{crate} \d+\.\d+\.\d+: ", text, re.MULTILINE), crate
    assert text.count("Permission is hereby granted") > 50


@pytest.mark.skipif(shutil.which("cargo") is None, reason="there is no cargo here")
def test_the_licences_are_those_of_the_locked_crates() -> None:
    run = subprocess.run([sys.executable, SOURCES / "third_party.py", "--check"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
