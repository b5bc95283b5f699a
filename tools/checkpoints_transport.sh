#!/usr/bin/env bash
# Train the transport checkpoints that ship, on the embedded scenes alone: checkpoints_transport.sh METAPP RUNS
set -euo pipefail
metapp=$1 runs=$2
app=transport
for paradigm in general quickft meta; do
  "$metapp" "$paradigm" "$app" --recipe quick --out "$runs" --train
done
folder=$(ls -td "$runs/$app"/checkpoints/"$app"-*-quick-seed0 | head -1)
mkdir -p "metapp/checkpoints/$app"
find "$folder" -name '*.safetensors' ! -name '*.previous.*' ! -name '*.interrupted.*' ! -name '*.training.*' \
  -exec cp -v {} "metapp/checkpoints/$app/" \;
