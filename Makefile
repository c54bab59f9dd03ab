# Set-up, tests and the demo. Everything is installed into two virtual environments below this folder.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
TRAINING_VENV := .venv-training
TRAINING_BIN := $(TRAINING_VENV)/bin
DOCS_VENV := .venv-docs
DOCS_BIN := $(DOCS_VENV)/bin
CARGO ?= cargo
DATA ?= ../shared/data
REFERENCE ?= ../shared/reference

RUST_SOURCES := $(shell find crates -name '*.rs' -o -name 'Cargo.toml' | grep -v /target/) Cargo.toml Cargo.lock
PACKAGE_FILES := $(shell find python -type f -not -name '*.pyc' -not -name '*.so')

.PHONY: docs blind blind-quick blind-full blind-fine blind-oracle blind-without blind-rivals blind-ablations blind-beside blind-sizes blind-data loadfree loadfree-data loadfree-supports loadfree-supports-data loadfree-time help demo test test-rust test-sturdy test-python test-slow test-training test-wheel crates lint rust-docs wheel install install-dev training beam bench bench-cluster bench-solver bench-esmda peers phantom-data phantom-model table2-model small-model demo-figures clean paper phantom twin rig-pairs rig-variants spread spread-data

help:
	@echo "make demo            build the wheel, install it, register the embedded phantom -> demo/"
	@echo "make test            tests of the Rust crates and the Python package (no torch); make test-slow: those of minutes"
	@echo "make test-sturdy     a thousand known equilibria, two thousand random inputs, every reader on 10,000 spoilt files"
	@echo "make test-training   set up training/ with torch and test it"
	@echo "make docs            the documentation site, to be read from files -> build/site/index.html"
	@echo "make crates          what would be published of each crate, built and run outside the repository (DIRTY=--allow-dirty)"
	@echo "make test-wheel      the wheel installed without a compiler, and another one built from the source archive"
	@echo "make lint            formatters, linters, types"
	@echo "make beam            the measured silicone beam (DATA=$(DATA))"
	@echo "make blind-quick     the blind test bench: 16 hidden effects and 20 nulls -> docs/blind-quick.md"
	@echo "make blind           all of it: 514 cases of 600 nodes (make blind-full) -> docs/blind.md, 24 of 4,000 (make blind-fine)"
	@echo "                     -> docs/blind-fine.md; hours; JOBS=2: two cases side by side"
	@echo "make blind-beside    after it: oracle fits, rivals and ablations on the same cases (each alone: blind-oracle,"
	@echo "                     blind-without, blind-rivals, blind-ablations; TIER=quick or fine: of that tier)"
	@echo "make blind-sizes     prior standard deviations of the nuisances, estimated from diagnosed nulls"
	@echo "make blind-data      its data, made by another solver (hours; resumable; ONE=name: one, compared)"
	@echo "make loadfree        registration with an unknown load, on 200 simulated events -> docs/loadfree.md (HALF=test or"
	@echo "                     both, METHODS=..., JOBS=2); make loadfree-data: the events, by another solver (an hour; resumable)"
	@echo "make loadfree-supports  the same with partly wrong supports, on 24 further events; make loadfree-supports-data"
	@echo "make loadfree-time   wall times of whole registrations"
	@echo "make bench           times by stage -> benchmarks/results/"
	@echo "make bench-cluster   what Dask costs: overhead, task rate, bytes -> benchmarks/results/, docs/cluster.md"
	@echo "make bench-solver    the solver, the machine's limits and other programs (after: make peers)"
	@echo "make bench-esmda     one ES-MDA update, and other programs on the same arrays"
	@echo "make spread          is the spread of the trained model honest? -> docs/spread.md (MODEL=, SPREAD_DATA=, FOREIGN=); make"
	@echo "                     spread-data: shapes with physics that the model never saw (an hour; resumable)"
	@echo "make paper           the paper's simulation studies -> docs/paper.md (TABLE2=folder: also with a network of Table II)"
	@echo "make phantom         the paper's phantom experiment (section IV) on a virtual twin of its rig, every method -> "
	@echo "                     docs/phantom-experiment.md (FIELDS=folder); make twin: the twin's rigs, by another solver;"
	@echo "                     make rig-pairs: pairs of simulation and truth of other rigs, by ours, that calibrate the model;"
	@echo "                     make rig-variants: variants of the rigs' simulations, by ours"
	@echo "make phantom-model   data set and shipped model of the phantom, anew (hours; resumable); make table2-model: the paper's"
	@echo "                     network on the same data; make small-model: that of tests, on the small phantom (half an hour)"
	@echo "make demo-figures    what the README shows of the demo, after a change of model or phantom"

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet "maturin>=1.9,<2"

