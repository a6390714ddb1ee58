# Every target sets up what it needs: an environment in .venv with the locked versions, the C libraries.
# Nothing of that is done again until the lock, the packaging or a C source changes.

# A step of a pipe that fails is a failure: what pip says is shown in part.
SHELL := bash
.SHELLFLAGS := -o pipefail -c

VENV := .venv
PYTHON := $(VENV)/bin/python
READY := $(VENV)/.defplan-ready
SOURCES := requirements.lock pyproject.toml setup.py \
	$(wildcard defplan_mj/kernel/*.[ch] defplan_mj/host/*.[ch])
LINTED := defplan_mj tasks solvers tests

.PHONY: help setup demo test test-full sanitize sanitize-fast bench soak wheel hashes lint docs clean

help:
	@echo "make demo       build the fish from its mesh, train it, log and report it"
	@echo "make test       the tests, without the slow ones"
	@echo "make test-full  all tests"
	@echo "make sanitize   the tests of the C code, built with address and undefined-behaviour sanitizers"
	@echo "make bench      time what the README's tables state"
	@echo "make soak       a million steps of each robot, 10,000 bad inputs, 100 stops: at most 30 minutes"
	@echo "                (make soak SOAK=--short tries it in 5)"
	@echo "make wheel      a wheel (manylinux) and a source archive in dist"
	@echo "make lint       ruff, mypy, which package may import which, lines of C within 100 columns"
	@echo "make docs       the documentation as a site in build/site; a broken link is an error"
	@echo "make clean      remove what was built (not .venv, not logs)"

setup: $(READY)

demo: $(READY)
	$(VENV)/bin/defplan run fish-swim

# Two processes; the tests of a file are one's, so that what they share is made once.
SHARED_OUT := -n 2 --dist loadfile

test: $(READY)
	$(PYTHON) -m pytest -q $(SHARED_OUT)

test-full: $(READY)
	$(PYTHON) -m pytest -q -m "" $(SHARED_OUT)

# Libraries in build/sanitize (about a minute and a half, if a source changed); those that are used otherwise stay as they are. The sanitizers must be
# loaded first, by name; Python's own leaks are not looked at. libstdc++ is there for exceptions.
# Not CasADi's functions: it opens its own libraries with RTLD_DEEPBIND, which the address sanitizer refuses.
SANITIZED := tests/kernel/test_step.py tests/kernel/test_contact.py tests/kernel/test_derivatives.py \
	tests/kernel/test_distance.py tests/kernel/test_honest.py tests/kernel/test_tumbling.py \
	tests/dynamics/test_reduced.py tests/host/test_plugin.py \
	tests/host/test_contact.py tests/host/test_ground.py tests/host/test_obstacles.py \
	tests/host/test_skin.py tests/host/test_turns.py tests/solvers/test_astar.py
SANITIZED_FAST := tests/kernel/test_distance.py tests/host/test_plugin.py

sanitize: CHOSEN := $(SANITIZED)
sanitize-fast: CHOSEN := $(SANITIZED_FAST)
sanitize sanitize-fast: $(READY)
	DEFPLAN_SANITIZE=1 $(PYTHON) setup.py -q build_ext --build-lib build/sanitize
	LD_PRELOAD="$$($${CC:-gcc} -print-file-name=libasan.so) $$($${CC:-gcc} -print-file-name=libstdc++.so)" \
	  ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 DEFPLAN_LIBRARIES=build/sanitize \
	  $(PYTHON) -m pytest -q $(CHOSEN)

bench: $(READY)
	$(VENV)/bin/defplan bench

# The wheel's name tells which glibc its libraries need.
wheel: $(READY)
	$(PYTHON) setup.py -q sdist bdist_wheel
	@ls dist/defplan-*

# After a change of requirements.lock; it asks the package index and takes some minutes.
hashes: | $(PYTHON)
	$(PYTHON) .ci/hashes.py

# Its result is kept in docs/reliability.md.
soak: $(READY)
	$(PYTHON) -m tests.soak $(SOAK)

lint: $(READY)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy $(LINTED)
	$(VENV)/bin/lint-imports
	@awk 'length > 100 { print FILENAME ":" FNR ": more than 100 columns"; long = 1 } \
	  END { exit long }' defplan_mj/kernel/*.[ch] defplan_mj/host/*.[ch]

docs: $(READY)
	$(PYTHON) -c 'import mkdocs, material, mkdocstrings' 2>/dev/null || \
	  $(PYTHON) -m pip install --quiet --disable-pip-version-check -r requirements-extras.lock
	$(PYTHON) -m mkdocs build --strict

# The libraries are built first and by themselves, so that a missing compiler is one sentence.
$(READY): $(SOURCES) | $(PYTHON)
	@echo "installing the $$(grep -c == requirements.lock) packages of requirements.lock and building two C libraries: some minutes"
	@$(PYTHON) -m pip install --disable-pip-version-check --progress-bar off -r requirements.lock | \
	  awk '/^(Collecting|Processing)/ { n++ } /^Processing|^ *(Downloading|Using cached)/ { sub(/^ +/, ""); print "  " n ": " $$0; fflush() } \
	    /^Installing|^Successfully/ { print "  " substr($$0, 1, 60) " ..."; fflush() }'
	$(PYTHON) setup.py -q build_ext --inplace
	$(PYTHON) -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	@touch $@

$(PYTHON):
	@found=; for p in python3.11 python3.12 python3 python; do \
	  if $$p -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' 2>/dev/null; \
	  then found=$$p; break; fi; done; \
	if [ -z "$$found" ]; then \
	  echo "defplan needs Python 3.11 or 3.12 with its venv module; none was found on PATH" >&2; \
	  exit 1; fi; \
	echo "making $(VENV) with $$($$found --version)"; $$found -m venv $(VENV)

clean:
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .mypy_cache
	find defplan_mj tasks solvers tests -name __pycache__ -prune -exec rm -rf {} +
	rm -f defplan_mj/*/*.so defplan_mj/*/*.built $(READY)
