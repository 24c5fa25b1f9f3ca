# Each target makes the virtual environment first, from requirements.txt.
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

# Only the lesson's tests, half a minute.
quick: .venv/installed
	$(BIN)/python -m pytest test_all.py

# Every test.
test: .venv/tests-installed
	$(BIN)/python -m pytest

evaluate: .venv/installed
	$(BIN)/python -m evaluation $(RUN)

# Trains and examines all that the tables show: hours.
results: .venv/experiments-installed
	$(BIN)/python -m experiments.results --ablations

# The figures and tables again, from what the results left.
figures: .venv/experiments-installed
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

.venv/tests-installed: .venv/experiments-installed support/requirements-test.txt
	$(BIN)/pip install -r support/requirements-test.txt
	touch .venv/tests-installed
