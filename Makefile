# `make demo` and `make test` need Python 3.11 or newer and nothing else; each makes .venv when there is none.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
  $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
MADE := .venv/.made
unexport PYTHONDONTWRITEBYTECODE  # else each process of the tests compiles all its imports anew

PYTEST = $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

.DEFAULT_GOAL := help
.PHONY: help demo test test-long check format bench fuzz bench-ends bench-heights bench-live bench-coverage bench-ground bench-motion bench-photos train pictures pages docs dist ready clean

help:  ## this list
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | expand -t 17

demo: $(MADE)  ## a simulated vehicle looks for a site and lands; the report: out/demo/report.html
	$(BIN)/alight demo --out out/demo

test: $(MADE)  ## the tests, the import contracts among them
	$(BIN)/alight warmup
	$(PYTEST)

test-long: $(MADE)  ## more cases of what shorter tests show: each fault on each autopilot, each damage, a recorded flight
	$(PYTEST) -m long

check: $(MADE)  ## format, lint, types, imports, totals that rose; seconds
	$(BIN)/ruff format --check . && $(BIN)/ruff check . && $(BIN)/mypy && $(BIN)/lint-imports && $(BIN)/python .ci/totals.py

format: $(MADE)  ## put the source into its form
	$(BIN)/ruff format . && $(BIN)/ruff check --fix .

bench: $(MADE)  ## speed, as ratios to a yardstick on the same machine
	$(BIN)/python bench/bench_steps.py

bench-heights: $(MADE)  ## heights with true poses beside what they must show; an hour of CPU, kept between runs
	$(BIN)/python bench/bench_heights.py

fuzz: $(MADE)  ## damaged flights, photos, recordings, rasters, runs, scenes, models, settings and MAVLink for ten minutes; failures are kept in out/fuzz
	$(BIN)/python bench/fuzz --minutes 10

bench-ends: $(MADE)  ## runs ended at 20 random moments by SIGTERM and SIGKILL, and started again into the same folder
	$(BIN)/python bench/ends.py

bench-live: $(MADE)  ## a live flight by the clock: rates, latencies, memory, start; an hour, most of it waiting
	$(BIN)/python bench/bench_live.py

bench-coverage: $(MADE)  ## do heights from estimated poses lie within what the map claims; half an hour of CPU
	$(BIN)/python bench/bench_coverage.py

bench-ground: $(MADE)  ## P(safe) on other renderers and on test flights, the contest's terrains, the terrain library, speed
	PYTHONPATH=bench $(BIN)/python bench/ground_domains.py
	PYTHONPATH=bench $(BIN)/python bench/ground_domains.py --set fresh
	$(BIN)/python bench/bench_ground.py && $(BIN)/python bench/bench_terrain.py library && $(BIN)/python bench/bench_terrain.py measure

train: $(MADE)  ## fit the land cover and P(safe) anew: src/alight/learned; hours of CPU, maps kept between runs
	$(BIN)/python -m pip install --quiet --editable '.[train]'
	PYTHONPATH=bench $(BIN)/python training/land_cover.py && PYTHONPATH=bench $(BIN)/python training/detection.py && PYTHONPATH=bench $(BIN)/python training/p_safe.py && PYTHONPATH=bench $(BIN)/python training/near.py

bench-motion: $(MADE)  ## ego-motion: consistency, drift without GPS, speed beside what they must be
	$(BIN)/python bench/bench_motion.py

bench-photos: $(MADE)  ## a card of photos: CPU a megapixel, memory, coverage, accuracy; half an hour
	$(BIN)/python bench/bench_photos.py

pictures: $(MADE)  ## the built-in scenes from 20 and 100 m: docs/scenes, and what `alight simulate --list` shows
	$(BIN)/python bench/scene_pictures.py

pages: $(MADE)  ## docs/settings.md, docs/scene-keys.md and docs/commands.md: every setting, key of a scene file and option
	$(BIN)/alight settings --markdown > docs/settings.md && $(BIN)/alight simulate --keys > docs/scene-keys.md
	$(BIN)/python -m typer --app app alight.cli.flown utils docs --name alight > docs/commands.md

docs: $(MADE) pages  ## the site from docs/ and from the source: out/site/index.html; any warning fails
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	$(BIN)/mkdocs build --strict

dist: $(MADE)  ## wheel and sdist in dist/, checked, installed into an empty environment, and tried there
	$(BIN)/python -m pip install --quiet --editable '.[release]'
	rm -rf dist && $(BIN)/python -m build && $(BIN)/twine check --strict dist/*
	.ci/installed.sh '$(PYTHON)'

ready: $(MADE)  ## dist/ with a wheel that brings its compiled loops, for Linux on x86-64-v3 and this Python
	$(BIN)/python -m pip install --quiet --editable '.[release]'
	.ci/ready.sh $(BIN)/python

clean:  ## everything that was made, .venv included
	rm -rf .venv out dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache docs/settings.md docs/scene-keys.md docs/commands.md

$(MADE): pyproject.toml src/alight/__init__.py
	@test -n '$(PYTHON)' || { echo 'Alight needs Python 3.11 or newer and found none; install it, or name it: make PYTHON=/path/to/python3.11' >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo 'Alight needs Python 3.11 or newer; $(PYTHON) is not. Name another: make PYTHON=/path/to/python3.11' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo '$(PYTHON) cannot make virtual environments; on Debian or Ubuntu: apt install python3-venv' >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $(MADE)
