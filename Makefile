# make setup | test | lint | bench | demo. VENV=... and PYTHON=... may be given.
SHELL := /bin/bash
, := ,
VENV ?= .venv
BIN := $(VENV)/bin
PYTHON ?= $(shell for p in python3 python3.12 python3.11 python3.13; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
# Where ROS 2 Jazzy is sourced its own rclpy is used; elsewhere the extra `ros` brings the same release as wheels.
SYSTEM_ROS := $(shell [ "$$ROS_DISTRO" = jazzy ] && $(PYTHON) -c 'import rclpy' 2>/dev/null && echo yes)
EXTRAS := $(if $(SYSTEM_ROS),test$(,)dev,ros$(,)test$(,)dev)

STAMP := $(VENV)/.installed

.PHONY: setup test lint bench demo clean

setup: $(STAMP)

$(STAMP): setup.py setup.cfg pyproject.toml Makefile
	@[ -n "$(PYTHON)" ] || { echo 'Python 3.11 or newer is needed (apt-get install python3 python3-venv)'; exit 1; }
	@[ -x $(BIN)/python ] || $(PYTHON) -m venv $(if $(SYSTEM_ROS),--system-site-packages) $(VENV) || \
		{ rm -rf $(VENV); echo 'no virtual environment could be made: apt-get install python3-venv'; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[$(EXTRAS)]'
	@touch $@

test: setup
	$(BIN)/python -m pytest -q

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/mypy

bench: setup
	$(BIN)/mbd bench

demo: setup
	$(BIN)/python -m mbd_sim_ros.commands.demo

clean:
	rm -rf build install log *.egg-info .pytest_cache .mypy_cache .ruff_cache
