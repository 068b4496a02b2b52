#!/bin/sh
# Installs what the tests need (Debian or Ubuntu with Rust) and runs them all.
set -eu
cd "$(dirname "$0")/.."
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
if ! dpkg -s libhdf5-dev pkg-config gcc python3-h5py >/dev/null 2>&1; then
    as_root apt-get update -qq
    as_root apt-get install -y -qq libhdf5-dev pkg-config gcc python3-h5py >/dev/null
fi
cargo test --release
