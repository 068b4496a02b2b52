#!/bin/sh
# Checks the program with the oldest Rust that Cargo.toml promises, where that toolchain is installed.
set -eu
cd "$(dirname "$0")/.."
oldest=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
toolchain=$({ rustup toolchain list 2>/dev/null || true; } | grep -m 1 -oE "^$(echo "$oldest" | sed 's/\./\\./')(\.[0-9]+)?(-[^ ]*)?( |\$)" || true)
if [ -n "$toolchain" ]; then
    cargo "+${toolchain% }" check --locked --target-dir target/oldest
else
    echo "SKIPPED: Rust $oldest is not installed (rustup toolchain install $oldest); the promise in Cargo.toml is not checked" >&2
fi
