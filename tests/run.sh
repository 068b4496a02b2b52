#!/bin/sh
# Installs what the tests need (Debian or Ubuntu with Rust and Python 3.11 or newer) and runs them all.
set -eu
cd "$(dirname "$0")/.."
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
if ! dpkg -s libhdf5-dev pkg-config gcc python3-h5py >/dev/null 2>&1; then
    as_root apt-get update -qq
    as_root apt-get install -y -qq libhdf5-dev pkg-config gcc python3-h5py >/dev/null
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
# Packages come over the network while the compiler works.
mkdir -p target
sh python/packages.sh >target/packages.log 2>&1 &
packages=$!
trap 'kill "$packages" 2>/dev/null || :' EXIT
# With the extension for Python, which has no tests of its own: so its crates are compiled once for both.
cargo test --release --workspace --no-run --tests
# Others may compile from here on.
touch target/tests-are-built
# Of several files that fail, all are named. Three programs of examples/ run as tests of worlds; clippy looks at all of them.
cargo test --release --workspace --no-fail-fast --tests
cargo test --release --workspace --doc
wait "$packages" || { cat target/packages.log >&2; exit 1; }
cat target/packages.log
sh python/test.sh
