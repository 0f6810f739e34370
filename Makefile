# Every target sets up what it needs: `make quickstart` and `make test` work in a fresh clone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: install quickstart test package test-slow notebooks validation test-gpu tables docs lint clean

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "gns_pl needs Python 3.11 or newer; name one: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[viz,viz3d,export,gis,notebooks,dev]'
	@touch $@

quickstart: $(STAMP)
	$(BIN)/python train.py +experiment=quickstart
	$(BIN)/python evaluate.py ckpt=runs/quickstart/best.ckpt

# In the order of the files: modules of few tests, which xdist would keep for the end, are the long ones.
test: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist loadscope --no-loadscope-reorder

# The wheel's commands and configuration in an empty folder, the README's Python and an exported step: slow tests, but of every push.
package: $(STAMP)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist worksteal -m slow tests/commands/test_cli.py tests/docs/test_python.py tests/convert/test_program.py

test-slow: $(STAMP)
	$(BIN)/python -m pytest -m slow

# The kernel is this environment's, whatever kernels a user has.
notebooks: $(STAMP)
	JUPYTER_PREFER_ENV_PATH=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist worksteal --nbmake notebooks --nbmake-timeout=600 --nbmake-kernel=python3 --durations=4

validation: $(STAMP)
	$(BIN)/python benchmarks/mpm_validation.py
	$(BIN)/python -m pytest -m validation

test-gpu: $(STAMP)
	$(BIN)/python -c 'import numba_cuda' 2>/dev/null || $(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[cuda]'
	$(BIN)/python -m pytest -m gpu

# What docs/ has of charts, promises, models, trust, deposits and MPM's validation, again of its measured tables; nothing is measured.
tables: $(STAMP)
	$(BIN)/python benchmark.py 'sets=[docs/charts/general,docs/charts/columns,docs/charts/plane]' out=docs logger.enabled=false
	$(BIN)/python benchmarks/promise.py --from-table
	$(BIN)/python benchmarks/results.py --from-table
	$(BIN)/python benchmarks/trust.py --from-table
	$(BIN)/python examples/inverse.py --from-table
	$(BIN)/python benchmarks/mpm_convergence.py --figure
	$(BIN)/python benchmarks/mpm_validation.py --figure
	$(BIN)/python docs/site/architecture.py

# Not --quiet: what is not shown is not counted. The variable silences a notice about the theme (docs/decisions.md).
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --clean
	@echo "site/index.html is the site; to search it too: $(BIN)/mkdocs serve"

$(VENV)/.docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	@touch $@

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

clean:
	rm -rf $(VENV) build dist site .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
