# Each target makes the virtual environment first, from requirements.txt.
PYTHON ?= python3
# PyTorch's small CPU build: make train TORCH_INDEX=https://download.pytorch.org/whl/cpu
TORCH_INDEX ?=

.PHONY: train test demo results

train: .venv/installed
	.venv/bin/python train.py --env env1

test: .venv/installed
	.venv/bin/python -m pytest test_all.py

results: .venv/installed
	.venv/bin/python results.py --ablations

demo: .venv/installed
	.venv/bin/python navbot_min.py --env env1

.venv/installed: requirements.txt
	$(PYTHON) -m venv .venv
	$(if $(TORCH_INDEX),.venv/bin/pip install --index-url $(TORCH_INDEX) $(shell grep ^torch requirements.txt))
	.venv/bin/pip install -r requirements.txt
	touch .venv/installed
