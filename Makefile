# Each target does all the set-up that it needs; nothing but Python 3.11 or newer is expected of the machine.
PYTHON ?= python3
BIN := .venv/bin
PARALLEL := -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart 0

.PHONY: study test test-slow check docs pictures clouds benchmarks clean

study: .venv/.installed
	$(BIN)/halfseen study --out runs/study

test: .venv/.installed
	$(BIN)/pytest $(PARALLEL)

# These compute as much as they compile: XLA optimises, as it does for the study.
test-slow: .venv/.installed
	XLA_FLAGS="--xla_backend_optimization_level=1 --xla_cpu_use_fusion_emitters=false" $(BIN)/pytest -m slow $(PARALLEL)

check: .venv/.installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/lint-imports

docs: .venv/.installed
	$(BIN)/python -m sphinx -W --keep-going -q -E -a -b html docs runs/docs

# All of them, or ONLY=name; with ANEW=1 their numbers, too, which takes as long as the study.
pictures: .venv/.installed
	PYTHONPATH=docs $(BIN)/python -m pictures $(ONLY) $(if $(ANEW),--anew)

clouds: .venv/.installed
	$(BIN)/python -m halfseen.scene
	$(BIN)/python -m halfseen.cell.tables_seen

benchmarks: .venv/.installed
	for benchmark in benchmarks/*.py; do $(BIN)/python $$benchmark || exit 1; done

clean:
	rm -rf .venv runs

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "halfseen needs Python 3.11 or newer: set PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@