# The wheel is rebuilt when a source changed; the stamp stands for what is installed.
$(VENV)/.installed: $(BIN)/python $(RUST_SOURCES) $(PACKAGE_FILES) pyproject.toml README.md
	rm -rf target/wheels
	$(BIN)/maturin build --release --quiet --interpreter $(BIN)/python --out target/wheels
	$(BIN)/python -m pip install --quiet --force-reinstall --no-deps target/wheels/tissuereg-*.whl
	$(BIN)/python -m pip install --quiet target/wheels/tissuereg-*.whl
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet "$$(ls target/wheels/tissuereg-*.whl)[dev,mesh]"
	touch $@

wheel install: $(VENV)/.installed
install-dev: $(VENV)/.installed-dev

demo: $(VENV)/.installed
	$(BIN)/tissuereg demo --out demo

test: test-rust test-python

test-rust:
	$(CARGO) test --workspace --exclude tissuereg-bindings

test-sturdy: $(VENV)/.installed-dev
	TISSUEREG_CASES=1000 $(CARGO) test -p tissuereg-fem --test manufactured -- --nocapture
	TISSUEREG_CASES=2000 $(CARGO) test -p tissuereg-fem --test fuzz
	TISSUEREG_CASES=10000 $(BIN)/python -m pytest tests/unit/test_fuzzed_files.py

# Files side by side in a process a core, so that what a module prepares is made once; WORKERS=0: one after another.
WORKERS ?= logical

test-python: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --maxprocesses 8 --dist loadfile --no-loadscope-reorder

# Tests that take minutes.
test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow

# What would be published, and what a stranger does with it. DIRTY=--allow-dirty: with what is not committed.
crates: $(BIN)/python
	$(BIN)/python tools/check_crates.py $(DIRTY)

test-wheel: $(VENV)/.installed
	rm -rf target/sdist
	$(BIN)/maturin sdist --out target/sdist
	$(BIN)/python tools/check_wheel.py target/wheels/tissuereg-*.whl --sdist target/sdist/tissuereg-*.tar.gz

lint: $(VENV)/.installed-dev
	$(CARGO) fmt --all --check
	$(CARGO) clippy --workspace --all-targets -- --deny warnings
	RUSTDOCFLAGS="--deny warnings" $(CARGO) doc --workspace --no-deps --quiet
	$(BIN)/ruff format --check python tests examples benchmarks tools
	$(BIN)/ruff check python tests examples benchmarks tools
	$(BIN)/mypy
	cd $(VENV) && bin/python -m mypy.stubtest tissuereg._core --ignore-disjoint-bases

$(TRAINING_BIN)/python:
	$(PYTHON) -m venv $(TRAINING_VENV)
	$(TRAINING_BIN)/python -m pip install --quiet --upgrade pip

$(TRAINING_VENV)/.installed: $(TRAINING_BIN)/python $(VENV)/.installed training/pyproject.toml
	$(TRAINING_BIN)/python -m pip install --quiet --force-reinstall --no-deps target/wheels/tissuereg-*.whl
	$(TRAINING_BIN)/python -m pip install --quiet target/wheels/tissuereg-*.whl
	$(TRAINING_BIN)/python -m pip install --quiet --editable "training[dev]"
	touch $@

training: $(TRAINING_VENV)/.installed

test-training: training
	cd training && ../$(TRAINING_BIN)/python -m pytest

