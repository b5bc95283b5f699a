#!/usr/bin/env bash
# Train the texture and svBRDF checkpoints that ship, on the embedded sets alone: starts_photos.sh METAPP RUNS
set -euo pipefail
metapp=$1 runs=$2
rule=meta-basis
for app in texture svbrdf_stationary; do
  "$metapp" general "$app" --out "$runs" --train
  "$metapp" quickft "$app" --out "$runs" --train
  "$metapp" meta "$app" --rule "$rule" --out "$runs" --train
  folder=$(ls -td "$runs/$app"/starts/"$app"-*-quick-seed0 | head -1)
  mkdir -p "metapp/checkpoints/$app"
  cp -v "$folder"/{general,quickft,"$rule"}.safetensors "metapp/checkpoints/$app/"
done
