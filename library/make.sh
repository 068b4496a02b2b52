#!/bin/sh
# Simulates the library again, for another version of the numerics: about an hour and a half on two cores.
#
#     sh library/make.sh [FOLDER OF THE CACHE, to go on from or to keep]
set -eu
cd "$(dirname "$0")/.."
cargo build --release
STEMGEN_CACHE=${1:-$(pwd)/target/library-cache}
export STEMGEN_CACHE
for material in batio3 gan graphene mos2 sige srtio3 wse2; do
    target/release/stemgen cache fill "$material" --no-library
    target/release/stemgen cache export "$material" --overwrite -o "library/$material.stemlib"
done
STEMGEN_UPDATE=1 cargo test --release --test worlds by_heart
ls -l library/*.stemlib
echo "Now put the version of the numerics into library/pyproject.toml and python/pyproject.toml."
