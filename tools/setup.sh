#!/usr/bin/env bash
# Make the virtual environment: setup.sh PYTHON VENV. With a third argument, docs or cluster, only that extra is installed.
# Works on a bare Debian 12 with python3. HASHES=off installs by constraints.txt, for indexes with builds of their own.
set -euo pipefail
python=$1 venv=$2 hashes=${HASHES:-on}

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
pip=("$venv/bin/python" -m pip --quiet --disable-pip-version-check)
errors=$(mktemp)
trap 'rm -f "$errors"' EXIT

stop() {
  cat "$errors" >&2
  echo "setup: $1" >&2
  exit 1
}
required() {
  "$venv/bin/python" -c 'import configparser as c, sys; s = c.ConfigParser(); s.read("setup.cfg")
print(*s[sys.argv[1]][sys.argv[2]].split())' "$@"
}
# Install the wheels that a lock file names, each by its SHA-256: get NAME [OPTION ...]. Nothing is built from source, since
# what a build downloads has no hash.
get() {
  local name=$1 what=(--require-hashes --no-deps --only-binary :all: -r "locks/$1.txt")
  shift
  if [ "$hashes" = off ]; then
    # shellcheck disable=SC2046
    case $name in
      packages) what=(pip setuptools $(required options install_requires) $(required options.extras_require dev)) ;;
      docs | cluster) what=($(required options.extras_require "$name")) ;;
      *) what=(torch) ;;
    esac
    what+=(-c constraints.txt)
  fi
  "${pip[@]}" install "${what[@]}" "$@" 2>"$errors" && return
  if grep -q 'DO NOT MATCH THE HASHES' "$errors"; then
    stop "the file above has none of its hashes in locks/$name.txt; if your index has builds of its own: $unhashed"
  fi
  return 1
}
get_or_stop() { get "$@" || stop "pip could not install locks/$1.txt, see above; by versions alone: $unhashed"; }
unhashed="HASHES=off make ${3:-setup}"

if [ -n "${3:-}" ]; then
  get_or_stop "$3"
  exit
fi
has_torch() {
  "$venv/bin/python" -c 'import sys, torch; sys.exit(torch.__version__.partition("+")[0] != sys.argv[1])' \
    "$(sed -n 's/^torch==//p' constraints.txt)" 2>/dev/null
}
# Without an NVIDIA driver the CPU build saves gigabytes. Where its index is out of reach, the default one may have it.
get_cpu_torch() {
  ! command -v nvidia-smi >/dev/null || return
  get torch-cpu --retries 0 --timeout 15 --index-url "${TORCH_INDEX:-https://download.pytorch.org/whl/cpu}" ||
    get torch-cpu
}
has_torch || get_cpu_torch || get_or_stop torch
get_or_stop packages
"${pip[@]}" install --no-index --no-deps --no-build-isolation -e . 2>"$errors" || stop "metapp itself cannot be installed, see above"

# Mitsuba's wheels need libatomic to be imported and libLLVM to render, which a bare Debian has not
renders() { "$venv/bin/python" -c 'import metapp.rendering.variant as m; m.load_mitsuba()' 2>/dev/null; }
# Without root: unpack these packages, and those they need, into the virtual environment, unless they are installed.
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
  "$venv/bin/python" -c "from metapp.rendering.second_scene.relighting import transfer_matrix; transfer_matrix()"
fi
if ! "$venv/bin/metapp" data vgg; then
  echo "setup: no VGG weights: until 'metapp data vgg' gets them, features fall back to fixed random filters" >&2
fi
echo "setup: done, $venv/bin/metapp"
