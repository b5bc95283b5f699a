#!/usr/bin/env bash
# Train the texture and svBRDF checkpoints that ship, on the embedded sets alone: checkpoints_photos.sh METAPP RUNS
set -euo pipefail
metapp=$1 runs=$2
for app in texture svbrdf_stationary; do
  common=("$app" --recipe quick --out "$runs" --train)
  "$metapp" general "${common[@]}"
  trained=$(ls -t "$runs/$app"/checkpoints/"$app"-*-quick-seed0.safetensors | head -1)
  "$metapp" quickft "${common[@]}" --checkpoint "$trained"
  "$metapp" meta "${common[@]}" --checkpoint "$trained" --rule meta-basis
  "$(dirname "$metapp")/python" tools/ship.py "$trained" "metapp/checkpoints/$app/quick.safetensors"
done
