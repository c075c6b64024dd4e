#!/usr/bin/env bash
# usage: scripts/thesis.sh [stereo|motion|mapping|views …]
# Installs what is missing, builds and prints the tables of docs/thesis.md; pictures go to out/thesis.
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/install-deps.sh --tests >&2
cmake --preset ci >&2
cmake --build --preset ci --target thesis_tables >&2
mkdir -p out/thesis
cd out/thesis
../../build/ci/tests/thesis/thesis_tables "$@"
