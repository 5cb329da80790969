# Everything from a clean checkout: python 3.11 or newer, make and pip are all that is needed.
#   make demo    the main job on a simulated drive in a town
#   make test    all tests
#   make lint    style, types, and which module may import which
#   make docs    the documentation as a site, in site/
#   make bench   speed beside other programs (needs ../shared/data or STARWISE_SHARED_DATA, and Debian's rtklib)
#   make bench-all   and all tables of accuracy

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
BENCH  := $(VENV)/.installed-bench
WORKERS ?= 2

.PHONY: all demo test test-nojit lint format docs bench clean
all: lint test

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

$(BENCH): $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev,bench]"
	touch $@

demo: $(STAMP)
	$(BIN)/starwise demo

test: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS)

# Laws again with the kernels as plain Python: what numba compiles is what is written. Laws that run whole filters of
# many states would take minutes each.
WHOLE := tests/test_colored.py tests/test_colored_honesty.py tests/test_ins.py tests/test_ins_tight.py tests/test_run_system.py tests/test_what_if.py
test-nojit: $(STAMP)
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -q -n $(WORKERS) -m "laws and not slow and not real" -k "not 10000_epochs and not chi_square" \
	  $(WHOLE:%=--ignore=%)

lint: $(STAMP)
	$(BIN)/ruff check --output-format concise
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

format: $(STAMP)
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

docs: $(STAMP)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

bench: $(BENCH)
	$(BIN)/python -m benchmarks --json bench.json

# All other tables: accuracy, honesty, studies. Hours.
SUITE := _bench __main__ suite datasets whole_process spp update reading mechanisation monte_carlo_peers calibrate
bench-all: bench
	for table in $(filter-out $(SUITE:%=benchmarks/%.py),$(wildcard benchmarks/*.py)); do \
	  grep -q "^if __name__" $$table || continue; echo "== $$table"; $(BIN)/python $$table || exit 1; done

clean:
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache starwise-demo site
