# Two commands do all the set-up on a machine that has Python 3.11 and make: `make demo` and `make test`.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
PACKAGES := $(filter-out _kernels __pycache__,$(notdir $(patsubst %/,%,$(wildcard src/kreisel/*/))))

.PHONY: demo test lint docs clean

demo: $(VENV)/.ready
	$(BIN)/kreisel demo -o demo
	@echo "the report: demo/report.html"

test: $(VENV)/.ready
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(VENV)/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.ready
	$(BIN)/pdoc --docformat numpy --output-directory docs/api $(addprefix kreisel.,$(PACKAGES))

$(VENV)/.ready: requirements.txt pyproject.toml hatch_build.py $(wildcard src/kernels/*)
	$(PYTHON) -m venv $(VENV)
	$(PIP) -r requirements.txt
	$(BIN)/python hatch_build.py --compiler >/dev/null || $(PIP) ziglang==0.17.1
	$(PIP) --no-build-isolation --no-deps -e .
	touch $@

clean:
	rm -rf $(VENV) demo dist docs/api
