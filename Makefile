# Two commands do all the set-up on a machine that has Python 3.11 and make: `make demo` and `make test`. The first installs
# what kreisel itself needs; the others add all extras and the tools of development.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
# Programs of others that results are compared with; what they need for pictures and documents is left out.
REFEREES := allantools==2024.6 fastcrc==0.5.0 imucal==2.6.0 lxml==6.1.3 pymavlink==2.4.50
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: demo test test-all lint site gallery api notebooks clean

demo: $(VENV)/.ready
	$(BIN)/kreisel demo -o demo
	@echo "the report: demo/report.html"

# More workers than cores: tests of live operation wait most of the time. One thread each, so that they do not compete.
# What fails is run once more by itself: live tests fail where other work, or another user of the machine, stops a
# process for a second. A fault fails again, and the first failure stays on the screen.
WORKERS ?= 4
# Bytecode is kept: each command that a test starts would compile 200 modules otherwise.
PYTEST := OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest
SPREAD := -n $(WORKERS) --dist worksteal
AGAIN := --last-failed --last-failed-no-failures none

# What to run before each commit, and what CI runs; test-all, before a release, also runs what is marked slow: studies,
# long scenarios, and further cases of what a quick test shows.
test: $(VENV)/.ready-dev
	$(PYTEST) $(SPREAD) -m "not slow" || $(PYTEST) $(AGAIN) -m "not slow"

test-all: $(VENV)/.ready-dev
	$(PYTEST) $(SPREAD) || $(PYTEST) $(AGAIN)

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The documentation site, site/index.html. `make -j2 site` makes its parts at the same time.
site: gallery api notebooks
	rm -rf site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

# Results and pictures, made by the commands themselves. Simulated devices need not be within limits: the exit status is
# then 3 or 4.
gallery: $(VENV)/.ready-dev
	rm -rf build/gallery build/pictures
	mkdir -p build/gallery
	$(BIN)/kreisel demo -o build/gallery/demo --seconds 120 >/dev/null
	$(BIN)/kreisel static build/gallery/demo/iNAV-FMS/recording -o build/gallery/static >/dev/null || [ $$? -ge 3 ]
	$(BIN)/kreisel compare build/gallery/demo/iNAV-FMS/recording --methods spkf,ekf,batch -o build/gallery/compare >/dev/null
	find build/gallery/demo -name recording -prune -exec rm -r {} +
	$(BIN)/kreisel certificate build/gallery/demo/iNAV-FMS/result -o build/gallery/certificate.html --limits fog || [ $$? -ge 3 ]
	$(BIN)/kreisel certificate build/gallery/demo/iNAV-FMS/result -o build/gallery/kalibrierschein.html --limits fog --language de || [ $$? -ge 3 ]
	$(BIN)/kreisel export build/gallery/demo/iNAV-FMS/result --to c -o build/gallery/imu.h >/dev/null
	$(BIN)/kreisel export build/gallery/demo/iNAV-FMS/result --to kalibr --grade fog -o build/gallery/imu.yaml >/dev/null
	$(BIN)/kreisel batch build/lot -o build/gallery/batch --simulate 12 --limits industrial-mems >/dev/null || [ $$? -ge 3 ]
	rm -r build/gallery/batch/results build/gallery/batch/results.db
	$(BIN)/python design/tour.py build/pictures
	$(BIN)/python design/explanatory_pictures.py build/pictures
	$(BIN)/python design/gallery_pictures.py build/gallery build/pictures

api: $(VENV)/.ready-dev
	rm -rf build/api
	$(BIN)/python design/api_pages.py build/api

notebooks: $(VENV)/.ready-dev
	rm -rf build/notebooks
	mkdir -p build/notebooks
	cp docs/notebooks/*.ipynb build/notebooks
	OPENBLAS_NUM_THREADS=1 $(BIN)/jupyter-execute --NbClientApp.log_level=ERROR --inplace build/notebooks/*.ipynb

$(VENV)/.ready: requirements.txt pyproject.toml hatch_build.py $(wildcard src/kernels/*)
	$(PYTHON) -m venv $(VENV)
	$(PIP) -r requirements.txt
	$(BIN)/python hatch_build.py --compiler >/dev/null || $(PIP) ziglang==0.17.1
	$(PIP) --no-build-isolation --no-deps -e .
	touch $@

$(VENV)/.ready-dev: $(VENV)/.ready requirements-dev.txt
	$(PIP) -r requirements.txt -r requirements-dev.txt
	$(PIP) --no-deps $(REFEREES)
	touch $@

clean:
	rm -rf $(VENV) demo dist build site
