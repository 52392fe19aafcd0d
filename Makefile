# make demo: from the URDF of the paper's arm to its identified inertia matrix.  make test: lint, types, walls, tests.
PYTHON ?= python3
BIN := .venv/bin
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
PIP := $(BIN)/pip install -q --disable-pip-version-check --no-compile
# uv unpacks in a fifth of pip's time; where it can not be had, or does not reach the packages, pip does the same.
UV := $(BIN)/uv pip install -q --python $(BIN)/python
install = $(UV) $(1) 2>/dev/null || $(PIP) $(1)
# By all cores, without the tests of others and what hardly any of is imported.
COMPILE := $(BIN)/python -m compileall -q -j 0 -x '/(tests?|OpenGL|fontTools|mypyc?|pygments|setuptools)/' .venv/lib
# Tests and workers are compiled once, not by every process again.
unexport PYTHONDONTWRITEBYTECODE
ROBOT := robots/ypp3

.PHONY: demo test lint fast bench bench-loop lock clean
.DELETE_ON_ERROR:

demo: .venv/runtime
	$(BIN)/symgen $(ROBOT)/ypp3.urdf -o out/ypp3/symgen
	@echo; echo "== Other joints held by their own motors: two masses can not explain it, and that is what is said"
	$(BIN)/ident run $(ROBOT) -o out/ypp3/dob --method two-mass --brief; test $$? -eq 1
	@echo; echo "== The same records, all motors fitted at once, and other estimators beside that"
	$(BIN)/ident fit out/ypp3/dob/campaign.h5 -o out/ypp3/coupled --method all --believe-zeros --brief
	@echo; echo "== Other joints rigid, as in the paper's simulation"
	$(BIN)/ident run $(ROBOT) -o out/ypp3/rigid --lock rigid
	@echo; echo "== Records of an arm with something that nobody declared: found, added, before and after"
	$(BIN)/ident simulate $(ROBOT) --spacing 0.5 --periods 3 --effect input-delay:time=0.001@joint1 -o out/ypp3/undeclared.h5
	$(BIN)/ident diagnose out/ypp3/undeclared.h5 -o out/ypp3/diagnosis --brief; test $$? -eq 1

test: lint fast

lint: .venv/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy -n 2
	$(BIN)/lint-imports

fast: .venv/dev
	$(BIN)/pytest -q -n 2 --dist worksteal

# The longer studies, and symgen beside its peers (tests/bench/RESULTS.md): up to an hour.
bench: .venv/dev
	$(BIN)/pytest -q -m bench
	$(BIN)/python tests/bench/bench_peers.py

# The blind study of the loop (tests/bench/RESULTS_LOOP.md): up to three hours on two cores; killed, it goes on where it was.
bench-loop: .venv/dev
	$(BIN)/python tests/bench/bench_loop.py

# The lock files pin what was tested; run this to move to newer releases.
lock:
	$(PYTHON) -m venv .venv-lock
	.venv-lock/bin/pip install -q pip-tools
	.venv-lock/bin/pip-compile -q --strip-extras --no-header --no-annotate --no-emit-find-links --no-emit-index-url -o requirements.lock pyproject.toml
	.venv-lock/bin/pip-compile -q --strip-extras --no-header --no-annotate --no-emit-find-links --no-emit-index-url --extra dev -c requirements.lock -o requirements-dev.lock pyproject.toml
	rm -rf .venv-lock

.venv/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "$(PYTHON) is older than 3.11: make PYTHON=/path/to/python3.11"; exit 2; }
	$(PYTHON) -m venv .venv
	@$(PIP) uv==0.13.9 || true
	@touch $@

.venv/runtime: .venv/python requirements.lock pyproject.toml
	$(call install,-r requirements.lock)
	$(call install,--no-deps -e .)
	$(COMPILE)
	@touch $@

# All of .venv/runtime, too: packages are resolved once.
.venv/dev: .venv/python requirements.lock requirements-dev.lock pyproject.toml
	$(call install,-r requirements-dev.lock)
	$(call install,--no-deps -e .)
	$(COMPILE)
	@touch .venv/runtime $@

clean:
	rm -rf .venv .venv-peers out build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
