# make demo: the main job on the simulated rig.   make test: all checks and tests.
# Both set up everything they need; tests need Debian packages too, which .ci/system-packages installs.

SEED ?= 0
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: help setup demo virtual-bench bench figures test lint types imports tests coverage lock clean

help:
	@echo "make setup          everything that Python needs, into .venv; then: . .venv/bin/activate"
	@echo "make demo [SEED=0]  capture 25 poses on the simulated rig and calibrate them"
	@echo "make virtual-bench  run a bench without hardware for rig-capture (docs/virtual-bench.md)"
	@echo "make bench          all benchmarks, a table each"
	@echo "make test           linter, type checker, import contracts, tests; installs Debian packages (.ci/system-packages)"
	@echo "make coverage       the tests, and which lines they never reach"
	@echo "make lock           renew requirements.lock from pyproject.toml"
	@echo "make clean          remove the environment and everything the demo made"

setup: $(STAMP)

$(STAMP): requirements.lock pyproject.toml
	python=$$(PYTHON="$(PYTHON)" .ci/python) && "$$python" -m venv .venv
	$(BIN)/pip install --quiet --require-hashes --requirement requirements.lock
	$(BIN)/pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $(STAMP)

demo: setup
	@rm -f demo.h5 demo.calib.yaml demo.report.html demo.arrivals.npz
	$(BIN)/rig-capture --session demo --rig simulated --seed $(SEED)
	$(BIN)/rig-calibrate demo.h5

# real stacks without hardware, until Ctrl-C
virtual-bench: setup
	.ci/system-packages
	@PYTHONPATH=tests $(BIN)/python -m virtual_bench

# README's pictures, from the demo's report and its verification, and the bench guide's drawings
figures: setup
	.ci/system-packages
	$(BIN)/python docs/figures/screenshot.py demo.report.html docs/figures/report.png
	$(BIN)/rig-verify demo.h5 --calibration demo.calib.yaml --overwrite
	$(BIN)/python docs/figures/overlay.py
	$(BIN)/python docs/figures/bench.py

bench: setup
	.ci/system-packages
	@for each in benchmarks/*.py; do $(BIN)/python $$each || exit 1; done

test: lint types imports tests

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

imports: setup
	$(BIN)/lint-imports

tests: setup
	.ci/system-packages
	$(BIN)/pytest --numprocesses=auto --dist=worksteal

# the same tests, half as slow again, with the lines they never reach
coverage: setup
	.ci/system-packages
	$(BIN)/pytest --numprocesses=auto --dist=worksteal --cov --cov-report=term

lock:
	$(BIN)/uv pip compile --quiet --universal --generate-hashes --no-emit-index-url --no-emit-find-links --no-header \
	    --extra aislab --extra study --group dev --output-file requirements.lock pyproject.toml

clean:
	rm -rf .venv virtual-bench firmware/build .coverage* .mypy_cache .ruff_cache .pytest_cache
	rm -rf demo.h5 demo.calib.yaml demo.report.html demo.arrivals.npz demo.verify
