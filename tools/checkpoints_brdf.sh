#!/usr/bin/env bash
# Train the BRDF checkpoints that ship: checkpoints_brdf.sh METAPP DATA RUNS
# They are trained on the embedded training set and the 64 training materials of the MERL fits, never on the other 16.
set -euo pipefail
metapp=$1 data=$2 runs=$3
[ -d "$data/nbrdf/merl" ] || { echo "checkpoints: $data/nbrdf/merl is missing; name it: make checkpoints-brdf DATA=..." >&2; exit 1; }
"$metapp" data synth brdf --out "$runs/data/synthetic" --overwrite
"$metapp" data nbrdf "$data/nbrdf/merl" --out "$runs/data/nbrdf-merl" --overwrite
"$metapp" data join "$runs/data/synthetic" "$runs/data/nbrdf-merl" --out "$runs/data/joint" --overwrite
common=(brdf --recipe quick --data "$runs/data/joint" --out "$runs")
"$metapp" general "${common[@]}" --train --train-steps 30000
trained() { ls -t "$runs"/brdf/checkpoints/$1-seed0.safetensors | head -1; }
ship() { "$(dirname "$metapp")/python" tools/ship.py "$(trained "$1")" "metapp/checkpoints/brdf/$2.safetensors"; }
general=(--checkpoint "$(trained "joint-*-quick")")
"$metapp" quickft "${common[@]}" "${general[@]}" --train
"$metapp" meta "${common[@]}" "${general[@]}" --rule meta-curvature --train --train-steps 30000
"$metapp" meta "${common[@]}" "${general[@]}" --rule meta-sgd --train
"$metapp" meta "${common[@]}" --rule ridge --train
ship "joint-*-quick" quick
# ridge is trained further on networks of RGL materials, but not on those whose measurements judge it, nor on every
# fifth of the others
networks=() number=0
for network in "$data"/nbrdf/rgl/*; do
  [ -f "$data/rgl/$(basename "$network").bsdf" ] && continue
  number=$((number + 1))
  [ $((number % 5)) = 0 ] || networks+=("$network")
done
"$metapp" data nbrdf "${networks[@]}" --split train --out "$runs/data/nbrdf-rgl" --overwrite
"$metapp" data join "$runs/data/joint" "$runs/data/nbrdf-rgl" --out "$runs/data/three" --overwrite
"$metapp" meta brdf --recipe quick --rule ridge --data "$runs/data/three" --out "$runs" --train --train-steps 13000 \
  --checkpoint metapp/checkpoints/brdf/quick.safetensors
# then on samples as instruments take them: dense, scattered, few or noisy. Training draws equally many synthetic
# materials, MERL fits and RGL networks.
"$metapp" data synth brdf --seed 1 --count 320 --out "$runs/data/drawn" --overwrite
"$metapp" data join "$runs/data/drawn" "$runs/data/nbrdf-merl" "$runs/data/nbrdf-rgl" --alike --out "$runs/data/kinds" --overwrite
"$metapp" meta brdf --recipe quick --rule ridge --data "$runs/data/kinds" --out "$runs" --train --train-steps 10500 \
  --checkpoint "$(trained "three-*-quick")"
ship "kinds-*-quick" quick
# anisotropic materials have a recipe of their own; the checkpoint of recipe few stays as it is (metapp/checkpoints/brdf/few.md)
"$metapp" data synth brdf --anisotropic --count 175 --out "$runs/data/anisotropic" --overwrite
"$metapp" meta brdf --recipe anisotropic --data "$runs/data/anisotropic" --out "$runs" --train
ship "anisotropic-*-anisotropic" anisotropic
