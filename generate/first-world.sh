#!/bin/sh
# Installs what is missing (Debian or Ubuntu with Rust), builds stemgen and makes a first small world.
set -eu
cd "$(dirname "$0")/.."
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
if ! dpkg -s libhdf5-dev pkg-config gcc >/dev/null 2>&1; then
    as_root apt-get update -qq
    as_root apt-get install -y -qq libhdf5-dev pkg-config gcc >/dev/null
fi
cargo build --release
target/release/stemgen build srtio3 --difficulty easy --grid 1x1 --overwrite "$@"
