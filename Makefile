# Two commands do everything on a fresh machine: `make demo` and `make test`. They need Python 3.10 or newer and venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test soak check lint smoke bench bench-quick clean

demo: $(VENV)/.demo
	$(BIN)/lookback demo -o demo

test: $(VENV)/.dev
	$(BIN)/python -m pytest

soak: $(VENV)/.dev
	$(BIN)/python -m pytest -m soak tests/faults

check: lint test smoke

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

smoke: $(VENV)/.dev
	$(BIN)/lookback demo -o demo --require-good

bench: $(VENV)/.dev
	$(BIN)/python -m sim.bench -o docs/bench.md

bench-quick: $(VENV)/.dev
	$(BIN)/python -m sim.bench --quick

clean:
	rm -rf $(VENV) demo build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.demo: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install -qq --editable '.[sim,page,desk]'
	touch $@

$(VENV)/.dev: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install -qq --editable '.[dev]'
	touch $@ $(VENV)/.demo
