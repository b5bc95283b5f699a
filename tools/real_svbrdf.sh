#!/usr/bin/env bash
# All five paradigms on real strips and game materials, under both protocols, and flash photos without maps, by the
# checkpoints that ship: real_svbrdf.sh METAPP DATA RUNS
# These checkpoints were trained on synthetic materials alone, so that every real material is a test task.
set -euo pipefail
metapp=$1 data=$2 runs=$3
for folder in svbrdf_strips svbrdf_maps flash_nonstationary; do
  [ -d "$data/$folder" ] || { echo "real: $data/$folder is missing; name it: make real-svbrdf DATA=..." >&2; exit 1; }
done
"$metapp" data strips "$data/svbrdf_strips" --split test --out "$runs/data/strips" --overwrite
"$metapp" data maps "$data/svbrdf_maps" --split test --out "$runs/data/maps" --overwrite
for data_set in strips maps; do
  "$metapp" evaluate svbrdf_nonstationary --data "$runs/data/$data_set" --out "$runs" --whole
done
"$metapp" meta svbrdf_nonstationary "$data/flash_nonstationary" --out "$runs"
