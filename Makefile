# Each target does all the set-up that it needs; nothing but Python 3.11 or newer is expected of the machine.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: study test test-slow check docs clouds benchmarks clean

study: .venv/.installed
	$(BIN)/halfseen study --out runs/study

test: .venv/.installed
	$(BIN)/pytest -n auto --dist loadgroup

test-slow: .venv/.installed
	$(BIN)/pytest -m slow -n auto --dist loadgroup

check: .venv/.installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/lint-imports

docs: .venv/.installed
	$(BIN)/python -m sphinx -W --keep-going -q -E -a -b html docs runs/docs

clouds: .venv/.installed
	$(BIN)/python -m halfseen.scene

benchmarks: .venv/.installed
	for benchmark in benchmarks/*.py; do $(BIN)/python $$benchmark || exit 1; done

clean:
	rm -rf .venv runs

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "halfseen needs Python 3.11 or newer: set PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@
