# Two commands of the README do everything, set-up included: `make demo` and `make test`.
# Everything is installed into .venv from requirements.lock (versions and hashes).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PY := $(BIN)/python
# Errors alone: pip's warnings are about its own configuration, or about who runs it.
PIP := $(PY) -m pip install --quiet --quiet --disable-pip-version-check
STAMP := $(VENV)/.installed
# An editable install knows the modules that there were when it was made: a new one needs another.
MODULES := $(VENV)/.modules-$(shell find src/fraclink prove/src -name '*.py' | LC_ALL=C sort | cksum | cut -d' ' -f1)
CSRC := $(wildcard csrc/*.[ch] csrc/kernels/*.[ch] csrc/bindings/*.cpp csrc/bindings/*.h)

.PHONY: setup demo test quick coverage lint bench build docs fuzz reproduce clean lock dist-check interpreters

setup: $(VENV)/.locked $(VENV)/.proving

$(BIN)/python:
	@echo "setting up $(VENV), once"
	@$(PYTHON) -m venv $(VENV)

# What a run and the compiler need: a third of the whole. Compiled where it is imported, not all at once.
$(VENV)/.demo: requirements-demo.lock | $(BIN)/python
	@$(PIP) --no-compile --require-hashes -r requirements-demo.lock
	@touch $@

$(VENV)/.locked: requirements.lock | $(VENV)/.demo
	@$(PIP) --no-compile --require-hashes -r requirements.lock
	@touch $@

$(MODULES): | $(VENV)/.demo
	@rm -f $(VENV)/.modules-*
	@touch $@

$(STAMP): $(VENV)/.demo $(MODULES) pyproject.toml CMakeLists.txt $(CSRC)
	@$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.proving: $(STAMP) prove/pyproject.toml
	@$(PIP) --no-deps --no-build-isolation --editable prove
	@touch $@

build: setup

demo: $(STAMP)
	@$(BIN)/fraclink run --rig paper-2023-geared --log demo --out results/demo --certify --force

# Their tests start browsers, solvers, compilers, a fuzzer, a cluster: in a run of their own, which has loaded
# little else.
LARGE := tests/test_arm_page.py tests/test_campaign_cluster.py tests/test_engine.py tests/test_export_fmu_sources.py \
  tests/test_export_gates.py tests/test_report.py tests/test_studio_browser.py prove/tests

# Two workers share nothing but the processor; a file's tests stay together, because their fixtures are dear.
# 1 is pytest's code for tests that failed: the others are tried, too. What interrupted it ends all.
test: setup
	@$(PY) -m pytest $(LARGE); large=$$?; [ $$large -le 1 ] || exit $$large; \
	  $(PY) -m pytest -n 2 --dist loadfile $(LARGE:%=--ignore=%) && exit $$large

# What a contributor runs before every commit: under a minute on two cores.
quick: setup
	@$(PY) -m pytest -n 2 --dist loadfile -m "not slow" tests

# From Python 3.12 on the interpreter reports lines by itself; on 3.11 a tracer costs half the time again.
coverage: setup
	export COVERAGE_CORE=$$($(PY) -c 'import sys; print("sysmon" if sys.version_info >= (3, 12) else "ctrace")'); \
	$(PY) -m pytest --cov=fraclink --cov-report= $(LARGE) && \
	$(PY) -m pytest -n 2 --dist loadfile --cov=fraclink --cov-append --cov-report=term:skip-covered \
	  --cov-fail-under=90 $(LARGE:%=--ignore=%)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --config-file tests/mypy.ini

bench: setup
	$(PY) benchmarks/run.py

fuzz: setup
	$(PY) tools/fuzz_law.py --seconds 60

docs: setup
	$(BIN)/sphinx-build --quiet --jobs auto --fail-on-warning --keep-going -b html docs docs/_build/html
	@echo docs/_build/html/index.html

# sdist, the wheel from it, and the README's session with the wheel alone: build/dist holds both.
dist-check: setup
	@$(PY) tools/check_dist.py

reproduce: setup
	$(PY) -m reproduce

# Versions and hashes for every Python and system; the demo's are a part of the whole.
LOCK := $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
  --no-emit-index-url --no-emit-find-links
lock: setup
	$(LOCK) requirements.in -o requirements.lock
	$(LOCK) -c requirements.lock requirements-demo.in -o requirements-demo.lock

# The core's tests, as other interpreters and versions of its libraries run them.
CORE_TESTS := $(patsubst %,tests/test_%.py,validate files fractional link loop motor rig experiment identify design \
  law certify simulate export cli stability_margins stability_norms interop readers_text readers_binary report plots)

# On every interpreter of this machine, with the newest and the lowest versions that pyproject.toml allows.
interpreters: setup
	@$(PY) tools/try_interpreters.py $(CORE_TESTS)

clean:
	rm -rf build prove/build results .pytest_cache .mypy_cache .ruff_cache $(VENV) .venv-*
