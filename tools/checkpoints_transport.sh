#!/usr/bin/env bash
# Train the transport checkpoints that ship, on the embedded scenes alone: checkpoints_transport.sh METAPP RUNS
set -euo pipefail
metapp=$1 runs=$2
app=transport
common=("$app" --recipe quick --out "$runs" --train)
"$metapp" general "${common[@]}"
folder=$(ls -td "$runs/$app"/checkpoints/"$app"-*-quick-seed0 | head -1)
for paradigm in quickft meta; do
  "$metapp" "$paradigm" "${common[@]}" --checkpoint "$folder/general.safetensors"
done
mkdir -p "metapp/checkpoints/$app"
find "$folder" -name '*.safetensors' ! -name '*.previous.*' ! -name '*.interrupted.*' ! -name '*.training.*' \
  -exec cp -v {} "metapp/checkpoints/$app/" \;
