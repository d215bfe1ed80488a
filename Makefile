# Spanwise: every job a developer or a user starts. Only python3 (3.11+), make and git are needed.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.stamp
NATIVE := companion/native
READY  := $(NATIVE)/kernels.so
SECONDS ?= 120
WAITING := $(addprefix sitl_tests/loop/,test_tour.py test_fleet_cluster.py test_missions.py)
REALTIME := $(filter-out $(WAITING),$(shell grep -rl --include='test_*.py' mark.realtime sitl_tests))
# where it is set, every process of every test compiles anew what it imports
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test long check native wheels sanitize fuzz fast lint types architecture generated bench trials lock clean help

help:            ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 16

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Spanwise needs Python 3.11 or newer; set PYTHON=/path/to/python3.11"; exit 1; }
	@echo "making $(VENV): the pinned packages are some 0.9 GB: minutes the first time, half a minute from the package cache"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-compile -r requirements.lock
	@{ command -v $(firstword $(CC)) || command -v gcc || command -v clang; } >/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-ziglang.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

$(READY): $(wildcard $(NATIVE)/*.[ch]) setup.py $(STAMP)
	@echo "compiling the inner loops: 15 s with gcc, a minute with ziglang"
	$(BIN)/python setup.py -q build_ext --inplace
	@touch $@

demo: $(READY)   ## fly the simulated aircraft and the service in lock-step and show the ranges
	$(BIN)/spanwise demo --world fair

test: $(READY)   ## the tests; those that start live processes come last, two or three side by side: they mostly wait
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not realtime and not long"
	$(BIN)/python -m pytest -n 3 -m "realtime and not long" $(WAITING)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "realtime and not long" $(REALTIME)

long: $(READY)   ## what takes minutes of processor time each: live demo, fault flights, blind trials, measured wings
	$(BIN)/python -m pytest -m long

check: lint types generated fast ## what must be green before a commit (under two minutes)

lint: $(READY)   ## ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)  ## mypy --strict on companion/
	$(BIN)/mypy

architecture: $(READY) ## the import table, purity of the core, no stray clocks
	$(BIN)/python -m pytest sitl_tests/architecture

generated: $(READY) ## generated files are fresh
	$(BIN)/spanwise params --check

fast: $(READY)
	$(BIN)/python -m pytest -n 2 -m "not slow and not realtime and not long"

native: $(READY) ## compile the inner loops in C (setup.py)

wheels: $(READY) ## wheels for x86_64 and aarch64 in dist/, compiled by the ziglang package
	@$(BIN)/python -c 'import ziglang' 2>/dev/null || $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-ziglang.lock
	$(BIN)/python -m tools.wheels

sanitize: $(READY) ## run the inner loops under the address and undefined-behaviour sanitizers
	$(BIN)/python -m pytest -m long sitl_tests/native/test_native_sanitized.py

bench: $(READY)  ## speed, memory and accuracy figures, side by side with the alternatives
	$(BIN)/python -m tools.bench

fuzz: $(READY)   ## hostile inputs to every reader, the decoder and the service for SECONDS=120; findings stay in out/fuzz
	$(BIN)/python -m sitl_tests.fuzz --seconds $(SECONDS) --jobs 2

trials: $(READY) ## blind trials of the diagnosis: table and confusion matrix in out/trials
	$(BIN)/python -m tools.trials

lock: $(STAMP)   ## pin every dependency with its hashes (needs uv)
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate --no-header --extra all --extra dev -q pyproject.toml requirements-build.in -o requirements.lock

clean:
	rm -rf $(VENV) out build dist *.egg-info $(READY)