# The site needs neither the wheel nor what it depends on: sources are read, not imported.
$(DOCS_VENV)/.installed: pyproject.toml tools/extra.py
	$(PYTHON) -m venv $(DOCS_VENV)
	$(DOCS_BIN)/python -m pip install --quiet --upgrade pip
	$(DOCS_BIN)/python tools/extra.py docs > $(DOCS_VENV)/requirements.txt
	$(DOCS_BIN)/python -m pip install --quiet --requirement $(DOCS_VENV)/requirements.txt
	touch $@

docs: $(DOCS_VENV)/.installed
	NO_MKDOCS_2_WARNING=1 $(DOCS_BIN)/mkdocs build --strict --quiet
	$(DOCS_BIN)/python tools/check_site.py build/site

beam: $(VENV)/.installed-dev
	$(BIN)/python examples/beam.py --data $(DATA)/beam

# The blind test bench (tests/blind/README.md): a run that was stopped goes on. Every tier has its answers and its table.
JOBS ?= 1
TIER ?= full
BLIND := PYTHONPATH=tests $(BIN)/python -m blind
BLIND_OUT := build/blind
BLIND_ANSWERS = $(BLIND_OUT)/$(TIER)
BLIND_TABLE = docs/blind$(patsubst %,-%,$(filter-out full,$(TIER))).md

blind:
	$(MAKE) blind-full
	$(MAKE) blind-fine

blind-quick blind-full blind-fine: override TIER = $(@:blind-%=%)
blind-quick blind-full blind-fine: $(VENV)/.installed-dev
	$(BLIND).run --tier $(TIER) --jobs $(JOBS) --predictions $(BLIND_ANSWERS)
	$(BLIND).score $(BLIND_ANSWERS) --out $(BLIND_TABLE)

# Beside it, after it: what a fit is told comes from the answers of cases that it has answered.
blind-oracle blind-without blind-rivals blind-ablations blind-beside: $(VENV)/.installed-dev
	$(BLIND).score $(BLIND_ANSWERS) --list-oracle $(BLIND_OUT)/oracle.txt --list-without $(BLIND_OUT)/without.txt
	$(BLIND).run --tier $(TIER) --jobs $(JOBS) --predictions $(BLIND_ANSWERS) \
		--methods $(if $(filter %beside,$@),oracle without rivals ablations,$(@:blind-%=%))
	$(BLIND).score $(BLIND_ANSWERS) --out $(BLIND_TABLE)

# How large the nuisances must be, on the nulls among the answers.
blind-sizes: $(VENV)/.installed-dev
	$(BLIND).sizes $(BLIND_ANSWERS)
	$(BLIND).score $(BLIND_ANSWERS) --out $(BLIND_TABLE)

# Foreign solves that are missing, by scikit-fem (and pypardiso, where it is there), then the cases; ONE=name: one, compared.
blind-data: $(VENV)/.installed-dev
	PYTHONPATH=tests OMP_NUM_THREADS=1 ONE=$(ONE) $(BIN)/python -m blind.generator
	$(if $(ONE),,PYTHONPATH=tests OMP_NUM_THREADS=1 $(BIN)/python -m blind.generator.store)

bench-cluster: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/cluster.py

# Registration with an unknown load on simulated events (tests/loadfree/README.md); an interrupted run resumes.
HALF ?= dev
METHODS ?= contacts none rigid spline gaussian

loadfree: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/loadfree.py --half $(HALF) --jobs $(JOBS) --methods $(METHODS)
	PYTHONPATH=tests $(BIN)/python -m loadfree.table

# Events that are missing, by scikit-fem (and pypardiso, where it is there), then the archive of each body.
loadfree-data: $(VENV)/.installed-dev
	PYTHONPATH=tests OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python -m loadfree.generator

# The same where the user's supports are partly wrong; its events.
loadfree-supports: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/loadfree_supports.py --half $(HALF) --jobs $(JOBS)
	PYTHONPATH=tests $(BIN)/python -m loadfree.table

loadfree-supports-data: $(VENV)/.installed-dev
	PYTHONPATH=tests OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python -m loadfree.generator --supports

