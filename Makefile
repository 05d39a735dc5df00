# Python 3.11 or newer, make and a package index are all that is needed: pip fetches a C compiler where there is none.
# `make PYTHON=python3.12 ...` chooses the interpreter; a venv made by another Python version is made anew.

PYTHON ?= python3
VENV ?= .venv
DEMO_VENV ?= .venv-demo
ARGS ?=

ROOMS := core trials models trajectories ctrl codegen sim rig gap testing bench tasks cli
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)
# Wheels only: a missing one is said in a line instead of in a compiler's output.
INSTALL := -m pip install --quiet --disable-pip-version-check --only-binary :all: --constraint constraints.txt

# Each pytest worker keeps to one core; more threads than cores slow the suite down and make it noisy.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
# Compiled bytecode is kept whatever the shell says: without it each worker compiles the package and the tests anew.
PYTEST = $(ONE_THREAD) PYTHONDONTWRITEBYTECODE= $(VENV)/bin/python -m pytest -n auto --dist worksteal

.DEFAULT_GOAL := help
.PHONY: help demo test test-fast test-matrix lint format types docs wheel-test dist bench clean distclean

help: ## list these targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(DEMO_VENV)/.installed ## simulated closed-loop comparison without torch; leaves demo/report.html
	$(DEMO_VENV)/bin/hystmpc demo $(ARGS)
	@echo "To go on in this shell:          . $(DEMO_VENV)/bin/activate && hystmpc --help"
	@echo "In an environment of your own:   pip install '.[train,tune,logs]'"
	@echo "Extras: train (networks), tune, env (gymnasium), logs (MCAP, ROS bags, Excel, TDMS), rig (DDS), dev; the studies: ./lab"

test: $(VENV)/.installed ## the whole suite; ARGS="tests/ctrl -x" is handed to pytest
	$(PYTEST) $(ARGS)

test-fast: $(VENV)/.installed ## the suite without its slow part, about two minutes on two cores
	$(PYTEST) -m "not slow" $(ARGS)

test-matrix: $(VENV)/.installed ## the fast tests with every Python found, with pinned and lowest versions; ARGS="--python 3.12 --set lowest"
	$(VENV)/bin/python lab/benchmarks/matrix.py $(ARGS)

lint: $(VENV)/.installed ## ruff: rules and formatting
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

format: $(VENV)/.installed ## sort the imports and lay out the code as `make lint` wants it
	$(VENV)/bin/ruff check --select I --fix .
	$(VENV)/bin/ruff format .

types: $(VENV)/.installed ## mypy (strict) and pyright
	@mkdir -p .typecheck/hystmpc
	@for part in $(ROOMS) __init__.py py.typed; do ln -sfn ../../$$part .typecheck/hystmpc/$$part; done
	@ln -sfn ../lab .typecheck/hystmpc_lab
	cd .typecheck && "$(abspath $(VENV))/bin/mypy" --config-file ../pyproject.toml -p hystmpc -p hystmpc_lab
	$(VENV)/bin/pyright --pythonpath $(VENV)/bin/python

docs: $(VENV)/.installed ## the site with API, commands and configuration keys: site/index.html opens without a network
	$(ONE_THREAD) $(VENV)/bin/python -m sphinx -b html -n -W --keep-going -q $(ARGS) docs site
	@echo "site/index.html"

# The suite runs on an editable install, where a package or data file that pyproject.toml forgets is found all the same.
wheel-test: $(VENV)/.installed ## build sdist and wheels, install that of hystmpc alone in an empty venv, test it there, add the laboratory
	@set -e; folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; \
	$(VENV)/bin/python -m build --outdir "$$folder/dist" . > "$$folder/build.log" || { cat "$$folder/build.log"; exit 1; }; \
	$(VENV)/bin/python -m build --outdir "$$folder/lab" lab > "$$folder/build.log" || { cat "$$folder/build.log"; exit 1; }; \
	ls "$$folder/dist" "$$folder/lab"; \
	$(VENV)/bin/python -m venv "$$folder/venv"; \
	"$$folder/venv/bin/python" $(INSTALL) "$$folder"/dist/*.whl pytest ziglang; \
	cp -r tests/wheel "$$folder/wheel"; \
	(cd "$$folder/wheel"; \
	HYSTMPC_CHECKOUT="$(CURDIR)" HYSTMPC_WHEEL="$$(ls "$$folder"/dist/*.whl)" ../venv/bin/python -m pytest -q $(ARGS) .); \
	"$$folder/venv/bin/python" $(INSTALL) --no-deps "$$folder"/lab/*.whl; \
	"$$folder/venv/bin/hystmpc" study --help | grep -q "Do all jobs of a study"

dist: $(VENV)/.installed ## wheel and sdist of the last commit, built twice: the same bytes each time
	$(VENV)/bin/python lab/benchmarks/dist.py $(ARGS)

bench: $(VENV)/.installed ## time the roll-outs and controllers on this machine
	$(VENV)/bin/hystmpc bench $(ARGS)

clean: ## remove caches and build products; run folders and venvs stay
	rm -rf lab/build .matrix .typecheck .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks build dist site docs/*/drawn docs/gallery docs/sg_execution_times.rst ./*.egg-info
	find . -path './.venv*' -prune -o -name __pycache__ -prune -exec rm -rf {} +

distclean: clean ## also remove the venvs
	rm -rf $(VENV) $(DEMO_VENV)

VENVS := $(VENV) $(DEMO_VENV)
EXTRAS :=
LAB :=
$(VENV)/.installed: EXTRAS := [train,tune,env,logs,rig,docs,dev]
$(VENV)/.installed: LAB := --editable "./lab[bench]"
# Editable, so that nothing is installed again after a change of code.
$(VENVS:%=%/.installed): %/.installed: %/.python-$(VERSION) pyproject.toml lab/pyproject.toml constraints.txt
	$*/bin/python $(INSTALL) --editable ".$(EXTRAS)" $(LAB)
	@touch $@

$(VENVS:%=%/.python-$(VERSION)):
	@test -n "$(VERSION)" || { echo "error: $(PYTHON) does not run; name a Python >= 3.11: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "error: $(PYTHON) is Python $(VERSION), expected >= 3.11; name another: make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv --clear $(@D)
	@touch $@
