# Each target does all the set-up that it needs; nothing but Python 3.11 or newer is expected of the machine.
PYTHON ?= python3
# Where a machine forbids it, each process of the tests would compile all that it loads.
unexport PYTHONDONTWRITEBYTECODE
BIN := .venv/bin
PARALLEL := -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart 0

.PHONY: study test test-slow check docs pictures clouds benchmarks published fuzz wheel-test newest release audit image clean

study: .venv/.installed
	$(BIN)/halfseen study --out runs/study

test: .venv/.installed
	$(BIN)/pytest $(PARALLEL)

test-slow: .venv/.installed
	$(BIN)/pytest -m slow $(PARALLEL)

check: .venv/.installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/lint-imports

docs: .venv/.installed
	$(BIN)/python -m sphinx -W --keep-going -q -E -a -b html docs runs/docs

# All of them, or ONLY=name; with REMAKE=1 their numbers, too, which takes as long as the study.
pictures: .venv/.installed
	PYTHONPATH=docs $(BIN)/python -m pictures $(ONLY) $(if $(REMAKE),--remake)

clouds: .venv/.installed
	$(BIN)/python -m halfseen.scene
	$(BIN)/python -m halfseen.cell.facts

# Broken inputs and command lines; what fails is written to runs/fuzz. CASES and SEED say how many, and which.
fuzz: .venv/.installed
	cd tests && ../$(BIN)/python -m fuzz --cases $(or $(CASES),20000) --seed $(or $(SEED),0)

benchmarks: .venv/.installed
	for benchmark in benchmarks/*.py; do $(BIN)/python $$benchmark || exit 1; done

# What papers have printed beside ours and peers', all of them or ONLY=name, with as many REPETITIONS of each cell as wanted: an
# hour on an idle core. The page of the docs shows what it stores. One whose package is not installed says so, with status 3.
published: .venv/.installed
	for benchmark in benchmarks/published/$(or $(ONLY),*).py; do \
		PYTHONPATH=benchmarks $(BIN)/python $$benchmark $(if $(REPETITIONS),--repetitions $(REPETITIONS)) || [ $$? = 3 ] || exit 1; \
	done

# The wheel in a bare environment of PYTHON, away from the clone: the way of the README in five commands, and each verb without extras.
wheel-test:
	$(PYTHON) -m release.walk

# The way of the README with the newest of all that the wheel asks for, by each Python that is here: what breaks with a new
# version of something shows here first.
newest:
	$(PYTHON) -m release.walk --newest

# What is to be given away: dist. A version that the changelog does not date is refused; REHEARSE=1 builds it all the same.
release: .venv/.tools
	$(BIN)/python -m release $(if $(REHEARSE),--rehearse)

# Whether faults of what is pinned are known. A package that cannot be looked up fails, too: it was not found to be well.
audit: .venv/.tools
	$(BIN)/pip-audit --strict --disable-pip --no-deps --progress-spinner off --requirement constraints.txt

image:
	docker build --tag halfseen .

clean:
	rm -rf .venv runs

.venv/.installed: pyproject.toml constraints.txt src/halfseen/__init__.py
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "halfseen needs Python 3.11 or newer: set PYTHON=python3.11")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

.venv/.tools: .venv/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[release]'
	touch $@
