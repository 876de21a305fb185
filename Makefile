# Two commands do everything on a fresh machine: `make demo` and `make test`. They need Python 3.10 or newer and venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

PYTHON_OF_TESTS ?= $(BIN)/python
# Kept even where the environment says otherwise: each worker collects in 5 s of CPU instead of 11, each daemon of the
# tests imports in 0.4 s instead of 0.6.
export PYTHONDONTWRITEBYTECODE :=
# As in lookback.service. A second thread of OpenBLAS waits by spinning: beside other workers tests took up to 9 times
# as much of the processors.
benchmark flights smoke test test-long test-all test-core test-python test-kernels soak: export OMP_NUM_THREADS := 1
benchmark flights smoke test test-long test-all test-core test-python soak: export OPENBLAS_NUM_THREADS := 1
benchmark flights smoke test test-long test-all test-core test-python test-kernels soak: export OPENCV_FOR_THREADS_NUM := 1
# Two more than processors, since some tests wait: 311 s instead of 324 on two. GNU's nproc counts one where OMP_NUM_THREADS is 1.
# CHANGED=1: only the tests of what this branch has changed; CHANGED=COMMIT: of what has changed since then.
CHANGED_TESTS = $(if $(CHANGED),$(or $(shell $(BIN)/python -m tests.changed $(filter-out 1,$(CHANGED))),$(error CHANGED=$(CHANGED): no such commit)))
WITH_LONG := -m 'not hardware and not soak'
SIDE_BY_SIDE := -n $(shell expr $$(env -u OMP_NUM_THREADS nproc) + 2) --dist worksteal --durations=10
SOCKETS := encoders.py host_lookup.py link.py links.py signing.py
WHOLE := config.py daemon.py extras.py files.py geodesy.py import_rule.py main.py plugin.py
NOT_CORE := sim docs faults firmware_config hardware systemd
# Alike on every Python: drives that are computed, over a quarter of the time that test-python would take, and what the doctor
# finds, which it waits for.
ALIKE := commands/test_real_feeds.py plugins/doctor/test_doctor.py plugins/mapping/test_mapping_plugin.py \
	plugins/mapping/test_own_motion.py plugins/mapping/test_outage.py plugins/motion

.PHONY: demo flights test test-long test-all test-core test-python test-pythons test-kernels test-lowest test-newest test-boot soak check lint smoke bench bench-quick dist lock
.PHONY: benchmark clean docs notebook

demo: $(VENV)/.demo
	$(BIN)/lookback demo -o demo

test: $(VENV)/.dev
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) $(CHANGED_TESTS)
	@echo "Not run, since they take long and seldom fail alone: most courses of the trial, rendered goldens, commands of the"
	@echo "docs, figures on recordings, installation, kills, a day, other processors. make test-long runs them, make check everything."

test-long: $(VENV)/.dev
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) -m 'long and not soak'

# Both at once: what is rendered, described or driven for one is there for the other, and no processor waits between them.
test-all: $(VENV)/.dev
	$(BIN)/python -m pytest $(SIDE_BY_SIDE) $(WITH_LONG)

# The tests of edge/ and its plug-ins alone, for a Python beside the one of .venv.
test-core:
	$(PYTHON_OF_TESTS) -m pytest $(SIDE_BY_SIDE) $(WITH_LONG) $(NOT_CORE:%=--ignore tests/%)

# What rests on linear algebra, by the kernels that OpenBLAS has for other processors (each with the instructions that it needs)
# and once with two threads: their last bits differ from those of `make test`, which has one thread and this processor's kernel.
# Without what rounds nothing that these do not: most recordings, searches of int8 rows at another spacing. A recording with
# keypoints takes five times as long by two threads.
KERNELS := Haswell.2.avx2 SkylakeX.1.avx512f Prescott.1.pni
ROUNDED := dead_reckoning gps_monitor gyro_heading odometer_calibration pose_measurement position_estimator route_filter
test-kernels: $(KERNELS:%=kernel-%)
kernel-%: $(VENV)/.dev
	@set -- $(subst ., ,$*) "$$(OPENBLAS_VERBOSE=2 $(BIN)/python -c 'import numpy' 2>&1)"; \
		grep -qw "$$3" /proc/cpuinfo || { echo "$$1: NOT RUN, this processor has no $$3"; exit 0; }; \
		[ "$$2 $$4" != "1 Core: $$1" ] || { echo "$$1: NOT RUN, it is this processor's own, as make test has it"; exit 0; }; \
		echo "OpenBLAS for $$1, threads: $$2"; OPENBLAS_CORETYPE=$$1 OPENBLAS_NUM_THREADS=$$2 $(BIN)/python -m pytest -n 2 --dist worksteal \
		$(ROUNDED:%=tests/localization/test_%.py) tests/sequence tests/keypoints tests/golden \
		--ignore tests/keypoints/test_photographs.py --ignore tests/sequence/test_spacing.py \
		-k "not replay$$([ $$2 = 2 ] || echo ' or keypoints')"

