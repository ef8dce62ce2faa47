# Everything here needs only make and a Python ≥ 3.11; `make` alone says what there is.

VENV ?= .venv
ROBOT_VENV ?= .venv-robot
OLDEST_VENV ?= .venv-oldest
PYTHON ?=
UV ?= uv
PYTEST = $(VENV)/bin/python -m pytest

SIM = $(VENV)/.ready-sim
DEV = $(VENV)/.ready-dev
ROBOT = $(ROBOT_VENV)/.ready-robot

.DEFAULT_GOAL := help
.PHONY: help demo environment test test-and-oracles test-oracles test-slow planted-faults lint types robot-test oldest-test kernel-test bench docs pins clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-16s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo
	@echo "Variables: PYTHON=python3.13 (to make the environment with), VENV=.venv (where it lies)"

demo: $(SIM)  ## the whole story: sweep, tune, freeze, fly, with pictures
	@$(VENV)/bin/jaxmpc demo

environment: $(DEV)  ## what tests need, installed, and none run

test: $(DEV)  ## the fast tests
	@$(PYTEST)

test-and-oracles: $(DEV)  ## both in one run: what a test has compiled serves its file's oracles
	@$(PYTEST) -m "not slow and not hardware"

test-oracles: $(DEV)  ## what proves physics, gradients and safety: minutes
	@$(PYTEST) -m "oracle and not slow and not hardware"

test-slow: $(DEV)  ## long statistics and whole jobs: an hour or two
	@$(PYTEST) -m "slow and not hardware"

planted-faults: $(DEV)  ## plant eight faults in copies, each alone, and see which tests catch it: an hour
	@$(VENV)/bin/python -m tests.planted_faults

lint: $(DEV)  ## ruff: mistakes and format
	@$(VENV)/bin/ruff check
	@$(VENV)/bin/ruff format --check

types: $(DEV)  ## mypy --strict on the four packages
	@$(VENV)/bin/mypy

# The addopts of pyproject.toml need the workstation, so they are replaced here.
robot-test: $(ROBOT)  ## the robot's tests, where only numpy, python-can and pytest are
	@if $(ROBOT_VENV)/bin/python -c "import jax" 2>/dev/null; then \
		echo "$(ROBOT_VENV) holds jax: remove it and try again" >&2; exit 1; fi
	@$(ROBOT_VENV)/bin/python -m pytest tests/deploy \
		-o addopts="--import-mode=importlib --strict-markers" -m "not slow and not oracle and not hardware"

# What is deprecated there is the oldest versions' own affair.
oldest-test:  ## the fast tests with the oldest packages that are allowed (needs uv); TESTS=tests/deploy chooses
	@command -v $(UV) >/dev/null || { echo "make oldest-test needs uv: install it, or name it by UV=…" >&2; exit 1; }
	$(UV) venv --quiet --clear --python $(or $(PYTHON),3.11) $(OLDEST_VENV)
	$(UV) pip install --quiet --python $(OLDEST_VENV) --resolution lowest-direct $(UV_FLAGS) --group build -e '.[dev]'
	$(OLDEST_VENV)/bin/python -m pytest -W ignore::DeprecationWarning $(TESTS)

kernel-test: $(DEV)  ## flights on a kernel's own CAN, in a virtual machine: an hour, and packages of docs/robot.md
	@$(VENV)/bin/python -m tests.kernel $(if $(KERNELS),--kernels $(KERNELS)) $(if $(JOBS),--jobs $(JOBS))

bench: $(DEV)  ## throughput of the linear loop and of the arm beside their peers
	@$(VENV)/bin/python -m benchmarks.sweep_throughput
	@$(VENV)/bin/python -m benchmarks.arm_throughput

docs: $(DEV)  ## the guides as a site in build/docs, made without a network
	@$(VENV)/bin/python -m sphinx -q -b html docs build/docs
	@echo build/docs/index.html

COMPILE = $(UV) pip compile pyproject.toml --python-version 3.11 --universal \
	--generate-hashes --no-header --no-annotate --quiet $(UV_FLAGS)

pins:  ## pin the dependencies anew (needs uv); UV_FLAGS=--upgrade takes newer versions
	@command -v $(UV) >/dev/null || { echo "make pins needs uv: install it, or name it by UV=…" >&2; exit 1; }
	$(COMPILE) --extra dev --group build -o requirements-dev.txt
	$(COMPILE) --extra sim --group build -c requirements-dev.txt -o requirements.txt
	$(COMPILE) --group robot -c requirements-dev.txt -o requirements-robot.txt

clean:  ## remove environments, caches and builds; results stay
	rm -rf .venv .venv-* .*_cache .hypothesis build dist
	find . -name __pycache__ -prune -exec rm -rf {} +

# A stamp inside each environment says that its packages are those of its pins.
$(SIM): requirements.txt pyproject.toml
	@$(call install,$(VENV),requirements.txt)
	@-$(VENV)/bin/python -m compileall -qq -j 0 $(VENV)/lib jaxmpc tuning sweeps deploy
	@touch $@

$(DEV): requirements-dev.txt requirements.txt pyproject.toml
	@$(call install,$(VENV),requirements-dev.txt)
	@touch $@ $(SIM)

$(ROBOT): requirements-robot.txt pyproject.toml
	@$(call install,$(ROBOT_VENV),requirements-robot.txt)
	@touch $@

# Two calls of pip, because it refuses an editable package where it demands hashes. It would compile on one core; tests
# compile what they import, and for the demo, whose processes would each compile the same, all cores do.
define install
set -e; \
if [ ! -x $(1)/bin/pip ]; then \
	python=; found=; \
	for candidate in $(or $(PYTHON),python3 python3.14 python3.13 python3.12 python3.11); do \
		version=$$($$candidate -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null) || continue; \
		found="$$found $$candidate is $$version;"; \
		if $$candidate -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then python=$$candidate; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
		echo "jaxmpc needs Python 3.11 or newer; found:$${found:- none;} name one by PYTHON=…" >&2; exit 1; \
	fi; \
	echo "setting up $(1) with Python $$version (about a minute, once) …"; \
	$$python -m venv $(1); \
else \
	echo "bringing $(1) up to date …"; \
fi; \
pip="$(1)/bin/python -m pip --disable-pip-version-check --no-input install --quiet --no-compile"; \
$$pip --require-hashes -r $(2); \
$$pip --no-deps --no-build-isolation -e .
endef
