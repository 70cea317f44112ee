# make setup   .venv with what the program needs, below 700 MB
# make tools   what lint and tests need besides (1.2 GB more); make lint, check, test, docs and wheel bring it by themselves
# make check   after an edit: lint, and every test that is neither slow nor long nor bound to the clock
# make test    all tests but the long ones; make lint: ruff, the floors of the house, types, published figures that are older than their sources
# make docs    makes those figures anew
# make oldest  the oldest Python, numba, numpy, ... that setup.py takes: the same bits as with those that are installed; make newest
# make site    the documents and the reference of the public interface as a static site, in site/
# make wheel   the wheel, in dist/, with compiled kernels, checked for what is in it and what is not
# make bench   what a step costs (docs/performance.md); make demo: the car over ROS topics
# VENV=... and PYTHON=... may be given, and WORKERS=... (processes of tests at a time).
SHELL := /bin/bash
, := ,
VENV ?= .venv
BIN := $(VENV)/bin
WORKERS ?= 2
PYTHON ?= $(shell for p in python3 python3.12 python3.11 python3.13; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
# Where this is set a start of mbd takes several times as long, for Python compiles all its modules anew; tests start hundreds of processes. So
# the byte code of what a start imports is there from the beginning (of all that is installed it takes half a minute more), and tests write more.
export PYTHONDONTWRITEBYTECODE :=
# Where ROS 2 Jazzy is sourced its own rclpy is used; elsewhere the extra `ros` brings the same release as wheels.
SYSTEM_ROS := $(shell [ "$$ROS_DISTRO" = jazzy ] && $(PYTHON) -c 'import rclpy' 2>/dev/null && echo yes)
ROS := $(if $(SYSTEM_ROS),,ros$(,))

# Each says that what it is named after is there.
INSTALLED := $(VENV)/.installed
TOOLS := $(VENV)/.tools

define NEXT

next:
  . $(VENV)/bin/activate
  mbd list                                   # scenes, vehicles, maneuvers, tires, roads, studies
  mbd run car_step_steer --out bags/first    # the first run compiles, which takes about a minute
  mbd view bags/first --out out/first.html   # open it in a browser
Tab completes names (bash): eval "$$(register-python-argcomplete mbd)"
endef
export NEXT

.PHONY: python setup tools runtime check test lint docs oldest newest site wheel bench demo clean

setup: python $(INSTALLED)
	@echo "$$NEXT"

tools: python $(TOOLS)

define environment
	@[ -x $(BIN)/python ] || $(PYTHON) -m venv $(if $(SYSTEM_ROS),--system-site-packages) $(VENV) || \
		{ rm -rf $(VENV); echo 'no virtual environment could be made: apt-get install python3-venv'; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -e '.$(1)'
	@$(BIN)/python -m compileall -qq -j 0 -x '/tests/' mbd_sim_ros solver \
		$$(ls -d $(VENV)/lib/python3*/site-packages/{llvmlite,mcap,numba,numpy,scipy,yaml} 2>/dev/null) || true  # those that the system has not; it works without
endef

# Before anything is made, and also where all is there: a name that was given is not passed over.
python:
	@[ -n "$(PYTHON)" ] || { echo 'Python 3.11 or newer is needed (apt-get install python3 python3-venv)'; exit 1; }
	@for p in "$(PYTHON)" $(wildcard $(BIN)/python); do \
		version=$$("$$p" -c 'import sys; print("%d.%d" % sys.version_info[:2], int(sys.version_info >= (3, 11)))' 2>/dev/null); \
		case "$$version" in *' 1') continue;; *' 0') what="Python $${version% *}, and 3.11 or newer is needed";; \
			*) what='no Python that can be started';; esac; \
		echo "$$p is $$what: name another one, e.g. make setup PYTHON=python3.11, and remove $(VENV) if it was made with this one"; \
		exit 1; \
	done

$(INSTALLED): setup.py setup.cfg pyproject.toml Makefile | python
	$(call environment,$(if $(ROS),[ros]))
	@touch $@

$(TOOLS): setup.py setup.cfg pyproject.toml Makefile | python
	$(call environment,[$(ROS)test$(,)dev])
	@touch $@ $(INSTALLED)

# What `mbd` itself needs: kernels can be compiled while `make tools` brings the rest.
runtime: python
	$(call environment)

check: lint
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal -m 'not slow and not realtime and not long'

# Tests that wait for the clock beside a process run after those that need all cores.
test: tools
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal -m 'not realtime and not long'
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal -m 'realtime and not long'

lint: tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-logo
	$(BIN)/mypy
	$(BIN)/python docs/tools/published.py

# Figures and pictures of the documents that are older than what they depend on, made anew; hours where all are. Goes on where it stopped.
docs: tools
	$(BIN)/python docs/tools/published.py --make

oldest newest: python $(INSTALLED)
	.ci/ends $@ $(BIN)/python

site: python $(INSTALLED) $(VENV)/.site
	$(BIN)/python docs/tools/site_pages.py

$(VENV)/.site: setup.py | $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[site]'
	@touch $@

wheel: tools
	.ci/wheel $(BIN)/python dist kernels

bench: python $(INSTALLED)
	$(BIN)/mbd bench

demo: python $(INSTALLED)
	$(BIN)/python -m mbd_sim_ros.commands.demo

clean:
	rm -rf build dist site install log *.egg-info .pytest_cache .mypy_cache .ruff_cache
