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

# Mitsuba's wheels need libatomic to be imported and libLLVM to render, which a bare Debian has not
renders() { "$venv/bin/python" -c 'import metapp.rendering.variant as m; m.load_mitsuba()' 2>/dev/null; }
# Without root: into the virtual environment, what is not installed of these packages and of those they need.
unpack_libraries() (
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  mkdir -p "$work/lists/partial" "$work/cache/archives/partial" "$venv/lib/llvm"
  apt=(-qq -o "Dir::State::lists=$work/lists" -o "Dir::Cache=$work/cache")
  apt-get "${apt[@]}" update || exit
  needed=$(apt-cache "${apt[@]}" depends --recurse --no-recommends --no-suggests --no-conflicts --no-breaks \
    --no-replaces --no-enhances "$@" | grep '^[a-z]' | sort -u)
  for package in $needed; do
    if ! dpkg-query -W -f '${db:Status-Abbrev}' "$package" 2>/dev/null | grep -q '^ii'; then
      (cd "$work" && apt-get "${apt[@]}" download "$package" && dpkg-deb -x "$package"_*.deb root) || exit
    fi
  done
  find "$work/root" -name '*.so*' -not -type d -exec cp -P {} "$venv/lib/llvm/" \;
  # Dr.Jit needs libatomic to be imported, and looks for it beside itself
  drjit=$("$venv/bin/python" -c 'import importlib.util as u; print(*u.find_spec("drjit").submodule_search_locations)')
  find "$work/root" -name 'libatomic.so*' -exec cp -P {} "$drjit/" \;
)
if ! renders && command -v apt-get >/dev/null; then
  if [ "$(id -u)" = 0 ]; then
    apt-get update -qq && apt-get install -y -qq --no-install-recommends libllvm19 libatomic1 >/dev/null || true
  else
    unpack_libraries libllvm19 libatomic1 2>/dev/null || true
  fi
fi
if ! renders; then
  echo "setup: Mitsuba cannot render scenes; it needs: apt-get install libllvm19 libatomic1" >&2
else
  "$venv/bin/metapp" data scene
fi
if ! "$venv/bin/metapp" data vgg; then
  echo "setup: no VGG weights: until 'metapp data vgg' gets them, features fall back to fixed random filters" >&2
fi
echo "setup: done, $venv/bin/metapp"
