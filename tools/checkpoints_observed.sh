#!/usr/bin/env bash
# Train the checkpoints that ship of an application with two protocols, on its embedded set alone:
# checkpoints_observed.sh METAPP RUNS APP
set -euo pipefail
metapp=$1 runs=$2 app=$3
common=("$app" --recipe quick --out "$runs" --train)
"$metapp" general "${common[@]}"
for observe in reference photo; do
  "$metapp" quickft "${common[@]}" --observe "$observe"
  "$metapp" meta "${common[@]}" --observe "$observe"
done
folder=$(ls -td "$runs/$app"/checkpoints/"$app"-*-quick-seed0 | head -1)
"$(dirname "$metapp")/python" tools/ship.py "$folder" "metapp/checkpoints/$app"
