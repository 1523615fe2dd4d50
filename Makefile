# Every target first creates the environment in .venv if it is missing, which takes about a minute.
PYTHON ?= python3
DURATION ?= 30
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DOCS_READY := $(VENV)/.docs-ready

# On matrices as small as these, several BLAS threads are slower than one.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Python keeps what it has compiled, also where the shell says that it should not: the tests start it a hundred times.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help demo serve docs test quick check types audit fix bench soak prove lock clean

help:  ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## */  make \1\t/'

$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "dsbrdf needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

# What builds the documentation is a third of all packages and is needed for nothing else: it is installed only here.
$(DOCS_READY): $(READY) docs/requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r docs/requirements.lock
	@touch $@

demo: $(READY)  ## start the service, POST a measurement, print lobes and values, save a figure
	@$(BIN)/python -m examples.demo

serve: $(READY)  ## run the service on http://127.0.0.1:8000
	@$(BIN)/dsbrdf serve

docs: $(DOCS_READY)  ## build the documentation: docs/_build/html/index.html
	@$(BIN)/python docs/_ext/build.py

test: $(READY)  ## run all tests, on up to four cores
	$(BIN)/python -m pytest --numprocesses=logical --maxprocesses=4 --dist=loadfile --no-loadscope-reorder

quick: $(READY)  ## run the tests of library and service that are not marked as slow
	$(BIN)/python -m pytest --numprocesses=logical --maxprocesses=4 --dist=loadfile -m 'not slow' tests/library tests/service

check: $(READY)  ## check format, lint, types and security
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/bandit --quiet --recursive --configfile pyproject.toml dsbrdf service

TSC := .venv/typescript

types:  ## check the types of the page's modules
	@mkdir -p $(TSC) && cp .ci/package.json .ci/package-lock.json $(TSC)/ && npm ci --silent --prefix $(TSC)
	$(TSC)/node_modules/.bin/tsc --project .ci/tsconfig.json

audit: $(READY)  ## check the pinned dependencies for known vulnerabilities
	@$(BIN)/python .ci/audit.py

fix: $(READY)  ## format and repair what can be repaired automatically
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(READY)  ## run all benchmarks except the long ones
	$(BIN)/python -m benchmarks

soak: $(READY)  ## load the service for DURATION minutes (30), then run all tests with the full number of repeats
	$(BIN)/python -m benchmarks soak --minutes $(DURATION)
	DSBRDF_SOAK=1 $(BIN)/python -m pytest

prove:  ## build and run the images of docker/ on a fresh Debian root (as root)
	docker/prove.sh

lock: $(READY)  ## pin the newest dependencies
	$(PYTHON) -m venv $(VENV)/lock && $(VENV)/lock/bin/pip install --quiet uv
	$(VENV)/lock/bin/uv pip compile pyproject.toml --all-extras --group dev --universal --python-version 3.11 --upgrade \
	  --generate-hashes --no-emit-index-url --no-emit-find-links --no-header --quiet -o requirements.lock
	$(VENV)/lock/bin/uv pip compile pyproject.toml --extra service --extra client --extra plot --extra cli \
	  --group docs --universal --python-version 3.11 --upgrade \
	  --constraint requirements.lock \
	  --generate-hashes --no-emit-index-url --no-emit-find-links --no-header --quiet -o docs/requirements.lock

clean:  ## remove the environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis out docs/_build docs/generated
