"""Gathers the licences of the crates that are linked into the extension: python python/third_party.py [--check]

Writes python/licenses/RUST-CRATES.txt, which the wheel takes along; with --check, says whether the file is that of Cargo.lock. Texts that
several crates share are written once. It takes cargo, and the sources of the crates, which any build has fetched.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
OUT = HERE / "licenses" / "RUST-CRATES.txt"
#: Crates differ a little from system to system; all are named.
TARGETS = ("x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu", "aarch64-apple-darwin")
#: Beginnings of the names of files that hold a licence.
NAMES = ("license", "licence", "copying", "copyright", "notice", "unlicense")
RULE = "=" * 100


def told(command: str, *more: str) -> str:
    """What cargo says of the extension as wheels have it."""
    words = ["cargo", command, "--locked", "--features", "static-hdf5", "--manifest-path", str(HERE / "Cargo.toml"), *more]
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


def linked() -> list[dict[str, Any]]:
    """The packages that end in the extension: no macros, nothing that only builds, none of this repository."""
    named: set[tuple[str, str]] = set()
    for target in TARGETS:
        tree = told("tree", "--edges", "normal,no-proc-macro", "--prefix", "none", "--target", target, "--format", "{p}")
        for line in tree.splitlines():
            name, version = line.split()[:2]
            named.add((name, version.removeprefix("v")))
    packages = json.loads(told("metadata", "--format-version", "1", "--filter-platform", TARGETS[0]))["packages"]
    packages += json.loads(told("metadata", "--format-version", "1", "--filter-platform", TARGETS[-1]))["packages"]
    known = {(package["name"], package["version"]): package for package in packages}
    return [known[one] for one in sorted(named) if known[one]["source"]]


def texts(package: dict[str, Any]) -> list[str]:
    """The licences that lie in the sources of a package; of several to choose from, MIT's where it is one."""
    folder = Path(package["manifest_path"]).parent
    found = [path for path in sorted(folder.iterdir()) if path.name.lower().startswith(NAMES)]
    if re.search(r"\bMIT\b", package["license"] or "") and " AND " not in package["license"]:
        found = [path for path in found if "mit" in path.name.lower()] or found
    for path in list(found):
        if path.is_dir():
            found.remove(path)
            found += sorted(path.iterdir())
    read = [path.read_text(errors="replace") for path in found if path.is_file() and path.suffix != ".rs"]
    return ["\n".join(line.rstrip() for line in text.strip().splitlines()) for text in read]


def gathered() -> str:
    """The text of the file."""
    crates = linked()
    by_text: dict[str, list[str]] = {}
    as_printed: dict[str, str] = {}
    for package in crates:
        name = f"{package['name']} {package['version']}"
        for text in dict.fromkeys(texts(package)):
            # Where lines break is nothing that differs.
            same = as_printed.setdefault(" ".join(text.split()), text)
            by_text.setdefault(same, []).append(name)
    lines = [f"The extension of stemworlds holds {len(crates)} crates of Rust. Their licences:", ""]
    for package in crates:
        where = package["repository"] or package["homepage"] or ""
        lines.append(f"{package['name']} {package['version']}: {package['license'] or package['license_file']} ({where})")
    bare = [f"{package['name']} {package['version']}" for package in crates if not texts(package)]
    lines += ["", f"Without a text of their own in their sources (LICENSE-MIT is that of MIT, LICENSE-HDF5 that of hdf5-metno-src): {', '.join(bare)}"]
    for text, names in by_text.items():
        lines += ["", RULE, *names, RULE, "", text]
    return "\n".join(lines) + "\n"


def main() -> int:
    made = gathered()
    if sys.argv[1:] == ["--check"]:
        if not OUT.is_file() or OUT.read_text() != made:
            print(f"{OUT} is not that of Cargo.lock; renew it: python python/third_party.py", file=sys.stderr)
            return 1
        return 0
    OUT.write_text(made)
    print(f"{OUT}: {len(made)} characters")
    return 0


if __name__ == "__main__":
    sys.exit(main())
