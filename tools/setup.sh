#!/usr/bin/env bash
# Make the virtual environment: setup.sh PYTHON VENV. Works on a bare Debian 12 with python3.
set -euo pipefail
python=$1 venv=$2

if ! "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
  echo "setup: $python is missing or older than 3.11; install Python 3.11 or name one: make setup PYTHON=..." >&2
  exit 1
fi
if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
  # Debian packs venv separately
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    apt-get update -qq && apt-get install -y -qq --no-install-recommends python3-venv >/dev/null
  else
    echo "setup: Python has no venv module; install it first: apt-get install python3-venv" >&2
    exit 1
  fi
fi
"$python" -m venv "$venv"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check --upgrade pip
if ! "$venv/bin/python" -c 'import torch' 2>/dev/null; then
  pip_torch=("$venv/bin/python" -m pip install --quiet --disable-pip-version-check -c constraints.txt torch)
  # without an NVIDIA driver the CPU build saves gigabytes; where its index is out of reach, the default one serves
  cpu_index=${TORCH_INDEX:-https://download.pytorch.org/whl/cpu}
  if command -v nvidia-smi >/dev/null ||
    ! "${pip_torch[@]}" --retries 0 --timeout 15 --index-url "$cpu_index" 2>/dev/null; then
    "${pip_torch[@]}"
  fi
fi
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
# Mitsuba's wheels need libatomic, which a bare Debian has not; only the tests against Mitsuba use them so far
if ! "$venv/bin/python" -c 'import drjit' 2>/dev/null; then
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    apt-get update -qq && apt-get install -y -qq --no-install-recommends libatomic1 >/dev/null
  else
    echo "setup: Mitsuba cannot be imported; install its library: apt-get install libatomic1" >&2
  fi
fi
if ! "$venv/bin/metapp" data vgg; then
  echo "setup: no VGG weights: until 'metapp data vgg' gets them, features fall back to fixed random filters" >&2
fi
echo "setup: done, $venv/bin/metapp"
