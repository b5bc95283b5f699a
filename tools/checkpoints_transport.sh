#!/usr/bin/env bash
# Train the transport checkpoints that ship, on the embedded scenes alone: checkpoints_transport.sh METAPP RUNS
set -euo pipefail
metapp=$1 runs=$2
app=transport
common=("$app" --recipe quick --out "$runs" --train)
"$metapp" general "${common[@]}"
trained=$(ls -t "$runs/$app"/checkpoints/"$app"-*-quick-seed0.safetensors | head -1)
for paradigm in quickft meta; do
  "$metapp" "$paradigm" "${common[@]}" --checkpoint "$trained"
done
"$(dirname "$metapp")/python" tools/ship.py "$trained" "metapp/checkpoints/$app/quick.safetensors"
