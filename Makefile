PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

DEMO := gong_example_1 gong_example_1_spline gong_example_2 gong_example_3a gong_example_3b

# In CI the tests that take longer run too.
MARKED := $(if $(CI),,-m "not long")

.PHONY: demo test bench setup clean

demo: setup ## set up, build the paper's FMUs and systems, run its Examples 1 to 3, write results/demo/report.html
	$(BIN)/python build_fmus.py $(DEMO:%=--only %)
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
	$(BIN)/python -m benchmarks.elementary

setup: $(VENV)/ready

$(VENV)/ready: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check -e ".[test]"
	touch $@

clean:
	rm -rf $(VENV) .cache fmus systems results build
