# Two commands on a fresh machine with Python >= 3.11:
#   make run    set up, run the default suite, print the comparison table and the report's path
#   make test   set up, then lint, types and tests
# And: make benchmark   set up, run every benchmark in a short form, print what each costs
#      make soak        set up, kill, starve and copy runs for about an hour, print whether they came back whole
#      make docs        set up, build the documentation as a site in build/docs; a warning is an error
#      make dist        set up, build sdist and wheels in dist/: a plain one, and one with compiled kernels for this Python
#      make fuzz        set up, feed 10000 damaged inputs to each reader of files and arguments (INPUTS=n: n of them)
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
export PYTHONSAFEPATH := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# pip compiles nothing, so the first process that imports a module keeps its bytecode for all later ones.
export PYTHONDONTWRITEBYTECODE :=

SOURCES := $(shell find nrbench synthesizers metrics datasets_procedural reports -name '*.py' -o -name '*.pyi' -o -name '*.toml' -o -path '*templates/*')

.PHONY: run test lint types unit benchmark soak fuzz docs dist clean

run: $(VENV)/.installed
	$(BIN)/nrbench run --out runs/default

# Lint and types are checked beside the tests, of which some wait; each of the three can fail the target.
test: $(VENV)/.installed-test
	$(MAKE) -O lint types & checks=$$!; $(MAKE) unit; tests=$$?; wait $$checks && exit $$tests

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m pytest tests/core/test_docstrings.py -k complete

types: $(VENV)/.installed-test
	cd $(VENV) && bin/mypy --config-file "$(CURDIR)/pyproject.toml" -p nrbench

unit: $(VENV)/.installed-test
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal

fuzz: $(VENV)/.installed-test
	NRBENCH_FUZZ=$(or $(INPUTS),10000) $(BIN)/python -m pytest tests/core/test_untrusted_input.py

benchmark: $(VENV)/.installed-test
	env -u PYTHONSAFEPATH $(BIN)/python benchmarks/all.py

soak: $(VENV)/.installed-test
	env -u PYTHONSAFEPATH $(BIN)/python benchmarks/soak.py

docs: $(VENV)/.installed-docs
	$(BIN)/python benchmarks/gallery.py $(PHOTOGRAPHS)
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs build/docs
	@echo "the site: build/docs/index.html"

# The second wheel is for Linux on x86-64-v3, which most x86-64 processors since 2015 are, and for the Python and the numba
# that build it. With others, nrbench compiles the kernels when it needs them.
dist: $(VENV)/.installed-docs
	rm -rf dist build/lib build/bdist* nrbench/machine_code
	$(BIN)/python -m build --outdir dist .
ifeq ($(shell uname -sm),Linux x86_64)
	NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES= NUMBA_CACHE_DIR=nrbench/machine_code \
		$(BIN)/python -c "from nrbench.running.worker import warm; warm(lambda: None)"
	$(BIN)/python -m build --wheel --outdir dist -C--build-option=--plat-name=manylinux_2_28_x86_64 \
		-C--build-option=--python-tag=$$($(BIN)/python -c "import sys; print('cp%d%d' % sys.version_info[:2])") .
	rm -rf nrbench/machine_code build/lib
endif

# An older pip takes twice as long.
$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)
	-$(BIN)/pip install --quiet --no-compile --upgrade pip

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml $(SOURCES)
	rm -rf build
	$(BIN)/pip install --quiet --no-compile --upgrade .
	@touch $@

$(VENV)/.installed-test: $(VENV)/bin/python pyproject.toml $(SOURCES)
	rm -rf build
	$(BIN)/pip install --quiet --upgrade ".[test]"
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: $(VENV)/bin/python pyproject.toml $(SOURCES)
	rm -rf build/lib build/bdist*
	$(BIN)/pip install --quiet --upgrade ".[docs]"
	@touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache
