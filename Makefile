# Everything runs in .venv, which each target makes itself; only Python >= 3.11 and make are needed.
PYTHON ?= $(firstword $(shell .ci/pythons) $(shell command -v python3 || command -v python))
VENV ?= .venv
BIN := $(VENV)/bin
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q

.PHONY: demo test test-quick test-core test-all test-versions lint format notebooks lab docs benchmark benchmark-blind benchmark-reliability clean

demo: $(VENV)/installed
	$(BIN)/jaxid diagnose examples/servo_pendulum --out out/demo
	@echo "The report with pictures: out/demo/report.html"

# Tests that talk to emulators in real time run alone afterwards; a part without tests (exit code 5) is no failure.
test: $(VENV)/installed-dev
	$(PYTEST) -n auto --maxprocesses 2 --dist worksteal -m "not slow and not realtime" $(ARGS) || test $$? -eq 5
	$(PYTEST) -m "realtime and not slow" $(ARGS) || test $$? -eq 5

# What the change since the last such run touches, read off what each test has run; the first time that is all of it.
test-quick: $(VENV)/installed-dev
	$(PYTEST) --testmon --testmon-forceselect -n auto --maxprocesses 2 -m "not slow and not realtime" $(ARGS) || test $$? -eq 5

test-all: test
	$(PYTEST) -m slow $(ARGS) || test $$? -eq 5

# What depends on Python and JAX: enough where all the rest was tested with another Python.
CORE := tests/test_lanes.py tests/test_traced.py tests/test_step.py tests/test_versions.py
test-core: $(VENV)/installed-test
	$(PYTEST) -n auto --maxprocesses 2 --dist worksteal $(CORE) $(ARGS) || test $$? -eq 5

# The demo and the core of tests with every Python found and the versions of JAX from the oldest on; writes docs/versions.md.
test-versions: $(VENV)/installed
	$(BIN)/python benchmarks/versions.py $(ARGS)

lint: $(VENV)/installed-dev
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

benchmark: $(VENV)/installed-dev
	$(BIN)/python benchmarks/run_all.py $(ARGS)

# New blind cases (hours): make benchmark-blind SEED=29 BLIND="--models joint,servo --only effect,pair,control"
SEED ?= 0
benchmark-blind: $(VENV)/installed-dev
	$(BIN)/python benchmarks/blind.py --seed $(SEED) $(BLIND)
	$(BIN)/python benchmarks/run_all.py blind blind_summary

benchmark-reliability: $(VENV)/installed-dev
	$(BIN)/python benchmarks/run_all.py reliability study_throughput

# Every notebook with the small budgets, those of the papers too; the one that records in real time runs alone.
notebooks: $(VENV)/installed-dev
	$(PYTEST) -n auto --maxprocesses 2 --dist worksteal tests/test_notebooks.py $(ARGS)
	$(PYTEST) tests/test_hardware_end_to_end.py $(ARGS)

# The notebooks, which are kept as text, as .ipynb files beside them, opened in JupyterLab.
lab: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check jupyterlab jupytext
	$(BIN)/jupytext --quiet --to ipynb notebooks/*.py
	$(BIN)/jupyter lab notebooks

# The site with all notebooks executed in full; warnings are errors. Outputs are kept in out/docs_cache until a notebook
# or the budgets change; for those of changed library code `make clean` first.
docs: $(VENV)/installed-dev
	$(BIN)/python -m sphinx -E -W --keep-going -b html docs out/site
	@echo "The site: out/site/index.html"

clean:
	rm -rf .venv out build dist docs/notebooks docs/generated .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "jaxid needs Python 3.11 or newer; name one with: make PYTHON=/path/to/python3.11"; exit 1; }
	"$(PYTHON)" -m venv $(VENV)

# The stamps depend on pyproject.toml alone: the install is editable, so changed sources need no new one.
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable
$(VENV)/installed: pyproject.toml | $(BIN)/python
	$(INSTALL) ".[all]"
	@touch $@

$(VENV)/installed-test: pyproject.toml | $(BIN)/python
	$(INSTALL) ".[test]"
	@touch $(VENV)/installed $@

$(VENV)/installed-dev: pyproject.toml | $(BIN)/python
	$(INSTALL) ".[dev]"
	@touch $(VENV)/installed $(VENV)/installed-test $@
