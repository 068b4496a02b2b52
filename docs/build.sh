#!/bin/sh
# Builds the site of the documentation: target/docs/site/index.html, which needs no network.
#
#     sh docs/build.sh [--changed] [WHEEL]
#
# Runs the Python of all pages with the package stemworlds, built from this clone or taken from WHEEL. A page with an example that fails
# fails the build. With --changed, only pages run whose Python changed since they ran last (docs/site/ran.json, which
# STEMGEN_UPDATE=1 renews); the site then lacks what the others show. PYTHON names the interpreter.
set -eu
cd "$(dirname "$0")/.."
place=target/docs
only=
if [ "${1:-}" = --changed ]; then only=--changed; shift; fi
wheel=${1:-}
if ! "${PYTHON:-python3}" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))'; then
    echo "docs/build.sh: Python 3.11 or newer with venv is needed; PYTHON names another" >&2
    exit 1
fi
mkdir -p "$place"
[ -x "$place/venv/bin/python" ] || "${PYTHON:-python3}" -m venv "$place/venv"
python="$place/venv/bin/python"
"$python" -m pip install -q --disable-pip-version-check -r docs/site/requirements.txt
if [ -n "$wheel" ]; then
    "$python" -m pip install -q --disable-pip-version-check --force-reinstall --no-deps "$wheel"
else
    "$python" -m pip install -q --disable-pip-version-check ./python
fi
"$python" docs/site/pages.py "$place/source" $only
rm -rf "$place/site"
"$python" -m sphinx -q -W --keep-going -b html -d "$place/doctrees" "$place/source" "$place/site"
echo "$place/site/index.html: $(find "$place/site" -name '*.html' | wc -l) pages, $(du -sm "$place/site" | cut -f1) MB"
