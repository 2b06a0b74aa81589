# The two commands a newcomer needs are `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Pinned to a release whose default build is small on machines without a GPU.
TORCH := torch==2.13.0
STAMP := $(VENV)/.installed
PRODUCT := $(VENV)/.installed-product
COMPILED := $(VENV)/.compiled
KERNELS := $(shell grep -rlF --include='*.py' @kernel src laboratory/src)

.PHONY: demo test suite test-product test-tasks test-laboratory lint style types docs install clean

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: make PYTHON=python3.x"; exit 1; }
	@echo "installing into $(VENV): half a minute to two, quiet while pip works"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

# What a design needs on its way to a robot program: no PyTorch.
$(PRODUCT): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable '.[robot,video]'
	touch $@

$(STAMP): pyproject.toml laboratory/pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet $(TORCH)
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	$(BIN)/python -m pip install --quiet --no-deps --editable laboratory
	touch $@ $(PRODUCT)

# Whoever needs a function compiles it; here one process for each half of them does, before many that
# test need the same. So with the code of Python, also where processes are told to keep none.
$(COMPILED): $(VENV)/.compiled-tasks $(VENV)/.compiled-designs
	@$(BIN)/python -m compileall -q src laboratory/src tests laboratory/tests
	touch $@

$(VENV)/.compiled-tasks: BENCH := static_batch_actions_per_s static_single_steps_per_s \
	placements_single_steps_per_s objects_batch_actions_per_s rigid_actions_per_s \
	kinematic_actions_per_s decisions_per_s gradient_samples_per_s
$(VENV)/.compiled-designs: BENCH := designs_single_steps_per_s designs_fresh_steps_per_s \
	goals_single_steps_per_s dynamic_move_s exact_plan_s check_s brick_check_s
$(VENV)/.compiled-tasks $(VENV)/.compiled-designs: $(STAMP) $(KERNELS)
	@echo "compiling what has changed"; $(BIN)/l2a bench $(BENCH) --seconds 0.01 >/dev/null 2>&1
	touch $@

install: $(COMPILED)

demo: $(PRODUCT)
	rm -rf out/demo
	$(BIN)/l2a build examples/designs/gabled_house.json --arm panda --out out/demo

lint: style types

style: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# With the oldest Python that is supported, as types of NumPy differ from version to version.
types: $(STAMP)
	@if $(BIN)/python -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'; \
	then $(BIN)/pyright; else echo "types are checked with Python 3.11 only"; fi

docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

# A process for every core, each with one thread; one that is done takes over tests of the others.
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal

suite: $(COMPILED)
	$(PYTEST)

# Compiling takes two cores for a minute; types and documents, which build what they show, fill what
# tests that wait leave free.
test: $(STAMP)
	$(MAKE) --jobs 3 --output-sync=target $(COMPILED) style
	$(MAKE) --jobs 3 suite types docs

test-product test-tasks test-laboratory: $(COMPILED)
	$(PYTEST) -m $(subst test-,,$@)

clean:
	rm -rf $(VENV) out runs build dist
