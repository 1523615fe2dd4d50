# Every target first installs what it needs into .venv, if that is missing: half a minute for `demo` and `serve`.
PYTHON ?= python3
DURATION ?= 30
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
TESTS_READY := $(VENV)/.tests-ready
DOCS_READY := $(VENV)/.docs-ready
# uv does not read the settings of pip: the index and the certificates that pip is configured with are passed on.
PIP_SETTING = $$($(BIN)/pip config list | sed -n "s/.*\.$(1)='\(.*\)'/\1/p" | head -1)
UV = UV_DEFAULT_INDEX="$${UV_DEFAULT_INDEX:-$(call PIP_SETTING,index-url)}" SSL_CERT_FILE="$${SSL_CERT_FILE:-$(call PIP_SETTING,cert)}" $(BIN)/uv
CHECKED := --python $(BIN)/python --require-hashes

# On matrices as small as these, several BLAS threads are slower than one.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Python keeps what it has compiled, also where the shell says that it should not: the tests start it a hundred times.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help demo serve docs test quick check types audit fix bench soak prove lock clean

help:  ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## */  make \1\t/'

$(READY): .ci/installer.lock service/requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "dsbrdf needs Python 3.11 or newer; name one with: make PYTHON=python3.12 ...")'
	@echo "Creating the environment in $(VENV) ..."
	@$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r .ci/installer.lock
	@$(UV) pip sync $(CHECKED) service/requirements.lock
	@$(BIN)/uv pip install --python $(BIN)/python --offline --no-deps --no-build-isolation --editable .
	@touch $@

# Tests and checks need three times as many packages as the service.
$(TESTS_READY): $(READY) requirements.lock
	@$(UV) pip install $(CHECKED) -r requirements.lock
	@$(BIN)/python -m pytest --collect-only --quiet >/dev/null # else each worker would compile all tests
	@touch $@

$(DOCS_READY): $(READY) docs/requirements.lock
	@$(UV) pip install $(CHECKED) -r docs/requirements.lock
	@touch $@

demo: $(READY)  ## start the service, POST a measurement, print components and values, save a figure
	@$(BIN)/python -m examples.demo

serve: $(READY)  ## run the service on http://127.0.0.1:8000
	@$(BIN)/dsbrdf serve

docs: $(DOCS_READY)  ## build the documentation: docs/_build/html/index.html
	@$(BIN)/python docs/_ext/build.py

# Half of the time, tests wait for other processes: two workers more than there are cores, and at most four.
WORKERS = $$($(BIN)/python -c 'import os; print(min(os.cpu_count() + 2, 4))')

test: $(TESTS_READY)  ## run all tests, on up to four cores
	$(BIN)/python -m pytest --numprocesses=$(WORKERS) --no-loadscope-reorder

quick: $(TESTS_READY)  ## run the tests of library and service that are not marked as slow
	$(BIN)/python -m pytest --numprocesses=$(WORKERS) -m 'not slow' tests/library tests/service

check: $(TESTS_READY)  ## check format, lint, prose, types and security
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/python .ci/prose.py
	$(BIN)/mypy
	$(BIN)/bandit --quiet --recursive --configfile pyproject.toml dsbrdf service
	$(BIN)/zizmor --quiet --offline .github

TSC := .venv/typescript

types:  ## check the types of the page's modules
	@mkdir -p $(TSC) && cp .ci/package.json .ci/package-lock.json $(TSC)/ && npm ci --silent --prefix $(TSC)
	$(TSC)/node_modules/.bin/tsc --project .ci/tsconfig.json

audit: $(TESTS_READY)  ## check the pinned dependencies for known vulnerabilities
	@$(BIN)/python .ci/audit.py

fix: $(TESTS_READY)  ## format and repair what can be repaired automatically
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(TESTS_READY)  ## run the tests of the benchmarks, then all benchmarks except the long ones
	$(BIN)/python -m pytest --numprocesses=$(WORKERS) --dist=loadfile --timeout=0 benchmarks
	$(BIN)/python -m benchmarks

soak: $(TESTS_READY) $(DOCS_READY)  ## load the service for DURATION minutes (30), then run all tests with the full number of repeats
	$(BIN)/python -m benchmarks soak --minutes $(DURATION)
	DSBRDF_SOAK=1 $(BIN)/python -m pytest --timeout=0 tests benchmarks

prove:  ## build and run the images of docker/ on a fresh Debian root (as root)
	docker/prove.sh

COMPILE = $(UV) pip compile --universal --python-version 3.11 --upgrade --generate-hashes \
  --no-emit-index-url --no-emit-find-links --no-header --quiet

lock: $(READY)  ## pin the newest dependencies
	echo uv | $(COMPILE) - -o .ci/installer.lock
	$(COMPILE) pyproject.toml --all-extras --group build --group dev -o requirements.lock
	$(COMPILE) pyproject.toml --extra service --extra client --extra plot --extra cli --group build \
	  --constraint requirements.lock -o service/requirements.lock
	$(COMPILE) pyproject.toml --extra service --extra client --extra plot --extra cli --group docs \
	  --constraint requirements.lock -o docs/requirements.lock

clean:  ## remove the environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis out docs/_build docs/generated
