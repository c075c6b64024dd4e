#!/usr/bin/env bash
# usage: scripts/install-deps.sh [--tests]
# Installs what IRIS is built from and runs with on Debian 12 (bookworm). --tests adds what only the tests and the format
# check need. Does nothing, without root and without the network, if all of it is there already.
set -euo pipefail

build=(
  ca-certificates git g++ cmake ninja-build pkg-config
  libceres-dev libeigen3-dev libembree-dev libfmt-dev libhwy-dev libopencv-dev libspdlog-dev libsqlite3-dev libtbb-dev
  libtomlplusplus-dev libyaml-cpp-dev nlohmann-json3-dev
)
export_and_program=(ffmpeg fonts-dejavu-core libassimp-dev libcairo2-dev libcli11-dev liboctomap-dev libpcl-dev libtinygltf-dev)
tests=(clang-format-14 libbenchmark-dev libgmock-dev libgtest-dev octomap-tools poppler-utils)

wanted=("${build[@]}" "${export_and_program[@]}")
case "${1-}" in
  "") ;;
  --tests)
    wanted+=("${tests[@]}")
    # Node.js may come from elsewhere than Debian.
    command -v node >/dev/null || wanted+=(nodejs)
    command -v npm >/dev/null || wanted+=(npm)
    ;;
  *)
    sed -n 2,4p "$0"
    exit 2
    ;;
esac

missing=()
for package in "${wanted[@]}"; do
  status=$(dpkg-query --show --showformat='${db:Status-Status}' "$package" 2>/dev/null || true)
  [[ $status == installed* ]] || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then
  echo "install-deps: everything is there"
  exit 0
fi

if ! grep -q '^VERSION_CODENAME=bookworm' /etc/os-release 2>/dev/null; then
  echo "install-deps: this is not Debian 12 (bookworm); the same names are tried" >&2
fi
as_root=()
if [ "$(id -u)" -ne 0 ]; then
  command -v sudo >/dev/null || { echo "install-deps: needs root or sudo to install: ${missing[*]}" >&2; exit 1; }
  as_root=(sudo)
fi
echo "install-deps: installing ${missing[*]}"
"${as_root[@]}" apt-get update -q
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${missing[@]}"
