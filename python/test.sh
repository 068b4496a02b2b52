#!/bin/sh
# Builds the wheel, installs it in a fresh virtual environment under target/, and tests it there.
#
#     sh python/test.sh [WHEEL] [-- ARGUMENTS OF PYTEST]
#
# With WHEEL, tests that one. PYTHON names the interpreter.
set -eu
cd "$(dirname "$0")/.."
top=$(pwd)
place=target/python
wheel=
case "${1:-}" in "" | --) ;; *) wheel=$1; shift ;; esac
[ "${1:-}" = -- ] && shift
if ! "${PYTHON:-python3}" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))'; then
    echo "python/test.sh: Python 3.11 or newer with venv is needed; PYTHON names another" >&2
    exit 1
fi
rm -rf "$place/venv"
mkdir -p "$place"
"${PYTHON:-python3}" -m venv "$place/venv"
python="$top/$place/venv/bin/python"
if [ -z "$wheel" ]; then
    # Those of pyproject.toml's build-system; they stay, so that the next run builds nothing twice.
    [ -x "$place/build/bin/maturin" ] || "${PYTHON:-python3}" -m venv "$place/build"
    "$place/build/bin/python" -m pip install -q "maturin>=1.16,<2" "cmake>=3.26"
    rm -rf "$place/wheels"
    PATH="$top/$place/build/bin:$PATH" maturin build --release --locked -m python/Cargo.toml -o "$place/wheels"
    wheel=$(ls "$place"/wheels/*.whl)
fi
size=$(wc -c <"$wheel")
echo "$wheel: $size bytes"
[ "$size" -lt 15000000 ] || { echo "python/test.sh: the wheel is larger than 15 MB; is it stripped?" >&2; exit 1; }
"$python" -m pip install -q "$wheel" ./library
# By itself: numpy is all it needs, and no HDF5 library is on the system's path for it.
(cd "$place" && "$python" -c "
import stemworlds as sw
print('stemworlds', sw.__version__, 'from', sw.__file__)
assert sw.Recipe('test').grid == (2, 3)
")
extension=$("$python" -c "import stemworlds._core as core; print(core.__file__)")
if ldd "$extension" | grep -iE "hdf5|libz|libpython"; then
    echo "python/test.sh: the extension needs libraries that a bare system lacks" >&2
    exit 1
fi
"$python" -m pip install -q pytest ase h5py mypy tqdm matplotlib tifffile pycocotools nbclient nbformat ipykernel \
    "mlcroissant>=1.1.1,<1.2" pyyaml "scipy>=1.15,<2" "scikit-learn>=1.5,<2" "scikit-image>=0.24,<1" "onnx>=1.17,<2" "onnxruntime>=1.20,<2"
if ! timeout 240 "$python" -m pip install -q hyperspy; then
    echo "SKIPPED: hyperspy cannot be installed; its reader of our files is not tested" >&2
fi
if ! timeout 120 "$python" -m pip install -q basedpyright; then
    echo "SKIPPED: basedpyright cannot be installed; types are checked by mypy only" >&2
fi
"$python" -m pytest python/tests -c python/pyproject.toml --rootdir python "$@"
# All examples of the pages run while the site is built. Who picks tests by hand does without.
[ $# -gt 0 ] || sh docs/build.sh "$wheel"
