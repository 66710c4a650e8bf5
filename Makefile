# Two commands do everything: `make fit` and `make test`. Both make .venv first where it is missing.
PYTHON ?= python3
BIN := .venv/bin
ROBOT := data/smooth_sil_940.toml
TRIALS := data/load_cells_simulated.csv
# every command starts processes that import JAX: compiled modules are kept, whatever the shell asks for
unexport PYTHONDONTWRITEBYTECODE

.PHONY: fit test test-slow lint docs browser packaging studies benchmark clean

fit: .venv/ready  ## fit the shipped bench data and reproduce the paper's figures, into out/
	$(BIN)/cddf fit $(ROBOT) data/pulley_simulated.csv $(TRIALS) --out out/fit
	$(BIN)/cddf reproduce $(ROBOT) $(TRIALS) --out out/reproduce

test: .venv/ready  ## the tests of every change, on every core: four minutes on two
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test-slow: .venv/ready  ## the tests that take long, which `test` leaves out
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m slow

lint: .venv/ready
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright

docs: .venv/ready  ## the documentation, into out/site: its examples and the notebooks run, then its pages are checked
	$(BIN)/mkdocs build --strict
	$(BIN)/python -m pytest -m docs

browser: .venv/ready  ## the tests of the explorer's page; installs Chromium where Debian's packages may be installed
	@command -v chromium > /dev/null || test "$$(id -u)" != 0 || ! command -v apt-get > /dev/null || \
		{ apt-get update && apt-get install --yes --no-install-recommends chromium; } > /dev/null 2>&1 || \
		echo "Chromium could not be installed; the tests of the explorer's page will be skipped"
	$(BIN)/python -m pytest -m browser

packaging: .venv/ready  ## build wheel and source distribution, and use the wheel in environments of its own
	$(BIN)/python -m pytest -m packaging

studies: .venv/ready  ## every study of fitting/, into out/fitting/ and out/design/
	for study in fitting/*.py; do $(BIN)/python $$study || exit 1; done
	for task in fitting/design_*.toml; do \
		$(BIN)/cddf design $$task --out out/design/$$(basename $$task .toml) || exit 1; done

benchmark: .venv/ready  ## accuracy and time of the methods, into out/benchmark/
	$(BIN)/python benchmarks/program_size.py
	$(BIN)/python benchmarks/methods.py
	$(BIN)/python benchmarks/loads.py
	$(BIN)/python benchmarks/error_estimate.py
	$(BIN)/python benchmarks/interval_coverage.py
	$(BIN)/python benchmarks/held_samples.py
	$(BIN)/python benchmarks/loop_coverage.py
	$(BIN)/python benchmarks/driven_coverage.py --tendons 1
	$(BIN)/python benchmarks/loop_checks.py
	$(BIN)/python benchmarks/standard_errors.py
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[benchmark]"
	$(BIN)/python benchmarks/fits.py
	$(BIN)/python benchmarks/seventeen_levels.py
	$(BIN)/python benchmarks/batch.py
	$(BIN)/python benchmarks/single_solve.py
	$(BIN)/python benchmarks/space.py
	$(BIN)/python benchmarks/space_loads.py
	$(BIN)/python benchmarks/traces.py
	$(BIN)/python benchmarks/sweeps.py
	$(BIN)/python benchmarks/designs.py
	$(BIN)/python benchmarks/cold_start.py
	$(BIN)/python benchmarks/table.py

.venv/ready: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("cddf_jax needs Python 3.11 or newer")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --constraint constraints.txt --editable ".[test,lint]"
	touch $@

clean:
	rm -rf .venv out
