PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOCKED := .cache/lock

DEMO := gong_example_1 gong_example_1_spline gong_example_2 gong_example_3a gong_example_3b gong_example_6

# In CI the tests that take longer run too, and those that need other tools, which CI installs: no test skips there.
MARKED := $(if $(CI),,-m "not long")
COMMA := ,
EXTRAS := test$(COMMA)docs$(if $(CI),$(COMMA)masters)
READY := $(VENV)/ready$(if $(CI),-ci)
FUZZ_SECONDS := 300
AS_ROOT := $(if $(filter-out 0,$(shell id -u)),sudo)

.PHONY: demo test docs bench trust fuzz mutants setup ci-tools lock clean

demo: setup ## set up, build the paper's FMUs and systems, run its Examples 1 to 3 and 6, write results/demo/report.html
	$(BIN)/python build_fmus.py $(DEMO:%=--only %)
	$(BIN)/python demo.py

test: setup $(if $(CI),ci-tools) ## set up, lint, check types, run the tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pytest -n logical --dist worksteal $(MARKED)

docs: setup ## the documentation as a site, build/site/index.html, without any other host; a link that leads nowhere fails
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: setup ## print timings, side by side with what one would use instead
	$(BIN)/python build_fmus.py --only duffing_pseudospectral
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.windows
	$(BIN)/python -m benchmarks.window_sizes
	$(BIN)/python -m benchmarks.linear_gain
	$(BIN)/python -m benchmarks.filters
	$(BIN)/python -m benchmarks.elementary
	$(BIN)/python -m benchmarks.compliance
	$(BIN)/python -m benchmarks.plant_inside

trust: setup ## print how often observers are wrong, and how often silently, under twenty corruptions of the measurements
	$(BIN)/python -m benchmarks.trust

fuzz: setup ## fuzz the FMUs' C for FUZZ_SECONDS (clang's libFuzzer and sanitizers: make ci-tools)
	$(BIN)/python tests/fuzz/fuzz_fmus.py $(FUZZ_SECONDS) build/fuzz

# MUTANTS: options, such as --area shell --seed 2; an interrupted run goes on where it stopped.
mutants: setup ## put small faults into a copy of the code and see how many the fast tests find (tests/mutants/README.md; hours)
	$(BIN)/python tests/mutants/mutants.py $(MUTANTS)

setup: $(READY)

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e ".[$(EXTRAS)]"
	touch $@

# Wine runs the Windows binaries, qemu the ARM ones; gcc and tcc compile the sources, for 32-bit ARM and MIPS too; clang fuzzes; valgrind counts; Chromium draws the reports; Ecos needs libtbb12.
CI_PACKAGES := wine64 wine libtbb12 qemu-user libc6-arm64-cross gcc libc6-dev gcc-arm-linux-gnueabihf libc6-dev-armhf-cross gcc-mips-linux-gnu libc6-dev-mips-cross tcc valgrind chromium clang libclang-rt-14-dev

ci-tools: ## Debian packages of other people's tools
	dpkg-query --show --showformat='$${db:Status-Status}\n' $(CI_PACKAGES) 2>&1 | grep -Fvqx installed || exit 0; \
	    $(AS_ROOT) apt-get update && \
	    $(AS_ROOT) apt-get install --yes --no-install-recommends $(CI_PACKAGES)

lock: ## renew constraints.txt: the newest versions that pyproject.toml allows
	rm -rf $(LOCKED)
	$(PYTHON) -m venv $(LOCKED)
	$(LOCKED)/bin/python -m pip install --disable-pip-version-check -e ".[test,docs,masters]"
	{ echo "# The exact versions that make and CI install, by \`make lock\`: the same lock, the same bytes (docs/fmu.md)."; \
	    $(LOCKED)/bin/python -m pip freeze --disable-pip-version-check --exclude observer-fmus; } > $(LOCKED)/constraints.txt
	mv $(LOCKED)/constraints.txt constraints.txt

clean:
	rm -rf $(VENV) .cache fmus systems results build
