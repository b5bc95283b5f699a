#!/usr/bin/env bash
# All five paradigms on real materials: real_brdf.sh METAPP DATA RUNS SEED...
# The 80 NBRDF fits of MERL are split 64/16 (sorted by name, every fifth is a test task), the checkpoints are trained
# on the 64, of which every eighth is kept for validation, and each seed prints its table on the 16.
set -euo pipefail
metapp=$1 data=$2 runs=$3
shift 3
[ -d "$data/nbrdf/merl" ] || { echo "real: $data/nbrdf/merl is missing; name the folder: make real DATA=..." >&2; exit 1; }
folder=$runs/data/nbrdf-merl
"$metapp" data nbrdf "$data/nbrdf/merl" --out "$folder" --overwrite
for seed in "$@"; do
  common=(brdf --recipe quick --data "$folder" --out "$runs" --seed "$seed")
  "$metapp" general "${common[@]}" --train --quiet
  "$metapp" quickft "${common[@]}" --train --quiet
  for rule in meta-sgd meta-curvature; do
    "$metapp" meta "${common[@]}" --rule "$rule" --train --quiet
  done
  trained=$(ls -t "$runs"/brdf/checkpoints/nbrdf-merl-*-quick-seed"$seed".safetensors | head -1)
  "$metapp" evaluate "${common[@]}" --checkpoint "$trained" --whole
done
