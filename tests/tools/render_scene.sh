#!/usr/bin/env bash
# usage: render_scene.sh scene.glb picture.png ['hide=cloud,map&turn=180&near=0.5']
# Renders a scene with three.js in a headless Chromium (software WebGL, no display, nothing leaves this machine).
set -euo pipefail
if [ $# -lt 2 ] || [ $# -gt 3 ]; then
  sed -n 2,3p "$0"
  exit 2
fi
scene=$(realpath "$1")
picture=$(realpath -m "$2")
here=$(cd "$(dirname "$0")" && pwd)
[ -f "$scene" ] || { echo "$scene: there is no such file" >&2; exit 3; }
[ -d "$here/node_modules/three" ] || { echo "three.js is missing: npm --prefix $here install" >&2; exit 3; }
browser=$(command -v chromium || command -v chromium-browser || command -v google-chrome) ||
  { echo "there is no Chromium: apt-get install chromium" >&2; exit 3; }

work=$(mktemp -d)
node "$here/serve.mjs" "$scene" "$picture" >"$work/reports" &
server=$!
viewer=
trap 'kill $server $viewer 2>/dev/null || true; wait 2>/dev/null || true; rm -rf "$work"' EXIT
for _ in $(seq 100); do
  [ -s "$work/reports" ] && break
  sleep 0.1
done
mkdir -p "$(dirname "$picture")"
rm -f "$picture"
"$browser" --headless --no-sandbox --disable-gpu --disable-quic --no-first-run \
  --disable-background-networking --disable-component-update --disable-sync --user-data-dir="$work/profile" \
  --use-angle=swiftshader --enable-unsafe-swiftshader --window-size=1280,800 --remote-debugging-port=0 \
  "http://127.0.0.1:$(head -n 1 "$work/reports")/viewer.html?${3-}" >"$work/log" 2>&1 &
viewer=$!
for _ in $(seq 1500); do  # five minutes
  [ "$(wc -l <"$work/reports")" -gt 1 ] && break
  kill -0 $viewer 2>/dev/null || break
  sleep 0.2
done
[ -s "$picture" ] || { cat "$work/log" >&2; echo "no picture was made" >&2; exit 1; }
report=$(tail -n +2 "$work/reports")
echo "$report"
[ -n "$report" ] && [[ "$report" != failed* ]]
