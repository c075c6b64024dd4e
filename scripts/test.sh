#!/usr/bin/env bash
# usage: scripts/test.sh [--tidy] [ctest arguments]
# Installs what is missing, builds everything with warnings as errors (build/ci), runs all tests and checks the format.
# --tidy runs clang-tidy as well (slow). Example: scripts/test.sh -R stereo
set -euo pipefail
cd "$(dirname "$0")/.."

tidy=false
if [ "${1-}" = --tidy ]; then
  tidy=true
  shift
fi

scripts/install-deps.sh --tests
tools=tests/tools
if command -v npm >/dev/null && ! cmp -s $tools/package-lock.json $tools/node_modules/.iris-lock; then
  if npm --prefix $tools ci --omit=dev --no-audit --no-fund; then
    cp $tools/package-lock.json $tools/node_modules/.iris-lock
  else
    echo "test: gltf-validator and Pannellum could not be installed; their tests will be skipped" >&2
  fi
fi

launcher=()
command -v ccache >/dev/null && launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
cmake --preset ci "${launcher[@]}"
# Benchmarks and the thesis's tables are not run, but must build.
cmake --build --preset ci --target all iris_bench thesis_tables

failed=()
ctest --test-dir build/ci --output-on-failure --no-tests=error -j 2 "$@" || failed+=(tests)

mapfile -t sources < <(git ls-files '*.h' '*.cpp')
if command -v clang-format-14 >/dev/null; then
  clang-format-14 --dry-run -Werror "${sources[@]}" || failed+=(format)
else
  echo "test: no clang-format-14; the format was not checked" >&2
fi

if $tidy; then
  # The public headers are checked through the sources that include them.
  printf '%s\n' "${sources[@]}" | grep -E '^(src|export|apps)/.*\.cpp$' |
    xargs -P "$(nproc)" -n 4 clang-tidy-14 -p build/ci --quiet --warnings-as-errors='*' || failed+=(clang-tidy)
fi

if [ ${#failed[@]} -gt 0 ]; then
  echo "test: FAILED: ${failed[*]}" >&2
  exit 1
fi
echo "test: all good"
