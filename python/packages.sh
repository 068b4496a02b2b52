#!/bin/sh
# Makes the environments below target/ in which python/test.sh builds the wheel and tests it: all but the wheel itself.
#
#     sh python/packages.sh [build]
#
# With `build`, only what compiles the HDF5 library and the wheel. The rest waits for the network most of the time, so tests/run.sh
# starts it beside the compiler. PYTHON names the interpreter.
set -eu
cd "$(dirname "$0")/.."
place=target/python
if ! "${PYTHON:-python3}" -c 'import sys, ensurepip, venv; sys.exit(sys.version_info < (3, 11))'; then
    echo "python/packages.sh: Python 3.11 or newer with venv is needed; PYTHON names another" >&2
    exit 1
fi
mkdir -p "$place" target/docs
# Those of pyproject.toml's build-system; they stay, so that the next run builds nothing twice.
[ -x "$place/build/bin/maturin" ] || "${PYTHON:-python3}" -m venv "$place/build"
"$place/build/bin/python" -m pip install -q "maturin>=1.16,<2" "cmake>=3.26"
[ "${1:-}" != build ] || exit 0
rm -rf "$place/venv"
"${PYTHON:-python3}" -m venv "$place/venv"
python="$place/venv/bin/python"
"$python" -m pip install -q pytest ase gymnasium h5py mypy tqdm matplotlib tifffile pycocotools nbclient nbformat ipykernel \
    "mlcroissant>=1.1.1,<1.2" pyyaml "scipy>=1.15,<2" "scikit-learn>=1.5,<2" "scikit-image>=0.24,<1" "onnx>=1.17,<2" "onnxruntime>=1.20,<2"
# PyTorch brings 3 GB for GPUs, so only the long suite trains a network.
if [ -n "${STEMWORLDS_TRAIN:-}" ] && ! "$python" -m pip install -q "torch>=2.6" "onnxscript>=0.5"; then
    echo "SKIPPED: PyTorch cannot be installed; no network is trained" >&2
fi
if ! timeout 240 "$python" -m pip install -q hyperspy; then
    echo "SKIPPED: hyperspy cannot be installed; its reader of our files is not tested" >&2
fi
if ! timeout 120 "$python" -m pip install -q basedpyright; then
    echo "SKIPPED: basedpyright cannot be installed; types are checked by mypy only" >&2
fi
[ -x target/docs/venv/bin/python ] || "${PYTHON:-python3}" -m venv target/docs/venv
target/docs/venv/bin/python -m pip install -q --disable-pip-version-check -r docs/site/requirements.txt
touch "$place/venv/ready"
