#!/usr/bin/env bash
# All five paradigms on real photographs: real_photos.sh METAPP DATA RUNS SEED...
# Checkpoints are trained on the training photos, of which every eighth is kept for validation. Each seed prints its table
# on the test photos: every fifth of the sorted textures, and the flash photos of every fifth material.
set -euo pipefail
metapp=$1 data=$2 runs=$3
shift 3
for folder in texture flash_stationary; do
  [ -d "$data/$folder" ] || { echo "real: $data/$folder is missing; name it: make real-photos DATA=..." >&2; exit 1; }
done
"$metapp" data images "$data/texture" --out "$runs/data/photos" --overwrite
"$metapp" data flash "$data/flash_stationary" --out "$runs/data/flash" --overwrite
for seed in "$@"; do
  for pair in texture:photos svbrdf_stationary:flash; do
    common=("${pair%:*}" --recipe quick --data "$runs/data/${pair#*:}" --out "$runs" --seed "$seed")
    "$metapp" general "${common[@]}" --train --quiet
    "$metapp" quickft "${common[@]}" --train --quiet
    "$metapp" meta "${common[@]}" --train --quiet
    trained=$(ls -t "$runs/${pair%:*}"/checkpoints/"${pair#*:}"-*-quick-seed"$seed".safetensors | head -1)
    "$metapp" evaluate "${common[@]}" --checkpoint "$trained" --whole
  done
done
