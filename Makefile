# `make` alone lists the targets. Everything runs from a bare checkout: the environment is made in .venv on the
# way, once, and again when the lock or pyproject.toml has changed.

SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help install lock lint test every-test test-fast demo models push-models wheel clean distclean

BIN := .venv/bin
STAMP := .venv/.installed
UV := $(BIN)/uv pip
# Compiled once, at installation, rather than in every process: importing LeRobot takes 8 s of a core instead of 22
# where Python writes no bytecode by itself.
INSTALL := $(UV) install --quiet --compile-bytecode --python $(BIN)/python --no-deps

# Software rendering without a display; MUJOCO_GL=osmesa or glfw are the other choices.
export MUJOCO_GL ?= egl

# Tests take no more threads than workers and never ask the Hub for anything. Many wait for processes of their own, so
# there is one worker more than cores.
WORKERS = $$(( $$(getconf _NPROCESSORS_ONLN) + 1 ))
PYTEST = OMP_NUM_THREADS=1 HF_HUB_OFFLINE=1 $(BIN)/python -m pytest -n $(WORKERS) --maxprocesses 8 --dist worksteal

help:  ## List the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 20

install: $(STAMP)  ## The environment in .venv, and the system libraries that rendering needs
	@bash scripts/system_libraries.sh

IS_3_12 := -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null

$(STAMP): requirements.lock pyproject.toml
	@for python in python3.12 python3 none; do $$python $(IS_3_12) && break; done; \
	if [ $$python = none ]; then \
	    echo "error: no Python 3.12 found as python3.12 or python3; install it (Debian, Ubuntu: python3.12 and python3.12-venv; or: pyenv install 3.12)" >&2; exit 1; \
	fi; \
	$(BIN)/python $(IS_3_12) || $$python -m venv --clear .venv || { \
	    echo "error: $$python cannot make a virtual environment; install its venv module (Debian, Ubuntu: python3.12-venv)" >&2; exit 1; }
	@echo "Installing the packages of requirements.lock into .venv (about 6 GB, most of it torch with CUDA) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check "$$(grep '^uv==' requirements.lock)"
	@$(INSTALL) -r requirements.lock
	@$(INSTALL) --no-build-isolation --editable .
	@touch $@

lock: $(STAMP)  ## Resolve pyproject.toml into requirements.lock anew, keeping versions where it can
	$(UV) compile --quiet pyproject.toml --extra all --extra dev --python-version 3.12 --only-binary :all: \
	    --no-annotate --custom-compile-command "make lock" --output-file requirements.lock

lint: $(STAMP)  ## Format, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

test: install  ## Every check: lint and all tests
	@$(MAKE) --no-print-directory --jobs=2 lint every-test

every-test: $(STAMP)
	$(PYTEST)

test-fast: install  ## The tests without those marked slow
	$(PYTEST) -m "not slow"

demo: install  ## See an imperfect policy get better (TRAIN=1: train all three models from nothing first)
	$(BIN)/gloves demo $(if $(filter-out 0,$(TRAIN)),--train=true)

# The value of a variable that has to be named: $(call named,TASK,slalom)
named = $(or $($(1)),$(error $(1) is missing, as in make $@ $(1)=$(2)))

models: install  ## Train and calibrate all models of a benchmark, hours of two cores: TASK=slalom
	$(BIN)/python scripts/train_models.py --task=$(call named,TASK,slalom)

push-models: install  ## Push them to the Hub: TASK=slalom HUB_USER=<you>
	$(BIN)/python scripts/train_models.py --task=$(call named,TASK,slalom) --push=$(call named,HUB_USER,<you>)

wheel:  ## Build wheel and sdist into dist/, and try the wheel in a bare environment
	@bash scripts/system_libraries.sh
	@bash scripts/check_wheel.sh

clean:  ## Remove caches and build products; .venv and outputs/ stay
	rm -rf .mypy_cache .ruff_cache .pytest_cache build dist
	find . -path ./.venv -prune -o -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## Remove .venv as well
	rm -rf .venv
