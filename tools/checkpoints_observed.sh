#!/usr/bin/env bash
# Train the checkpoints that ship for an application with two protocols, on its embedded set alone:
# checkpoints_observed.sh METAPP RUNS APP
# Non-stationary svBRDFs get further checkpoints for fits of flash photographs, whose maps are finer, trained on synthetic
# materials of 512 px.
set -euo pipefail
metapp=$1 runs=$2 app=$3
common=("$app" --recipe quick --out "$runs" --train)
"$metapp" general "${common[@]}"
trained=$(ls -t "$runs/$app"/checkpoints/"$app"-*-quick-seed0.safetensors | head -1)
for observe in reference photo; do
  "$metapp" quickft "${common[@]}" --checkpoint "$trained" --observe "$observe"
  "$metapp" meta "${common[@]}" --checkpoint "$trained" --observe "$observe"
done
"$(dirname "$metapp")/python" tools/ship.py "$trained" "metapp/checkpoints/$app/quick.safetensors"

if [ "$app" = svbrdf_nonstationary ]; then
  data=$runs/data/drawn-512px
  [ -f "$data/manifest.json" ] || "$metapp" data synth "$app" --count 400 --size 512 --seed 1 --out "$data"
  for paradigm in general quickft meta; do
    "$metapp" "$paradigm" "$app" --recipe full --observe photo --data "$data" --out "$runs" --train
  done
  trained=$(ls -t "$runs/$app"/checkpoints/drawn-512px-*-full-seed0.safetensors | head -1)
  "$(dirname "$metapp")/python" tools/ship.py "$trained" "metapp/checkpoints/$app/full.safetensors"
fi
