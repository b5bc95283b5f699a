# The front door. `make help` lists the targets.
SHELL := /bin/bash
.DEFAULT_GOAL := help

VENV ?= .venv
PYTHON ?= python3
METAPP := $(VENV)/bin/metapp
DATA ?= data
RUNS ?= runs
SEEDS ?= 0 1 2
# small networks run many times slower where threads fight over them
export OMP_NUM_THREADS ?= 1

.PHONY: help setup demo test test-slow lint types bench tables table-results real real-photos real-illumination \
  real-svbrdf starts-brdf starts-photos starts-illumination starts-svbrdf \
  starts-transport clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

setup: $(VENV)/.ready  ## make the virtual environment and install metapp, pinned by constraints.txt

$(VENV)/.ready: setup.cfg pyproject.toml constraints.txt tools/setup.sh
	bash tools/setup.sh "$(PYTHON)" "$(VENV)"
	@touch $@

demo: setup  ## fit 20 unseen materials in 10 gradient steps each; table and picture
	$(METAPP) meta brdf --steps 10 --out $(RUNS)

test: setup  ## the tests, three to five minutes
	$(VENV)/bin/python -m pytest -m "not slow"

test-slow: setup  ## the tests that take minutes each
	$(VENV)/bin/python -m pytest -m slow

lint: setup  ## ruff
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

types: setup  ## mypy
	$(VENV)/bin/mypy

bench: setup  ## speed and memory of learning, as ratios measured side by side
	$(VENV)/bin/python -m tests.benchmarks.bench_learning

tables: table-results  ## all tables there are

table-results: setup  ## error and time of the five paradigms on the embedded data, beside the paper's; half an hour
	$(METAPP) evaluate --table --which results --out $(RUNS)

real: setup  ## real materials: make real DATA=<folder with nbrdf/merl>; trains and prints the five paradigms, 3 seeds
	bash tools/real_brdf.sh "$(METAPP)" "$(DATA)" "$(RUNS)" $(SEEDS)

real-photos: setup  ## real textures and flash photos: make real-photos DATA=<folder with texture, flash_stationary>; hours
	bash tools/real_photos.sh "$(METAPP)" "$(DATA)" "$(RUNS)" $(firstword $(SEEDS))

real-illumination: setup  ## real maps: make real-illumination DATA=<folder with illumination>; the starts that ship, 10 minutes
	bash tools/real_illumination.sh "$(METAPP)" "$(DATA)" "$(RUNS)"

real-svbrdf: setup  ## real materials: make real-svbrdf DATA=<folder with svbrdf_strips, svbrdf_maps, flash_nonstationary>
	bash tools/real_svbrdf.sh "$(METAPP)" "$(DATA)" "$(RUNS)"

starts-illumination: setup  ## train the starts of illumination that ship, on the embedded maps; an hour
	bash tools/starts_observed.sh "$(METAPP)" "$(RUNS)" illumination

starts-svbrdf: setup  ## train the starts of non-stationary svBRDFs that ship, on the embedded patches; two hours
	bash tools/starts_observed.sh "$(METAPP)" "$(RUNS)" svbrdf_nonstationary

starts-transport: setup  ## train the starts of light transport that ship, on the embedded scenes; an hour
	bash tools/starts_transport.sh "$(METAPP)" "$(RUNS)"

starts-photos: setup  ## train the starts of textures and svBRDFs that ship, on the embedded sets; hours
	bash tools/starts_photos.sh "$(METAPP)" "$(RUNS)"

starts-brdf: setup  ## train the starts that ship: make starts-brdf DATA=<folder with nbrdf/merl>
	bash tools/starts_brdf.sh "$(METAPP)" "$(DATA)" "$(RUNS)"

clean:  ## remove caches and the virtual environment; runs and trained starts stay
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
