# Two commands do all the set-up on a machine that has Python 3.11 and make: `make demo` and `make test`.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
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

$(VENV)/.ready: requirements.txt pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps -e .
	touch $@

clean:
	rm -rf $(VENV) demo dist docs/api
