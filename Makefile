# `make demo` and `make test` work on a fresh machine: both set up .venv first.
SHELL := /bin/bash
PYTHON := .venv/bin/python
PYTHON_LTS := .venv-lts/bin/python
DEMO_BLEND := out/still_life.blend
DEMO_PASSES := out/passes
WHEELS := build/wheels
# of `make bench` and `make bench-peers`, e.g. BENCH_OPTIONS="--model dragon.ply.gz --rounds 3"
BENCH_OPTIONS ?=
# Processes that share the tests, a file to one of them; each takes up to 2.5 GB.
TEST_PROCESSES ?= 2
PYTEST_OPTIONS := --numprocesses $(TEST_PROCESSES) --dist loadfile
# What both Blenders must do; tests/lts adds what only 4.5 does.
LTS_TESTS := tests/lts tests/blender tests/core/test_exr.py tests/test_registration.py tests/test_extension.py

.PHONY: help setup setup-lts demo test test-all test-blender test-lts bench bench-peers check extension clean

help:
	@echo "make setup      .venv with everything; a second time it takes a second"
	@echo "make demo       render the demo scene's passes into $(DEMO_PASSES)"
	@echo "make test       the tests that take seconds each"
	@echo "make test-all   all tests, and the Blender 4.5 LTS job"
	@echo "make test-blender  the zip in a real Blender with a window; BLENDER=/path/to/blender"
	@echo "make bench      time VIR's methods against rasterizing every view; how times grow, memory, Cycles"
	@echo "make bench-peers  error against time: Cycles, Cycles denoised, EEVEE"
	@echo "make check      lint, format, types, composition of every shader"
	@echo "make extension  the zips for Blender, one a platform, into dist/"

setup: .venv/.setup-done

# The stamps hang on what decides the environment's contents, so a second `make setup` only compares times.
.venv/.setup-done: pyproject.toml .python-version tools/setup
	@tools/setup .venv "$$(cat .python-version)" bpy,cli,test

setup-lts: .venv-lts/.setup-done

.venv-lts/.setup-done: pyproject.toml tools/setup
	@tools/setup .venv-lts 3.11 bpy,cli,test

$(DEMO_BLEND): $(wildcard demo_scenes/*.py) | setup
	@mkdir -p $(@D)
	$(PYTHON) -m demo_scenes.still_life $@

demo: setup $(DEMO_BLEND)
	$(PYTHON) -m vir_addon render $(DEMO_BLEND) --output $(DEMO_PASSES) --preview --stats $(DEMO_PASSES)/stats.json
	@echo "Done. The passes (EXR), their previews and the contact sheet (PNG) are in $(CURDIR)/$(DEMO_PASSES)"

test: setup
	$(PYTHON) -m pytest $(PYTEST_OPTIONS) -m "not slow"

test-all: setup test-lts
	$(PYTHON) -m pytest $(PYTEST_OPTIONS)

# Not a part of the others: needs a Blender with a window. BLENDER=/path/to/blender make test-blender
test-blender: extension
	@mkdir -p out/real_blender
	$(PYTHON) -m tests.real_blender dist out/real_blender

test-lts: setup-lts
	$(PYTHON_LTS) -m pytest $(PYTEST_OPTIONS) -m "not slow" $(LTS_TESTS)

bench: setup
	$(PYTHON) -m tests.benchmarks $(BENCH_OPTIONS)

bench-peers: setup
	$(PYTHON) -m tests.benchmarks --peers $(BENCH_OPTIONS)

check: setup
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy
	$(PYTHON) -m vir_addon.device.check_shaders

# Wheels are fetched again when their pinned versions change.
$(WHEELS)/.fetched: pyproject.toml tools/extension.py | setup
	@rm -rf $(WHEELS) && mkdir -p $(WHEELS)
	$(PYTHON) tools/extension.py wheels $(WHEELS)
	@touch $@

extension: setup $(WHEELS)/.fetched
	@mkdir -p dist
	$(PYTHON) tools/extension.py validate
	$(PYTHON) tools/extension.py build dist $(WHEELS)

clean:
	rm -rf .venv .venv-lts out dist build
