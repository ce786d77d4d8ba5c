# One name a chore; a fresh machine needs Python 3.11 to 3.13 with venv, and make.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
unexport PYTHONDONTWRITEBYTECODE  # or each of the hundreds of commands that tests start compiles comove anew
ROS2 := .venv-ros2
ros2_wheels = $(1)-rclpy $(1)-rmw-fastrtps-cpp $(1)-trajectory-msgs $(1)-sensor-msgs $(1)-shape-msgs
WORKERS = $(shell $(BIN)/python -c 'from comove.processes import n_processors; print(min(n_processors() + 1, 8))')
PARALLEL = --numprocesses $(WORKERS) --dist loadfile  # one more than cores: tests wait for the commands that they start

.PHONY: dist docs paper demo reproduce ablation test test-all ros2 ros2-wheels test-release lint bench clean

demo: $(VENV)/core.stamp  ## solve the examples into demo/, with the scenes and recordings of the pages, and say where the pictures are
	$(BIN)/comove demo --out demo
	cp -r examples demo/

reproduce: $(VENV)/core.stamp  ## run every experiment of the paper and write docs/paper.md; about twenty minutes on two cores
	$(BIN)/comove reproduce --out reproduced
	rm -rf docs/paper && cp -r reproduced/paper reproduced/paper.md docs/

ablation: $(VENV)/dev.stamp  ## leave out each repair of the paper's method and write docs/ablation.md; hours
	$(BIN)/comove bench ablation --out ablated --workers 2
	cp ablated/ablation.md docs/

test: $(VENV)/dev.stamp  ## all tests but the slow ones, with a sixth of the random examples
	$(BIN)/python -m pytest $(PARALLEL)

test-all: $(VENV)/dev.stamp  ## the slow tests as well, with all random examples
	$(BIN)/python -m pytest $(PARALLEL) -m "not release" --hypothesis-profile=thorough

ros2: $(VENV)/dev.stamp ros2-wheels  ## motions sent over ROS 2, of two distributions, to robots on loopback
	$(BIN)/python -m pytest --numprocesses 2 --dist loadfile tests/ros

ros2-wheels: $(ROS2)/jazzy.stamp $(ROS2)/kilted.stamp

test-release: $(VENV)/dev.stamp  ## packages in empty environments, a stranger's first day, small reproductions; an hour
	$(BIN)/python -m pytest $(PARALLEL) -m release

dist: $(VENV)/docs.stamp  ## wheel and source archive, built, checked, and used in an empty environment
	rm -rf dist build/empty
	$(BIN)/python -m build --quiet .
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents --toplevel comove dist/*.whl
	$(PYTHON) -m venv build/empty
	build/empty/bin/python -m pip install --quiet --disable-pip-version-check dist/*.whl
	build/empty/bin/comove demo --out build/empty/demo

docs: $(VENV)/docs.stamp  ## the site, in docs/_build/html; it runs the gallery, and needs no network once installed
	$(BIN)/codespell README.md CHANGELOG.md docs examples src
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

paper: $(VENV)/paper.stamp  ## the paper, in paper/paper.pdf
	$(BIN)/python paper/build.py

lint: $(VENV)/dev.stamp  ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/dev.stamp  ## the figures that the documentation states
	$(BIN)/python benchmarks/suite.py

clean:
	rm -rf $(VENV) $(ROS2) demo reproduced ablated build docs/_build docs/gallery *.egg-info src/*.egg-info

$(VENV)/bin/python:
	@test -n "$(PYTHON)" || { echo "comove needs Python 3.11, 3.12 or 3.13: apt-get install python3.11 python3.11-venv"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
		echo "Python's venv is missing: apt-get install $$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/core.stamp: pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable .  # what is used is compiled then
	@touch $@

$(VENV)/docs.stamp: pyproject.toml $(VENV)/core.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

$(VENV)/paper.stamp: pyproject.toml $(VENV)/core.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[paper]'
	@touch $@

$(ROS2)/%.stamp: tests/ros/ros2_types.py $(wildcard tests/ros/*_msgs/*/*) | $(VENV)/bin/python  # wheels, and types by a C++ compiler; a robot has its own
	$(PYTHON) -m venv $(ROS2)/$*
	$(ROS2)/$*/bin/python -m pip install --quiet --disable-pip-version-check $(call ros2_wheels,$(if $(filter kilted,$*),ros,ros-$*))
	$(ROS2)/$*/bin/python tests/ros/ros2_types.py > $(ROS2)/$*.log
	@touch $@

$(VENV)/dev.stamp: pyproject.toml $(VENV)/core.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@
