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
# tests/run.sh has made them already.
[ -f "$place/venv/ready" ] || sh python/packages.sh
rm "$place/venv/ready"
if [ -z "$wheel" ]; then
    rm -rf "$place/wheels"
    PATH="$top/$place/build/bin:$PATH" maturin build --release --locked -m python/Cargo.toml -o "$place/wheels"
    wheel=$(ls "$place"/wheels/*.whl)
fi
size=$(wc -c <"$wheel")
echo "$wheel: $size bytes"
# 12 MB of program, and networks.
[ "$size" -lt 18000000 ] || { echo "python/test.sh: the wheel is larger than 18 MB; is it stripped?" >&2; exit 1; }
# By itself: what it names is all it needs, and no HDF5 library is on the system's path for it.
rm -rf "$place/bare"
"${PYTHON:-python3}" -m venv "$place/bare"
"$place/bare/bin/python" -m pip install -q "$wheel"
(cd "$place" && bare/bin/python -c "
import stemworlds as sw
print('stemworlds', sw.__version__, 'from', sw.__file__)
assert sw.Recipe('test').grid == (2, 3)
try:
    import stemworlds.bench
except ModuleNotFoundError as error:
    assert 'stemworlds[bench]' in str(error), error
else:
    raise SystemExit('the wheel brings more than NumPy')
")
python="$top/$place/venv/bin/python"
"$python" -m pip install -q "$wheel" ./library
extension=$("$python" -c "import stemworlds._core as core; print(core.__file__)")
if ldd "$extension" | grep -iE "hdf5|libz|libpython"; then
    echo "python/test.sh: the extension needs libraries that a bare system lacks" >&2
    exit 1
fi
# Examples of pages that changed run while the site is built, beside the tests. Who picks tests by hand does without.
docs=
if [ $# -eq 0 ]; then
    sh docs/build.sh --changed "$wheel" >"$place/docs.log" 2>&1 &
    docs=$!
    trap 'kill "$docs" 2>/dev/null || :' EXIT
fi
"$python" -m pytest python/tests -c python/pyproject.toml --rootdir python --durations=10 "$@"
[ -z "$docs" ] || { wait "$docs" || { cat "$place/docs.log" >&2; exit 1; }; cat "$place/docs.log"; }
