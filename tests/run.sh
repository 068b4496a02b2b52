#!/bin/sh
# Installs what the tests need (Debian or Ubuntu with Rust and Python 3.11 or newer) and runs them.
#
#     sh tests/run.sh [--all]
#
# With --all, what is slow or rare too: tests that are marked `ignore` or `long`, fuzzing of a million inputs, all pages of the
# documentation, PyTorch, the system's HDF5 library in place of the program's own copy, and the oldest Rust where it is installed. Hours.
set -eu
cd "$(dirname "$0")/.."
. tests/parts.sh
case "${1:-}" in
    "") all= ;;
    --all) all=1 ;;
    *) echo "tests/run.sh: '$1' is no option; there is --all" >&2; exit 2 ;;
esac
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
packages="gcc g++ pkg-config python3-h5py strace libfaketime"
[ -z "$all" ] || packages="$packages libhdf5-dev"
if ! dpkg -s $packages >/dev/null 2>&1; then
    as_root apt-get update -qq
    as_root apt-get install -y -qq $packages >/dev/null
fi
# Without strace, or where programs may not be traced, tests that hold or end a program at a named call would be skipped in silence.
if strace -qq -o /dev/null true; then
    export STEMGEN_REQUIRE_STRACE=1
else
    echo "tests/run.sh: strace may not trace programs here; tests of kills, full disks and locks will be skipped" >&2
fi
# Pages are tested in headless Chromium. Where Debian's packages are not to be had (Ubuntu has a snap in
# their place), any Chromium or Chrome with its chromedriver will do: STEMGEN_CHROMIUM, STEMGEN_CHROMEDRIVER.
if python3 tests/browser/webdriver.py >/dev/null 2>&1; then
    export STEMGEN_REQUIRE_BROWSER=1
elif as_root apt-get update -qq && as_root apt-get install -y -qq chromium chromium-driver >/dev/null; then
    export STEMGEN_REQUIRE_BROWSER=1
else
    echo "tests/run.sh: Chromium and chromedriver cannot be installed here; pages will not be tested" >&2
fi
# Debian's Python has no venv without a package of its own.
if ! python3 -c 'import ensurepip, venv' >/dev/null 2>&1; then
    as_root apt-get update -qq && as_root apt-get install -y -qq python3-venv >/dev/null
fi
mkdir -p target
part "packages"
# 3 GB, so that networks are trained too; and Python's long tests.
[ -z "$all" ] || export STEMWORLDS_TRAIN=1 STEMWORLDS_LONG=1
# cmake, for the copy of the HDF5 library that tests and wheel share; the rest comes over the network while the compiler works.
sh python/packages.sh build
PATH="$PWD/target/python/build/bin:$PATH"
sh python/packages.sh >target/packages.log 2>&1 &
waiting=$!
trap 'kill "$waiting" 2>/dev/null || :' EXIT
# Only backtraces need line tables, and inlining across parts of a crate gains little; both take time to compile.
export CARGO_PROFILE_RELEASE_DEBUG=false CARGO_PROFILE_RELEASE_LTO=off
part "compile tests"
# With the extension for Python, which has no tests of its own: so its crates are compiled once for both.
features="--release --workspace --features stemgen/static-hdf5"
cargo test $features --no-run --tests
# Others may compile from here on.
touch target/tests-are-built
part "run tests"
# libtest tells the time of each test to nightly compilers only, or to those that take themselves for one.
host=$(rustc -vV | sed -n 's/^host: //p' | tr 'a-z-' 'A-Z_')
export "CARGO_TARGET_${host}_RUNNER=env RUSTC_BOOTSTRAP=1"
[ -z "$all" ] || export STEMGEN_FUZZ=1000000
# Of several files that fail, all are named. Programs of examples/ run as tests of worlds; clippy looks at all of them.
failed=
{ cargo test $features --no-fail-fast --tests -- ${all:+--include-ignored} -Z unstable-options --report-time || echo failed; } 2>&1 |
    tee target/tests.log
tail -n 1 target/tests.log | grep -qx failed && failed=1
unset "CARGO_TARGET_${host}_RUNNER"
part "documentation of Rust"
cargo test $features --doc || failed=1
part "packages"
wait "$waiting" || { cat target/packages.log >&2; exit 1; }
cat target/packages.log
part "wheel and Python"
sh python/test.sh || failed=1
if [ -n "$all" ]; then
    part "all pages"
    sh docs/build.sh target/python/wheels/*.whl || failed=1
    part "system's HDF5"
    cargo test --release -p stemgen-cli --no-fail-fast --tests || failed=1
    part "oldest Rust"
    sh tests/oldest.sh || failed=1
fi
part "end"
echo
echo "The ten slowest tests, in seconds on the wall beside the others:"
grep -hE '^test .* <[0-9.]+s>$' target/tests.log | sed -E 's/^test (.*) \.\.\. .*<([0-9.]+)s>$/\2 \1/' | sort -rn | head -n 10
echo
spent
[ -z "$failed" ] || { echo "tests/run.sh: tests failed" >&2; exit 1; }
