#!/usr/bin/env bash
# All five paradigms on real maps, under both protocols, by the checkpoints that ship: real_illumination.sh METAPP DATA RUNS
# These checkpoints were trained on synthetic maps alone, so that every real map is a test task.
set -euo pipefail
metapp=$1 data=$2 runs=$3
[ -d "$data/illumination" ] || { echo "real: $data/illumination is missing; name it: DATA=..." >&2; exit 1; }
"$metapp" data laval "$data/illumination" --split test --out "$runs/data/maps" --overwrite
"$metapp" evaluate illumination --data "$runs/data/maps" --out "$runs" --whole
