#!/usr/bin/env bash
# The paper's recipe on the embedded data, for a machine with a GPU: paper.sh METAPP RUNS APP...
# Trains General, QuickFT's Adam and Meta (10^6 outer steps) of every application, which takes days, then fits all
# test tasks with all of Overfit's steps and writes tables, figures and the report. Fits see what the paper's fits see.
set -euo pipefail
metapp=$1 runs=$2
shift 2
for app in "$@"; do
  common=("$app" --recipe paper --train --out "$runs")
  "$metapp" general "${common[@]}"
  trained=$(ls -t "$runs/$app"/checkpoints/"$app"-*-paper-seed0.safetensors | head -1)
  "$metapp" quickft "${common[@]}" --checkpoint "$trained"
  "$metapp" meta "${common[@]}"
  "$metapp" evaluate "$app" --checkpoint "$trained" --recipe paper --whole --observe reference --which all --out "$runs" \
    --figures "$runs/figures/$app" --report "$runs/report/$app" --overwrite
done