# Whole calls, timed: on a quiet machine.
loadfree-time: $(VENV)/.installed-dev
	$(BIN)/python benchmarks/loadfree_time.py

bench: $(VENV)/.installed
	$(BIN)/python benchmarks/run.py

# Other solvers, in an environment of their own; CalculiX (ccx) and FEBio (febio4) are used where the path has them.
peers:
	$(PYTHON) -m venv .venv-peers
	.venv-peers/bin/python -m pip install --quiet "felupe==11.3.*" "scikit-fem==12.*" pypardiso

bench-solver: $(VENV)/.installed
	$(BIN)/python benchmarks/solver.py --reference $(REFERENCE)

# Beside the smoothers of others, which are installed for it alone.
bench-esmda: $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet pyesmda dageo iterative_ensemble_smoother
	$(BIN)/python benchmarks/esmda.py

# Of the shipped model, on the data it was trained on: make phantom-data. TABLE2=FOLDER: with a trained network of Table II.
SPREAD_DATA ?= build/phantom-data
FOREIGN ?= build/foreign
MODEL ?= python/tissuereg/phantom/model

spread: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/spread.py --model $(MODEL) --data $(SPREAD_DATA) --foreign $(FOREIGN) \
		$(if $(TABLE2),--table2 $(TABLE2))

spread-data: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/spread.py --make-foreign $(FOREIGN)

# Rigs that are missing, by scikit-fem (and pypardiso, where it is there): a minute or two each; ONE=name: one;
# DEVELOPMENT=yes: those on which methods are tuned.
twin: $(VENV)/.installed-dev
	PYTHONPATH=tests:benchmarks OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python -m twin $(if $(ONE),--only $(ONE)) $(if $(DEVELOPMENT),--development)

# Pairs of simulation and truth of other rigs, by this package's solver, with which models are calibrated: half an hour.
PRESSED ?= build/pressed

rig-pairs: $(VENV)/.installed-dev
	PYTHONPATH=tests:benchmarks OMP_NUM_THREADS=1 $(BIN)/python -m twin.pairs $(PRESSED)

# Variants of the rigs' simulations, by this package's solver: forty minutes.
VARIANTS ?= build/variants

rig-variants: $(VENV)/.installed-dev
	PYTHONPATH=tests:benchmarks OMP_NUM_THREADS=1 $(BIN)/python -m twin.variants $(VARIANTS)

# Every method on them; FIELDS=folder: with those that need training fields.
phantom: $(VENV)/.installed rig-variants
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/phantom.py --variants $(VARIANTS) $(if $(FIELDS),--fields $(FIELDS))

# The studies of the seed paper; with TABLE2=FOLDER, a trained network of Table II, also with that one.
paper: $(VENV)/.installed
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/paper.py $(if $(TABLE2),--table2 $(TABLE2))

# Runs of hours: each goes on where it was stopped. What is shipped are the files of build/phantom-model.
phantom-data: $(VENV)/.installed
	$(BIN)/tissuereg simulate training/recipes/breast.toml --out build/phantom-data

phantom-model: phantom-data spread-data rig-pairs training
	$(BIN)/tissuereg simulate training/recipes/breast-more.toml --out build/phantom-more
	$(TRAINING_BIN)/tissuereg train training/recipes/closure.toml --data build/phantom-data --data build/phantom-more --out build/phantom-model
	$(BIN)/tissuereg calibrate build/phantom-model --data build/phantom-data --pairs $(FOREIGN)/development --pairs $(PRESSED)

table2-model: phantom-data training
	$(TRAINING_BIN)/tissuereg train training/recipes/table2.toml --data build/phantom-data --out build/table2-model

small-model: training
	$(BIN)/tissuereg simulate training/recipes/small.toml --out build/small-data
	$(TRAINING_BIN)/tissuereg train training/recipes/small.toml --data build/small-data --out build/small-model

# What the README and docs/phantom.png show of the demo, with the model that is shipped.
demo-figures: $(VENV)/.installed-dev
	$(BIN)/python tools/demo_figures.py

clean:
	rm -rf target $(VENV) $(TRAINING_VENV) $(DOCS_VENV) .venv-peers build demo
