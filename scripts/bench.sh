#!/usr/bin/env bash
# usage: scripts/bench.sh [--quick] [--processor-time] [options of Google Benchmark]
#        scripts/bench.sh --instructions
#        scripts/bench.sh --quality
# Installs what is missing, builds iris_bench (build/ci) and times IRIS beside its peers in one run: 7 repetitions of
# at least 0.2 s each in random order, of which the fastest counts (--quick: one of 0.02 s). Prints a table in Markdown,
# as in docs/benchmarks.md; all repetitions go to build/ci/bench.json.
# --processor-time, for a busy machine: of what one thread does, and that alone.
# --benchmark_filter='^stereo/' times one stage.
# --instructions counts the instructions of the stereo core with callgrind (needs valgrind): they repeat exactly.
# --quality prints how many disparities are wrong, of IRIS and its peers, instead of times.
set -euo pipefail
cd "$(dirname "$0")/.."

arguments=()
instructions=false
quality=false
for argument in "$@"; do
  case "$argument" in
    --instructions) instructions=true ;;
    --quality) quality=true ;;
    --quick | --processor-time | --benchmark_*) arguments+=("$argument") ;;
    *)
      sed -n 2,11p "$0"
      exit 2
      ;;
  esac
done
if $instructions && ! command -v valgrind >/dev/null; then
  echo "bench: --instructions needs valgrind (apt-get install valgrind)" >&2
  exit 1
fi

scripts/install-deps.sh --tests >&2
launcher=()
command -v ccache >/dev/null && launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
cmake --preset ci "${launcher[@]}" >&2
cmake --build --preset ci --target iris_bench >&2
bench=build/ci/tests/bench/iris_bench

if $quality; then exec $bench --quality; fi
if ! $instructions; then
  exec $bench --benchmark_out=build/ci/bench.json --benchmark_out_format=json "${arguments[@]}"
fi

echo "| work | instructions | per pixel and disparity |"
echo "|-|-:|-:|"
report=$(mktemp)
trap 'rm -f "$report"' EXIT
for work in correlation mwmf StereoBM StereoSGBM; do
  evaluations=$(valgrind --tool=callgrind --callgrind-out-file=/dev/null --toggle-collect='iris::bench::*counted(*' \
    $bench --count=$work 2>"$report") || { cat "$report" >&2; exit 1; }
  count=$(sed -n 's/^==[0-9]*== Collected : \([0-9]*\)$/\1/p' "$report")
  hundredths=$((100 * count / evaluations))
  printf '| %s | %d | %d.%02d |\n' $work "$count" $((hundredths / 100)) $((hundredths % 100))
done
