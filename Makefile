# `make demo` and `make test` do all of their own set-up, in .venv; from the second run on they
# start at once. PYTHON=… chooses the interpreter of the venv, ARGS=… goes to the program run.

VENV := .venv
PIP := $(VENV)/bin/python -m pip --disable-pip-version-check
SOURCES := $(shell find epos2_ros config examples launch resource scripts -type f \
             -not -name '*.pyc' 2>/dev/null) package.xml setup.py setup.cfg pyproject.toml

# Nothing of ours leaves the machine, and no neighbour's ROS graph comes in.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_DOMAIN_ID ?= 42

.PHONY: help demo test campaign bench lint clean
help:
	@echo "make demo   six simulated axes run a trajectory: ARGS=examples/raster_scan.yaml"
	@echo "make test   all tests: ARGS='-k eds'"
	@echo "make campaign  random scenarios with troubles, in simulated time: N=1000, ARGS='--seed 7'"
	@echo "make bench  the tables of docs/motion.md: ARGS='frames speed'"
	@echo "make lint   ruff and mypy"
	@echo "make clean  remove what make and Python left here, .venv included"

demo: $(VENV)/.package
	$(VENV)/bin/python -m epos2_ros demo $(ARGS)

test: $(VENV)/.package $(VENV)/.tools $(VENV)/.control_msgs
	$(VENV)/bin/python test/run.py $(ARGS)

campaign: $(VENV)/.package $(VENV)/.tools
	PYTHONPATH=. $(VENV)/bin/python test/campaign.py --count $(or $(N),1000) $(ARGS)

bench: $(VENV)/.package $(VENV)/.bench
	$(VENV)/bin/python -m benchmarks $(ARGS)

lint: $(VENV)/.tools
	$(VENV)/bin/ruff check .
	$(VENV)/bin/python -m mypy

clean:
	rm -rf $(VENV) build install log *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -prune -exec rm -rf {} +

# Each hidden file in .venv says when its step was last completed.

# With a sourced ROS installation its rclpy is used, else the wheels of the extra `ros`.
$(VENV)/.package: $(VENV)/.interpreter $(SOURCES)
	@rm -rf build  # of an earlier version, whose deleted modules would be installed again
	@ros=; $(VENV)/bin/python -c 'import rclpy' 2>/dev/null || ros='[ros]'; \
	echo "installing epos2_ros$$ros into $(VENV) (the first time about a minute)"; \
	$(PIP) install -qq ".$$ros" || { echo "If pip found no ros-jazzy-… wheels: they are for\
 x86-64 Linux; elsewhere source a ROS 2 Jazzy installation, then run make again." >&2; exit 1; }
	@$(VENV)/bin/python -c 'from epos2_ros.motion import knots, pace, setpoint_search as s; \
	  knots.prepare(); pace.prepare(); s.prepare()'  # as run here
	@touch $@

$(VENV)/.tools: setup.py | $(VENV)/.package
	@echo "installing the test tools into $(VENV)"
	@$(PIP) install -qq '.[test]'
	@touch $@

# The action's interfaces, where no ROS installation has them.
$(VENV)/.control_msgs: | $(VENV)/.package
	@echo "building control_msgs into $(VENV), once, for the tests of the action"
	@test/interfaces/build $(VENV) && touch $@ || echo "tests of the action will be skipped"

$(VENV)/.bench: setup.py | $(VENV)/.package
	@echo "installing what the benchmarks need into $(VENV)"
	@$(PIP) install -qq '.[bench]'
	@touch $@

# The first interpreter that really runs (a pyenv shim may not), is 3.10 … 3.12 and can make a venv.
$(VENV)/.interpreter:
	@novenv=; \
	for python in $(or $(PYTHON),python3.12 python3.11 python3.10 python3); do \
	  version=$$($$python -c 'import sys; v = sys.version_info[:2]; \
	    (3, 10) <= v <= (3, 12) and print("%d.%d" % v)' 2>/dev/null); \
	  test -n "$$version" || continue; \
	  $$python -c 'import ensurepip, venv' 2>/dev/null || { novenv=$$version; continue; }; \
	  site=; $$python -c 'import rclpy' 2>/dev/null && site=--system-site-packages; \
	  echo "making $(VENV) with $$python ($$version)"; \
	  exec $$python -m venv --clear $$site $(VENV); \
	done; \
	if test -n "$$novenv"; then echo "Python $$novenv can make no venv: install the package\
	 python$$novenv-venv (sudo apt install python$$novenv-venv), then run make again."; \
	else echo "no Python 3.10, 3.11 or 3.12 found as $(or $(PYTHON),python3): install one (sudo\
	 apt install python3 python3-venv) or name it: make PYTHON=/path/to/python3.12"; fi >&2; exit 1
	@touch $@
