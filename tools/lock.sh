#!/usr/bin/env bash
# Write the lock files anew, from setup.cfg and constraints.txt: lock.sh PYTHON. A package without a version in
# constraints.txt keeps the version that it is locked to; without locks/packages.txt and locks/torch.txt it gets the newest.
set -euo pipefail
python=$1 cpu_index=${TORCH_INDEX:-https://download.pytorch.org/whl/cpu}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check uv

requirements() {
  "$python" -c 'import configparser as c, sys; s = c.ConfigParser(); s.read("setup.cfg"); print(s[sys.argv[1]][sys.argv[2]])' "$@"
}
# setup.sh builds nothing from source: what a build itself downloads has no hash
compile() {
  "$work/venv/bin/uv" pip compile --quiet --universal --python-version 3.11 --generate-hashes --only-binary :all: \
    --no-annotate --no-header --output-file "$@" - >/dev/null
}

mkdir -p locks
cat locks/packages.txt locks/torch.txt >"$work/all.txt" 2>/dev/null || true
{ requirements options install_requires && requirements options.extras_require dev && printf '%s\n' pip setuptools; } |
  compile "$work/all.txt" --constraints constraints.txt
awk -v torch="$work/torch.txt" -v rest="$work/packages.txt" \
  '/^[a-z]/ {file = /^(torch|triton)==|^(nvidia|cuda)-/ ? torch : rest} {print > file}' "$work/all.txt"
mv "$work/packages.txt" "$work/torch.txt" locks/

# extras are installed into the same environment, so they must agree with the versions of the other lock files
grep -v ' *--hash=' locks/packages.txt | sed 's/ *\\$//' | cat constraints.txt - >"$work/beside.txt"
for extra in docs cluster; do
  requirements options.extras_require $extra | compile locks/$extra.txt --constraints "$work/beside.txt"
done

cpu=$(grep '^torch==' constraints.txt)+cpu
if echo "$cpu" | compile "$work/torch-cpu.txt" --no-deps --index-url "$cpu_index" 2>"$work/errors"; then
  mv "$work/torch-cpu.txt" locks/
elif grep -qsF "$cpu " locks/torch-cpu.txt; then
  echo "lock: $cpu_index is out of reach; locks/torch-cpu.txt stays as it is" >&2
else
  cat "$work/errors" >&2
  echo "lock: $cpu_index is out of reach, and locks/torch-cpu.txt is of another version than $cpu" >&2
  exit 1
fi
