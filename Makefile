# Two commands of the README do everything, set-up included: `make demo` and `make test`.
# Everything is installed into .venv from requirements*.lock (versions and hashes).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PY := $(BIN)/python
# Errors alone: pip's warnings are about its own configuration, or about who runs it.
PIP := $(PY) -m pip install --quiet --quiet --disable-pip-version-check
STAMP := $(VENV)/.installed
# An editable install knows the modules that there were when it was made: a new one needs another.
MODULES := $(VENV)/.modules-$(shell find src prove/src -name '*.py' | LC_ALL=C sort | cksum | cut -d' ' -f1)
CSRC := $(wildcard csrc/*.[ch] csrc/kernels/*.[ch] csrc/bindings/*.cpp csrc/bindings/*.h)

# Matrices of a few rows gain nothing by threads, and with them last bits depend on the machine.
export OPENBLAS_NUM_THREADS ?= 1
# Tests start hundreds of interpreters; each would compile what it imports anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test quick core interpreters coverage lint style types types-of-tests bench bench-short \
  build docs fuzz reproduce clean lock dist-check

setup: $(VENV)/.locked $(VENV)/.proving

$(VENV)/.made:
	@echo "setting up $(VENV), once"
	@test -x $(PY) || $(PYTHON) -m venv $(VENV)
	@touch $@

# What the compiler and a run need: a third of the whole. Python compiles it when it imports it.
$(VENV)/.demo: requirements-demo.lock | $(VENV)/.made
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

RESULTS := results/demo
demo: $(STAMP)
	@$(BIN)/fraclink run --rig paper-2023-geared --log demo --out $(RESULTS) --certify --force

# Their tests start browsers, solvers, compilers, a fuzzer: in a run of their own, which has loaded
# little else.
LARGE := tests/test_arm_page.py tests/test_engine.py tests/test_export_fmu_sources.py \
  tests/test_export_gates.py tests/test_report.py tests/test_studio_browser.py prove/tests

# Two workers share nothing but the processor; a file's tests stay together, because their fixtures are dear.
# 1 is pytest's code for tests that failed: the others are tried, too. What interrupted it ends all.
test: setup
	@$(PY) -m pytest $(LARGE); large=$$?; [ $$large -le 1 ] || exit $$large; \
	  $(PY) -m pytest -n 2 --dist loadfile $(LARGE:%=--ignore=%) && exit $$large

# What a contributor runs before every commit: under a minute on two cores.
quick: setup
	@$(PY) -m pytest -n 2 --dist loadfile -m "not slow" tests

# The core in a copy without the packages around it: built, and its own tests.
core: setup
	@$(PY) tools/check_core.py

# The demo and the core's tests on every Python of this machine, with the lowest and the newest versions allowed.
interpreters: setup
	@$(PY) tools/try_interpreters.py

# From Python 3.12 on the interpreter reports lines by itself; on 3.11 a tracer costs half the time again.
coverage: setup
	export COVERAGE_CORE=$$($(PY) -c 'import sys; print("sysmon" if sys.version_info >= (3, 12) else "ctrace")'); \
	$(PY) -m pytest --cov=fraclink --cov-report= $(LARGE) && \
	$(PY) -m pytest -n 2 --dist loadfile --cov=fraclink --cov-append --cov-report=term:skip-covered \
	  --cov-fail-under=90 $(LARGE:%=--ignore=%)

# Independent of each other: `make -j2 lint` takes half the time.
lint: style types types-of-tests

style: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

types-of-tests: setup
	$(BIN)/mypy --config-file tests/mypy.ini

bench: setup
	$(PY) benchmarks/run.py

# The smallest sizes of each: a crash fails, no time is judged.
bench-short: setup
	@$(PY) benchmarks/run.py --short

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

# `make lock` needs uv on the path; everybody else installs from the files it wrote. The demo's is a part of the whole.
LOCK := uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
  --no-emit-index-url --no-emit-find-links --no-strip-extras
lock:
	$(LOCK) requirements.in -o requirements.lock
	$(LOCK) --constraint requirements.lock requirements-demo.in -o requirements-demo.lock

clean:
	rm -rf build prove/build results .pytest_cache .mypy_cache .ruff_cache $(VENV)
