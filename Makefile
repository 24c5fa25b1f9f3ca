# Each target first creates the virtual environment from requirements.txt.
PYTHON ?= python3
# PyTorch's small CPU build: make train TORCH_INDEX=https://download.pytorch.org/whl/cpu
TORCH_INDEX ?=
# The run to evaluate: make evaluate RUN=runs/env1-seed0
RUN ?= pretrained/env1.safetensors
BIN = .venv/bin

.PHONY: train demo quick test evaluate results figures benchmark

train: .venv/installed
	$(BIN)/python train.py --env env1

demo: .venv/installed
	$(BIN)/python navbot_min.py --env env1

# The tests of the lesson: about 30 seconds.
quick: .venv/installed
	$(BIN)/python -m pytest test_all.py

# All tests.
test: .venv/tests-installed
	$(BIN)/python -m pytest -rs

evaluate: .venv/installed
	$(BIN)/python -m evaluation $(RUN)

# Trains and evaluates what is missing in results/, then makes tables and figures.
results: .venv/experiments-installed .venv/robot-installed
	$(BIN)/python -m experiments.results

# Makes the figures and tables from the files in results/.
figures: .venv/experiments-installed .venv/robot-installed
	$(BIN)/python -m experiments.figures
	$(BIN)/python -m experiments.diagrams
	$(BIN)/python -m experiments.tables

benchmark: .venv/experiments-installed
	$(BIN)/python -m experiments.benchmark

.venv/installed: requirements.txt
	$(PYTHON) -m venv .venv
	$(if $(TORCH_INDEX),$(BIN)/pip install --index-url $(TORCH_INDEX) $(shell grep ^torch requirements.txt))
	$(BIN)/pip install -r requirements.txt
	touch .venv/installed

.venv/experiments-installed: .venv/installed experiments/requirements.txt
	$(BIN)/pip install -r experiments/requirements.txt
	touch .venv/experiments-installed

.venv/robot-installed: .venv/installed robot/requirements.txt
	$(BIN)/pip install -r robot/requirements.txt
	touch .venv/robot-installed

.venv/tests-installed: .venv/experiments-installed support/requirements-test.txt
	$(BIN)/pip install -r support/requirements-test.txt
	touch .venv/tests-installed
