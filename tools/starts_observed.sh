#!/usr/bin/env bash
# Train the checkpoints that ship of an application with two protocols, on its embedded set alone:
# starts_observed.sh METAPP RUNS APP
set -euo pipefail
metapp=$1 runs=$2 app=$3
"$metapp" general "$app" --out "$runs" --train
for observe in reference photo; do
  "$metapp" quickft "$app" --observe "$observe" --out "$runs" --train
  "$metapp" meta "$app" --observe "$observe" --out "$runs" --train
done
folder=$(ls -td "$runs/$app"/starts/"$app"-*-quick-seed0 | head -1)
"$(dirname "$metapp")/python" tools/ship.py "$folder" "metapp/checkpoints/$app"