# What may differ from one Python to another: imports, config, files, sockets, threads, subprocesses, the page, and the
# daemon with a camera and an autopilot.
test-python:
	$(PYTHON_OF_TESTS) -m pytest $(SIDE_BY_SIDE) $(WITH_LONG) $(ALIKE:%=--ignore tests/%) \
		$(addprefix tests/,camera commands feed health journal plugins) $(addprefix tests/telemetry/test_,$(SOCKETS)) \
		$(addprefix tests/test_,$(WHOLE)) tests/reference_map/test_store.py tests/faults/test_bad_configs.py \
		tests/recognition/test_warm_start_file.py

test-pythons: $(VENV)/.dev
	MAKEFLAGS= .ci/pythons

# The same on the lowest version of each dependency and on the newest, each in its own environment: wheels only.
LOWEST_PYTHON ?= python3.10
test-lowest: DEPENDENCIES := --constraint constraints/lowest.txt
test-lowest: PYTHON := $(LOWEST_PYTHON)
test-newest: DEPENDENCIES := --upgrade
test-lowest test-newest: test-%:
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install --quiet --only-binary :all: $(DEPENDENCIES) --editable '.[test]'
	$(MAKE) test-core PYTHON_OF_TESTS=.venv-$*/bin/python

# The exact packages, with hashes, that install.sh, the Debian package, the container and CI install: for every Python and
# platform at once, those of each extra in a file of its own. From one resolution, so that they fit each other.
LOCKED := page oak stream signing desk test
COMPILE := $(BIN)/uv pip compile --quiet --universal --python-version 3.10 --no-header --no-annotate
lock: $(VENV)/.dev
	mkdir -p systemd/lock
	$(COMPILE) --upgrade pyproject.toml $(LOCKED:%=--extra %) -o $(VENV)/all.txt
	$(COMPILE) --generate-hashes -c $(VENV)/all.txt pyproject.toml -o systemd/lock/core.txt
	for extra in $(LOCKED); do $(COMPILE) --generate-hashes -c $(VENV)/all.txt pyproject.toml --extra $$extra \
		-o $(VENV)/$$extra.txt || exit; awk 'NR == FNR { core[$$0]; next } /^[a-z]/ { there = $$0 in core } !there' \
		systemd/lock/core.txt $(VENV)/$$extra.txt >systemd/lock/$$extra.txt; done
	echo setuptools | $(COMPILE) --upgrade --generate-hashes - -o systemd/lock/build.txt

# Boots a real Debian in a container and tries the service in it: needs root, mmdebstrap and systemd-container.
test-boot: $(VENV)/.dev
	tests/systemd/boot.sh

CASE_RUNS ?= 50

# From a new seed each time, which is printed; LOOKBACK_SEED=... repeats a run.
soak: export LOOKBACK_SEED := $(or $(LOOKBACK_SEED),$(shell date +%s))
soak: $(VENV)/.dev
	@echo "LOOKBACK_SEED=$$LOOKBACK_SEED"
	$(BIN)/python -m pytest -m soak
	$(BIN)/lookback dev sim fixes --case all --runs $(CASE_RUNS) --first-seed $$LOOKBACK_SEED --jobs $$(env -u OMP_NUM_THREADS nproc) -o soak

check: lint docs test-all test-kernels

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell

smoke: $(VENV)/.dev
	$(BIN)/lookback demo -o demo --require-good

# The pages as a site in build/docs, with the page of `import lookback` from its docstrings.
docs: $(VENV)/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

notebook: $(VENV)/.dev
	$(BIN)/python -c "from tests.docs.test_notebook import RUN; exec(RUN)" \
		docs/notebook.ipynb docs/notebook.ipynb

benchmark: $(VENV)/.dev
	$(BIN)/lookback compare benchmark --network fc6=fc6 -o build/benchmark
	$(BIN)/python -m sim.research.evaluation benchmark --made build/benchmark/means.md --page docs/tables/evaluation.md

bench: $(VENV)/.dev
	$(BIN)/lookback dev bench --stages -o docs/bench.md

bench-quick: $(VENV)/.dev
	$(BIN)/lookback dev bench --stages --quick

# Drives on real autopilots once more, before anything that concerns positions is done; RECORDED: folders of them.
RECORDED := ../shared/flights_b0903bde ../shared/flights_386c0d62 ../shared/flights_eca2e43 ../shared/flights_b06f79e
flights: $(VENV)/.dev
	$(BIN)/lookback dev flights $(RECORDED) --model grid --keypoints -o .flights --jobs 2 --page docs/flights.md

# What is published: `make dist`, then a tag (CONTRIBUTING.md, Release).
dist: $(VENV)/.dev
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m build --outdir dist lookback_fc6
	$(BIN)/python -m twine check --strict dist/*

clean:
	rm -rf $(VENV) .venv-* demo soak build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

$(BIN)/python:
	@echo "1. an environment of Python in $(VENV)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

$(VENV)/.demo: $(BIN)/python pyproject.toml edge/__init__.py
	@echo "2. the packages, 1 GB: a few minutes"
	$(BIN)/python -m pip install -qq --editable '.[eval,page,desk]'
	touch $@

# Without byte code of all that is installed, which took 20 s: what is imported is compiled then.
$(VENV)/.dev: $(BIN)/python pyproject.toml edge/__init__.py
	$(BIN)/python -m pip install -qq --no-compile --editable '.[dev]'
	$(BIN)/python -m pip install -qq --no-compile --no-deps 'scikit-image>=0.25'  # photographs: what it needs is not
	touch $@ $(VENV)/.demo
