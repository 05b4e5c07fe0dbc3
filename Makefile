# make demo      trace a room, walk through it, map it: everything is set up first
# make test      run the tests, README snippets included
# make coverage  the same, and which lines of the estimator they ran
# make lint      style, types, directions of imports, known faults;  make format mends the style
# make setup     only the environment: .venv, pinned and checked by hash
# make soak      the long tests: Monte Carlo and traced acceptance, kills, broken bodies, load (half an hour)
# make requirements   pin anew after a change of pyproject.toml

VENV   := .venv
BIN    := $(VENV)/bin
PYTHON ?=
WORKERS ?= 2
PYTEST := $(BIN)/python -m pytest --numprocesses $(WORKERS)
PIP    := $(BIN)/python -m pip --disable-pip-version-check --quiet

# PYTHONNOUSERSITE: what a user has installed elsewhere must not leak in.
export PYTHONNOUSERSITE := 1

.DEFAULT_GOAL := help
.PHONY: help demo test coverage soak lint format setup requirements clean

help:
	@sed -n 's/^# //p' Makefile | head -7

demo: $(VENV)/.run
	@$(BIN)/hapslam demo $(ARGS)

test: $(VENV)/.dev
	@$(PYTEST) $(ARGS)

coverage: $(VENV)/.dev
	@NUMBA_DISABLE_JIT=1 $(PYTEST) -m interpreted -q
	@$(PYTEST) --cov --cov-report=term:skip-covered $(ARGS)

soak: $(VENV)/.dev
	@HAPSLAM_TEST_KILLS=200 HAPSLAM_TEST_RESTARTS=10 HAPSLAM_TEST_BODIES=2000 HAPSLAM_TEST_EXAMPLES=100 \
	    HAPSLAM_TEST_HOSTILE=5000 \
	    $(BIN)/python -m pytest -m "soak or not soak" \
	    tests/service/storage/test_durability.py tests/service/api/test_fuzz.py \
	    tests/service/api/test_hostile_files.py $(ARGS)
	@$(BIN)/python -m pytest -m soak $(ARGS)
	@$(BIN)/hapslam bench --only service

lint: $(VENV)/.dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports
	@$(BIN)/bandit -q -c pyproject.toml -r estimator raytrace service
	@$(PIP) check

format: $(VENV)/.dev
	@$(BIN)/ruff check --fix-only .
	@$(BIN)/ruff format .

setup: $(VENV)/.dev

# A Python of 3.11 or newer that can make environments: $(PYTHON) if given, or the first found.
$(VENV)/.python: requirements/find-python
	@python=$$(sh requirements/find-python $(PYTHON)) && \
	echo "setup: making $(VENV) with $$($$python --version)" && \
	$$python -m venv --clear $(VENV)
	@touch $@

$(VENV)/.run: $(VENV)/.python pyproject.toml requirements/run.txt
	@echo "setup: installing what hapslam needs (pinned, checked by hash; a minute or two)"
	@$(PIP) install --require-hashes -r requirements/run.txt
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.run requirements/dev.txt
	@echo "setup: installing the tools of the tests"
	@$(PIP) install --require-hashes -r requirements/dev.txt
	@touch $@

# uv resolves for all Pythons and platforms at once; it is fetched for this target alone.
COMPILE := build/uv/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
           --no-emit-index-url --no-annotate --custom-compile-command "make requirements" \
           pyproject.toml --extra raytrace --extra plans --group build
requirements: $(VENV)/.python
	@$(BIN)/python -m venv build/uv && build/uv/bin/python -m pip install --quiet uv
	@$(COMPILE) --group dev $(ARGS) -o requirements/dev.txt
	@$(COMPILE) -c requirements/dev.txt -o requirements/run.txt

clean:
	rm -rf $(VENV) build dist .mypy_cache .pytest_cache .ruff_cache .import_linter_cache .coverage
