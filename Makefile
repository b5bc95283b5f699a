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

.PHONY: help setup demo test test-long test-slow test-cluster mutants lint types docs lock bench bench-size bench-growth bench-cluster bench-samples guiding tables figures report paper paper-brdf fuzz real real-photos \
  real-illumination real-svbrdf checkpoints-brdf checkpoints-photos checkpoints-illumination checkpoints-svbrdf \
  checkpoints-transport clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 26

setup: $(VENV)/.ready  ## make the virtual environment and install metapp: packages by their SHA-256, docs/downloads.md

$(VENV)/.ready: setup.cfg pyproject.toml constraints.txt tools/setup.sh $(wildcard locks/*)
	bash tools/setup.sh "$(PYTHON)" "$(VENV)"
	@touch $@

demo: setup  ## fit 20 unseen materials by the best rule and in 10 gradient steps; one table and picture of both
	$(METAPP) meta brdf --quiet --out $(RUNS)
	$(METAPP) meta brdf --rule meta-curvature --steps 10 --quiet --out $(RUNS)
	$(METAPP) compare $(RUNS)/brdf/meta $(RUNS)/brdf/meta-meta-curvature-10steps

WORKERS := -n auto --maxprocesses 4 --dist worksteal

test: setup  ## the tests on up to four cores, five to seven minutes on two
	$(VENV)/bin/python -m pytest -m "not long and not slow" $(WORKERS)

test-long: setup  ## the tests that take seconds each, beside quicker ones of their kind; on two cores
	$(VENV)/bin/python -m pytest -m "long and not slow" $(WORKERS)

test-slow: setup  ## the tests that take minutes each
	$(VENV)/bin/python -m pytest -m slow -o faulthandler_timeout=3600

fuzz: setup  ## damaged files for all readers, new ones every time: N=1000 of each, 20 minutes
	METAPP_FUZZ=$(or $(N),1000) $(VENV)/bin/python -m pytest tests/fuzz $(WORKERS) -o faulthandler_timeout=7200

mutants: setup  ## small faults put into the sources: how many the tests notice; N=12 of each package, half an hour
	$(VENV)/bin/python tools/mutants.py $(or $(N),12)

lint: setup  ## ruff, layers
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports --no-cache

types: setup  ## mypy, strict
	$(VENV)/bin/mypy

docs: $(VENV)/.docs  ## the pages of docs/ as a site: site/index.html
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict --quiet
	@! grep -rlE '<(script|img|iframe|source)[^>]* src="https?:|<link[^>]* href="https?:|url\(.?https?:|@import' \
	  site --include='*.html' --include='*.css' || { echo "docs: these pages load something from elsewhere" >&2; exit 1; }
	@echo "docs: site/index.html"

# what the pages need alone: mkdocstrings reads the sources here, so the environment keeps the metapp that it has
$(VENV)/.docs: locks/docs.txt tools/setup.sh
	bash tools/setup.sh "$(PYTHON)" "$(VENV)" docs
	@touch $@

test-cluster: $(VENV)/.cluster  ## the examples for Dask and Ray, on two workers each; installs these, 150 MB
	$(VENV)/bin/python -m pytest tests/test_cluster.py

$(VENV)/.cluster: locks/cluster.txt tools/setup.sh $(VENV)/.ready
	bash tools/setup.sh "$(PYTHON)" "$(VENV)" cluster
	@touch $@

lock:  ## write locks/ anew, the SHA-256 of all packages, from setup.cfg and constraints.txt
	bash tools/lock.sh "$(PYTHON)"

bench: setup  ## speed and memory of learning, as ratios measured side by side
	$(VENV)/bin/python -m benchmarks.bench_learning

bench-size: setup  ## time and memory of a fit by size, a table and runs/bench/size.png; 2 minutes
	$(VENV)/bin/python -m benchmarks.bench_size

bench-cluster: $(VENV)/.cluster  ## materials a minute by a loop, Dask and Ray, with one worker and two; 2 minutes
	$(VENV)/bin/python -m benchmarks.bench_cluster

bench-growth: setup  ## growth of time and memory with steps, tasks and samples; a minute
	$(VENV)/bin/python -m benchmarks.bench_growth

# on the embedded data set, unless DATA is given
bench-samples: setup  ## errors of BRDF fits by number of samples, a table and a figure; DATA=<data set of brdf>
	$(VENV)/bin/python -m benchmarks.bench_samples $(if $(filter file,$(origin DATA)),,"$(DATA)")

# renders pictures of 256 px; for a shorter run: make guiding GUIDING="--size 64 --reference 4096 --times 0.25 1 4"; rows and references are kept
guiding: setup  ## error over time of guided and regular paths, a table and a figure in runs/guiding; an hour
	$(VENV)/bin/python -m benchmarks.bench_guiding --out $(RUNS)/guiding $(GUIDING)

# Overfit and Finetune on three tasks, which the tables say; WHOLE=--whole takes all tasks and both protocols
WHOLE ?=
# RECIPE=full: at the sizes that people use; hours (of pictures of transport 2), of which finished fits are not repeated
RECIPE ?= quick
EVALUATE := $(METAPP) evaluate $(WHOLE) --recipe $(RECIPE) --out $(RUNS)
TABLES := results quickft image ablation storage samples convergence baselines

.PHONY: $(TABLES:%=table-%)

tables: $(TABLES:%=table-%)  ## all tables on the embedded data, beside the paper's figures: about half an hour; RECIPE=full: hours

table-results: setup  ## error and time of the five paradigms
	$(EVALUATE) --which results

table-quickft: setup  ## General, QuickFT and Meta after as many steps
	$(EVALUATE) --which quickft

table-image: setup  ## errors of pictures made from fits
	$(EVALUATE) --which image

table-ablation: setup  ## learned initialisation and learned rule, each alone, and all rules that ship
	$(EVALUATE) --which ablation

table-storage: setup  ## bytes stored for many exemplars
	$(EVALUATE) --which storage

table-samples: setup  ## samples that a fit uses
	$(EVALUATE) --which samples

table-convergence: setup  ## errors by Meta's steps, and the steps until it reaches Overfit
	$(EVALUATE) --which convergence

table-baselines: setup  ## baselines without a network: error, time and bytes
	$(EVALUATE) --which baselines

figures: setup  ## all figures as PNG and PDF, in runs/figures
	$(EVALUATE) --which all --figures $(RUNS)/figures --overwrite --format markdown

report: setup  ## all tables as Markdown, with the figures: runs/report/index.md
	$(EVALUATE) --which all --report $(RUNS)/report --overwrite --format markdown

paper: setup  ## the paper's own recipe, for a machine with a GPU and days: trains everything, then tables and report
	bash tools/paper.sh "$(METAPP)" "$(RUNS)" $$($(VENV)/bin/python -c 'from metapp.names import app_names; print(*app_names())')

# PAPER=paper-long: at ten times the outer rate, which decays
PAPER ?= paper

paper-brdf: setup  ## the paper's recipe on neural fits of MERL: make paper-brdf DATA=<folder with nbrdf/merl>; an hour and a half
	bash tools/paper_brdf.sh "$(METAPP)" "$(DATA)" "$(RUNS)" "$(PAPER)"

real: setup  ## real materials: make real DATA=<folder with nbrdf/merl>; trains and prints the five paradigms, 3 seeds
	bash tools/real_brdf.sh "$(METAPP)" "$(DATA)" "$(RUNS)" $(SEEDS)

real-photos: setup  ## real textures and flash photos: make real-photos DATA=<folder with texture, flash_stationary>; hours
	bash tools/real_photos.sh "$(METAPP)" "$(DATA)" "$(RUNS)" $(firstword $(SEEDS))

real-illumination: setup  ## real maps: make real-illumination DATA=<folder with illumination>; the checkpoints that ship; 10 minutes
	bash tools/real_illumination.sh "$(METAPP)" "$(DATA)" "$(RUNS)"

real-svbrdf: setup  ## real materials: make real-svbrdf DATA=<folder with svbrdf_strips, svbrdf_maps, flash_nonstationary>
	bash tools/real_svbrdf.sh "$(METAPP)" "$(DATA)" "$(RUNS)"

checkpoints-illumination: setup  ## train the checkpoints of illumination that ship, on the embedded maps; two to three hours
	bash tools/checkpoints_observed.sh "$(METAPP)" "$(RUNS)" illumination

checkpoints-svbrdf: setup  ## train the checkpoints of non-stationary svBRDFs, on synthetic materials; six hours, 4 GB of memory and 2 GB of disk
	bash tools/checkpoints_observed.sh "$(METAPP)" "$(RUNS)" svbrdf_nonstationary

checkpoints-transport: setup  ## train the checkpoints of light transport, on the embedded scenes; an hour
	bash tools/checkpoints_transport.sh "$(METAPP)" "$(RUNS)"

checkpoints-photos: setup  ## train the checkpoints of textures and stationary svBRDFs, on the embedded sets; hours
	bash tools/checkpoints_photos.sh "$(METAPP)" "$(RUNS)"

checkpoints-brdf: setup  ## train the checkpoints of BRDFs: make checkpoints-brdf DATA=<folder with nbrdf/merl>
	bash tools/checkpoints_brdf.sh "$(METAPP)" "$(DATA)" "$(RUNS)"

clean:  ## remove caches and the virtual environment; runs and trained checkpoints stay
	rm -rf $(VENV) build site *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
