# make demo    the paper's table and figures, and four estimators compared in a room and in a building mesh
# make test    lint, types and tests, these in three processes: some wait for what hangs
# make study   what takes too long for every change: a hundred thousand hostile readings for each estimator
# make fuzz    input files of all kinds changed at random, some thousands of them: about ten minutes
# make chaos   commands killed at random moments, and plug-ins that misbehave: about an hour
# make bench   speed against other libraries
# make lint    format and lint only
# make honesty  the page of who is honest where: every estimator on random problems, about ten minutes
# make recordings  the table of docs/recordings.md: every estimator on real recordings, about ten minutes
# make planning  the page of what planned beams are worth, in three maps: two hours of a core; PLANNING_RUNS sets the runs
# make growth  the figure and table of docs/benchmarks.md on how time and memory grow: about a quarter of an hour
# make docs    this project's pages, into docs/_build/html; DOCS_RUNS sets the runs of the gallery's figures
# All of them make .venv first if need be; a second call is quick. Nothing but pip and Python 3.11 is needed.

PYTHON ?= python3
VENV := .venv
ifeq ($(origin PYTHON),command line)  # make test PYTHON=python3.12: an environment of its own, .venv-3.12
VENV := .venv-$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
endif
BIN := $(VENV)/bin
BENCH := $(VENV)/bench
BENCH_JAX := $(VENV)/bench-jax
OUT ?= results
BUILDING ?= ../shared/data/avz/avz.ply
RECORDINGS ?= ../shared/data
RUNS ?= 1000
BUILDING_RUNS ?= 400
DOCS_RUNS ?= 200
PLANNING_RUNS ?= 400
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: demo demo-room demo-building test study fuzz chaos bench honesty recordings planning growth docs lint clean

demo: $(VENV)/.base
	@mkdir -p $(OUT)
	@echo "A room and a building, both at once: the building's table comes last."
	@$(MAKE) --no-print-directory demo-building > $(OUT)/building.txt 2>&1 & building=$$!; \
	$(MAKE) --no-print-directory demo-room; room=$$?; \
	wait $$building; status=$$?; cat $(OUT)/building.txt; test $$room = 0 && test $$status = 0
	@echo "Pictures: $(OUT)/paper/figures  $(OUT)/room/figures  $(OUT)/building/figures"

demo-room:
	$(BIN)/rangefix paper --out $(OUT)/paper
	$(BIN)/rangefix run paper --runs $(RUNS) --out $(OUT)/room
	$(BIN)/rangefix plot $(OUT)/room > $(OUT)/room/figures.txt

demo-building:
ifneq ($(wildcard $(BUILDING)),)
	$(BIN)/rangefix run mesh --map $(BUILDING) --runs $(BUILDING_RUNS) --out $(OUT)/building
else
	@echo "No mesh at $(BUILDING): a small building is made up instead."
	$(BIN)/python docs/demo/make_building.py $(OUT)/building.ply
	$(BIN)/rangefix run docs/demo/building.toml --map $(OUT)/building.ply --runs $(BUILDING_RUNS) --out $(OUT)/building
endif
	$(BIN)/rangefix plot $(OUT)/building > $(OUT)/building/figures.txt

test: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@echo "Types are checked while the tests run; what is found comes last."
	@$(BIN)/mypy > $(VENV)/types.txt 2>&1 & types=$$!; \
	$(BIN)/python -m pytest -n 3 --dist worksteal -m "not benchmark and not study and not fuzz and not chaos"; tests=$$?; \
	wait $$types; status=$$?; cat $(VENV)/types.txt; test $$tests = 0 && test $$status = 0

study: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 -m study

fuzz: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 -m fuzz -rP

chaos: $(VENV)/.test
	$(BIN)/python -m pytest -n 2 -m chaos -rP

bench: $(BENCH)/.done $(BENCH_JAX)/.done  # both, whether or not the first misses a target
	failed=0; \
	BENCH_JSON=$(OUT)/bench.json $(BENCH)/bin/python -m pytest -q tests/benchmarks -m benchmark \
		--ignore=tests/benchmarks/test_jax_peers.py --benchmark-columns=min,median,rounds || failed=1; \
	BENCH_JSON=$(OUT)/bench-jax.json NUMBA_NUM_THREADS=1 XLA_FLAGS=--xla_cpu_multi_thread_eigen=false \
		$(BENCH_JAX)/bin/python -m pytest -q tests/benchmarks/test_jax_peers.py -m benchmark || failed=1; \
	exit $$failed

honesty: $(VENV)/.test
	$(BIN)/python docs/make_honesty.py

recordings: $(VENV)/.test
	$(BIN)/python docs/make_recordings.py --data $(RECORDINGS)

planning: $(VENV)/.test
	$(BIN)/python docs/make_planning.py --small --runs $(PLANNING_RUNS) --building $(BUILDING)

growth: $(VENV)/.test
	$(BIN)/python docs/make_growth.py --million

docs: $(VENV)/.docs
	$(BIN)/python docs/make_gallery.py --runs $(DOCS_RUNS) --out docs/gallery
	$(BIN)/sphinx-build --fail-on-warning --keep-going --nitpicky -q docs docs/_build/html
	@echo "Pages: docs/_build/html/index.html"

lint: $(VENV)/.test
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:
	rm -rf $(VENV) $(OUT) build dist docs/_build docs/gallery

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.base: pyproject.toml | $(BIN)/python
	$(PIP) --editable .
	@$(BIN)/python -m compileall -q src  # as pip does with what it copies
	@touch $@

$(VENV)/.test: pyproject.toml | $(BIN)/python
	$(PIP) --editable ".[test]"
	@$(BIN)/python -m compileall -q src
	@touch $@ $(VENV)/.base

$(VENV)/.docs: pyproject.toml | $(BIN)/python
	$(PIP) --editable ".[docs]"
	@touch $@ $(VENV)/.base

$(BENCH)/.done: pyproject.toml  # apart: the peers hold numpy below 2
	$(PYTHON) -m venv $(BENCH)
	$(BENCH)/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[bench]"
	@touch $@

$(BENCH_JAX)/.done: pyproject.toml  # apart: the peers ask for numpy 2
	$(PYTHON) -m venv $(BENCH_JAX)
	$(BENCH_JAX)/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[bench-jax]"
	@touch $@
