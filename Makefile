# make demo   set up and fit an example: is everything in place?
# make test   set up and run the tests
# make quick  set up and run those that neither compile a fit nor start a process: under a minute
# make fuzz   set up and try hostile input for a minute; more: make fuzz FUZZ='--count 100000'
# make lint   set up and check style and types
# make blender  set up Blender as a Python module (370 MB) and try the add-on, files, exports and fits there; more:
#             COUNT=100 cloths, less: PARTS='formats cloths'
# make newest try the compiled code with the newest numba, release candidates included
# make docs   write the pages on all commands and on all public Python names into build/docs
# make gallery  make the films of the documents anew
# make clean  remove what these made
#
# Needs Python 3.11 or newer and nothing else; another one than python3: make test PYTHON=python3.12
# All use the environment in .venv, into which the package is installed editable, once, and again when pyproject.toml
# changes.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

FUZZ := --seconds 60

# Blender's module wants Python 3.11 and an older NumPy, so it has an environment of its own; another one: CLOTHFIT_BPY
BLENDER := .venv-blender
BPY := bpy==4.2.23
COUNT := 10
PARTS := formats cloths fits
IN_BLENDER := tests/blender tests/simulators/test_in_blender.py

DEMO := examples/corners.json
FITTED := build/demo/corners.fitted.json

.PHONY: help demo test quick fuzz blender lint newest docs gallery clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

demo: $(VENV)/installed
	@mkdir -p $(dir $(FITTED))
	@echo "\$$ clothfit estimate $(DEMO) -o $(FITTED)"
	@$(BIN)/clothfit estimate $(DEMO) -o $(FITTED)
	@echo "\$$ clothfit evaluate $(DEMO) $(FITTED)"
	@$(BIN)/clothfit evaluate $(DEMO) $(FITTED)

# One more than processors: a fifth of the time of a test is waiting, for a browser or another process.
WORKERS = $(shell $(PYTHON) -c 'import os; print(min(4, 1 + (os.cpu_count() or 1)))')

# Python keeps what it makes of each module, whatever the environment says: tests start hundreds of processes, and each
# would begin with the whole package, and pytest with all tests.
test quick: export PYTHONDONTWRITEBYTECODE :=

test: $(VENV)/installed-test
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal

quick: $(VENV)/installed-test
	$(BIN)/python -m pytest -q -m quick -n $(WORKERS) --dist worksteal

fuzz: $(VENV)/installed-test
	cd tests && ../$(BIN)/python -m fuzz --keep ../build/faults $(FUZZ)

# Where Blender cannot be had this says so in one line, and is no error.
blender: $(VENV)/installed-test
	@test -n "$$CLOTHFIT_BPY" || test -f $(BLENDER)/installed || { $(PYTHON) -m venv --clear $(BLENDER) && \
	    $(BLENDER)/bin/python -m pip --disable-pip-version-check --quiet install $(BPY) 'numpy<2' 2>/dev/null && \
	    touch $(BLENDER)/installed; } || echo "skipped: $(BPY) cannot be installed for $$($(PYTHON) --version 2>&1)"
	@test -z "$$CLOTHFIT_BPY" -a ! -f $(BLENDER)/installed || \
	    { export CLOTHFIT_BPY=$${CLOTHFIT_BPY:-$(CURDIR)/$(BLENDER)/bin/python}; $(BIN)/python -m pytest -q $(IN_BLENDER) && \
	    $(BIN)/python benchmarks/in_blender.py $(PARTS) --count $(COUNT); }

# types of the optional libraries are looked up as well
lint: $(VENV)/installed-test $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/mypy

# What compiles rests on parts of numba that may change with any version (clothfit/kernels/__init__.py).
newest: $(VENV)/made
	@$(PYTHON) -m venv --clear $(VENV)-newest
	@$(VENV)-newest/bin/python -m pip --disable-pip-version-check --quiet install --editable . pytest tornado 2>/dev/null
	@$(VENV)-newest/bin/python -m pip --disable-pip-version-check --quiet install --upgrade --pre numba 2>/dev/null
	@$(VENV)-newest/bin/python -c 'import numba; print("numba", numba.__version__)'
	NUMBA_CACHE_DIR=$(CURDIR)/build/newest $(VENV)-newest/bin/python -m pytest -q tests/kernels/test_records.py \
	    tests/kernels/test_linking.py tests/kernels/test_helper.py

docs: $(VENV)/installed
	$(BIN)/python docs/commands.py
	$(BIN)/python docs/python.py

gallery: $(VENV)/installed-plot build/shots/made
	$(BIN)/python docs/gallery.py
	$(BIN)/python docs/strangers.py build/shots

# What is not there of the other programs is left out, and its shots stay as they are.
build/shots/made:
	$(PYTHON) -m venv --clear build/shots-venv
	-build/shots-venv/bin/python -m pip --disable-pip-version-check --quiet install mujoco newton warp-lang
	-build/shots-venv/bin/python -m pip --disable-pip-version-check --quiet install pybullet
	mkdir -p build/shots
	-build/shots-venv/bin/python benchmarks/shots/with_mujoco.py build/shots mujoco-flag mujoco-ball
	-build/shots-venv/bin/python benchmarks/shots/with_newton.py build/shots newton-skirt newton-wind
	-build/shots-venv/bin/python benchmarks/shots/with_pybullet.py build/shots bullet-flag
	-test ! -x $(BLENDER)/bin/python || $(BLENDER)/bin/python benchmarks/shots/with_bpy.py build/shots blender-wind-2
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-newest $(BLENDER) build dist .pytest_cache .ruff_cache .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Stamps: each is written when all of its recipe has succeeded.
$(VENV)/installed: pyproject.toml $(VENV)/made
	@echo "installing clothfit into $(VENV)"
	@$(PIP) install --editable .
	@touch $@

$(VENV)/installed-%: $(VENV)/installed
	@echo "installing what $* needs"
	@$(PIP) install --editable '.[$*]'
	@touch $@

$(VENV)/made:
	@command -v $(PYTHON) >/dev/null || { echo "error: there is no $(PYTHON); install Python 3.11 or newer," \
	    "or name one: make PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "error: clothfit needs Python 3.11 or" \
	    "newer, and $(PYTHON) is $$($(PYTHON) --version 2>&1); name another: make PYTHON=python3.11" >&2; exit 1; }
	@echo "making the environment $(VENV) with $$($(PYTHON) --version 2>&1)"
	@$(PYTHON) -m venv --clear $(VENV)
	@touch $@

.PRECIOUS: $(VENV)/installed-%
