# Two commands: `make demo` shows what coview does, `make test` says whether it is in order. Each sets up what it needs.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
SHAPES := --jaxtyping-packages=toolkit,models,placement_env,beartype.beartype

.PHONY: setup demo test test-all bench lint
setup: .venv/all

.venv/bin/python:
	$(PYTHON) -m venv .venv

# The demo needs the simulator only; the tests need everything.
.venv/sim: pyproject.toml constraints.txt | .venv/bin/python
	$(PIP) --editable ".[sim]"
	touch $@

.venv/all: pyproject.toml constraints.txt | .venv/bin/python
	$(PIP) --editable ".[all,dev]"
	touch $@ .venv/sim

demo: .venv/sim
	$(BIN)/coview demo --out out/demo

lint: .venv/all
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow" $(SHAPES)

test-all: lint
	$(BIN)/python -m pytest $(SHAPES)

bench: .venv/all
	for script in tests/benchmarks/bench_*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done
