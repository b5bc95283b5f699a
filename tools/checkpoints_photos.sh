#!/usr/bin/env bash
# Train the texture and svBRDF checkpoints that ship, on the embedded sets alone: checkpoints_photos.sh METAPP RUNS
set -euo pipefail
metapp=$1 runs=$2
rule=meta-basis
for app in texture svbrdf_stationary; do
  common=("$app" --recipe quick --out "$runs" --train)
  "$metapp" general "${common[@]}"
  folder=$(ls -td "$runs/$app"/checkpoints/"$app"-*-quick-seed0 | head -1)
  "$metapp" quickft "${common[@]}" --checkpoint "$folder/general.safetensors"
  "$metapp" meta "${common[@]}" --checkpoint "$folder/general.safetensors" --rule "$rule"
  mkdir -p "metapp/checkpoints/$app"
  cp -v "$folder"/{general,quickft,"$rule"}.safetensors "metapp/checkpoints/$app/"
done
