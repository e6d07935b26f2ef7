PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# In CI the tests that take longer run too.
MARKED := $(if $(CI),,-m "not long")

.PHONY: demo test bench setup clean

demo: setup ## set up, build FMUs and systems, run the paper's examples, write results/demo/report.html
	$(BIN)/python build_fmus.py
	$(BIN)/python demo.py

test: setup ## set up, lint, check types, run the tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest $(MARKED)

bench: setup ## print timings, side by side with what one would use instead
	$(BIN)/python build_fmus.py --only duffing_pseudospectral
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.linear_gain

setup: $(VENV)/ready

$(VENV)/ready: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check -e ".[test]"
	touch $@

clean:
	rm -rf $(VENV) .cache fmus systems results build
