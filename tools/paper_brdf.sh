#!/usr/bin/env bash
# The paper's recipe on BRDFs: paper_brdf.sh METAPP DATA RUNS [RECIPE]
# Trains General, QuickFT's Adam and Meta (10^6 outer steps) on 64 neural fits of MERL, draws Meta's curve, and fits the
# other 16 and the embedded test materials by all five paradigms. Interrupted, the same command goes on where it was.
set -euo pipefail
metapp=$1 data=$2 runs=$3 recipe=${4:-paper}
[ -d "$data/nbrdf/merl" ] || { echo "paper-brdf: $data/nbrdf/merl is missing; name it: make paper-brdf DATA=..." >&2; exit 1; }
fits="$runs/data/nbrdf-merl"
[ -d "$fits" ] || "$metapp" data nbrdf "$data/nbrdf/merl" --out "$fits"
for paradigm in general quickft meta; do
  "$metapp" "$paradigm" brdf --recipe "$recipe" --data "$fits" --train --out "$runs"
done
trained=$(ls -t "$runs"/brdf/checkpoints/nbrdf-merl-*-"$recipe"-seed0.safetensors | head -1)
"$(dirname "$metapp")/python" tools/training_curves.py "$runs/figures/$recipe-brdf.png" "$trained:meta-sgd"
for table in results quickft; do
  "$metapp" evaluate brdf --recipe "$recipe" --data "$fits" --checkpoint "$trained" --whole --which "$table" --out "$runs"
done
# the embedded test materials differ in kind from the training materials
for paradigm in general overfit finetune quickft meta; do
  checkpoint=(--checkpoint "$trained")
  [ "$paradigm" = overfit ] && checkpoint=()
  "$metapp" "$paradigm" brdf --recipe "$recipe" "${checkpoint[@]}" --out "$runs"
done
