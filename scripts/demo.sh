#!/usr/bin/env bash
# usage: scripts/demo.sh [SESSION]
# Installs what is missing, builds IRIS, reconstructs the recording SESSION (a folder in a layout that `iris info SESSION`
# knows: EuRoC, KITTI, pairs of images, …) into out/<name of SESSION> and says what to look at. Without SESSION: a walk
# through a made-up apartment is simulated, reconstructed, and compared with the truth.
set -euo pipefail
from=$PWD
cd "$(dirname "$0")/.."

if [[ ${1-} == -* || $# -gt 1 ]]; then
  sed -n 2,5p "$0"
  exit 2
fi
session=
if [ $# -eq 1 ]; then
  session=$(cd "$from" && realpath -m "$1")
  [ -e "$session" ] || { echo "demo: there is no $session" >&2; exit 3; }
fi

scripts/install-deps.sh
cmake --preset release -DIRIS_BUILD_TESTS=OFF -DIRIS_BUILD_EXAMPLES=OFF
cmake --build --preset release --target iris_app
iris=build/release/iris
truth=
if [ -z "$session" ]; then
  session=out/sessions/apartment
  truth=$session
  $iris simulate apartment -o $session --simulate.colour true
fi

out=out/$(basename "$session")
status=0
$iris run "$session" -o "$out" || status=$?
# 4: finished, but the recording broke into pieces; everything that was reconstructed is there.
[ $status -eq 0 ] || [ $status -eq 4 ] || exit $status

if [ -n "$truth" ]; then
  $iris evaluate "$out" --truth "$truth" -o "$out/evaluation"
fi

echo
echo "Look at:"
look() {
  [ ! -e "$out/$1" ] || printf '  %-32s %s\n' "$out/$1" "$2"
}
look report/index.html "everything on one page, in a browser"
look map/map.png "the map; map_picture.png with scale and path, map.yaml for ROS"
look model/scene.glb "the 3-D scene, in any glTF viewer"
look model/cloud.ply "the points, with their errors, in MeshLab or CloudCompare; mesh.ply is their surface"
look octree/map.bt "the octree, in octovis"
look tour/tour.mp4 "the virtual tour"
look trajectory/tum.txt "the path of the camera"
look evaluation/trajectory_path.png "the path beside the true one; the errors of everything else beside it"
exit $status
