# Set-up, tests and the demo. Everything is installed into virtual environments below this folder. Benches and the paper have Makefiles of their own.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
TRAINING_VENV := .venv-training
TRAINING_BIN := $(TRAINING_VENV)/bin
DOCS_VENV := .venv-docs
DOCS_BIN := $(DOCS_VENV)/bin
CARGO ?= cargo

RUST_SOURCES := $(shell find crates -name '*.rs' -o -name 'Cargo.toml' | grep -v /target/) Cargo.toml Cargo.lock
PACKAGE_FILES := $(shell find python -type f -not -name '*.pyc' -not -name '*.so')

.PHONY: docs help demo test test-rust test-sturdy test-python test-slow test-training test-wheel crates lint wheel install install-dev training bench phantom-data phantom-model table2-model small-model demo-figures clean

help:
	@echo "make demo            build the wheel, install it, register the embedded phantom -> demo/"
	@echo "make test            tests of the Rust crates and the Python package (no torch); make test-slow: those of minutes;"
	@echo "                     make test-python TESTS=tests/layout: some"
	@echo "make test-sturdy     a thousand known equilibria, two thousand random inputs, every reader on 10,000 spoilt files"
	@echo "make test-training   set up training/ with torch and test it"
	@echo "make docs            the documentation site, to be read from files -> build/site/index.html"
	@echo "make crates          what would be published of each crate, built and run outside the repository (DIRTY=--allow-dirty)"
	@echo "make test-wheel      the wheel installed without a compiler, and another one built from the source archive"
	@echo "make lint            formatters, linters, types"
	@echo "make bench           times by stage of whole registrations; all other benches: benchmarks/README.md"
	@echo "make phantom-model   data set and shipped models of the phantom, anew (hours; resumable); make table2-model: the paper's"
	@echo "                     network on the same data; make small-model: that of tests, on the small phantom (half an hour)"
	@echo "make demo-figures    what the README shows of the demo, after a change of model or phantom"

# What a build needs, said before anything is made.
define CHECK_TOOLS
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || { \
	  echo "error: Python 3.11 or later must be there; '$(PYTHON)' is not: make PYTHON=python3.12, or https://www.python.org/downloads" >&2; exit 1; }
	@command -v $(CARGO) > /dev/null || { \
	  echo "error: building needs Rust 1.89 or later, and '$(CARGO)' is not there: https://rustup.rs installs it" >&2; exit 1; }
endef

$(BIN)/python:
	$(CHECK_TOOLS)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet "maturin>=1.9,<2"

# The wheel is rebuilt when a source changed; the stamp stands for what is installed. Its core also goes among the sources,
# which tests and tools take that are run by hand (tools/own_sources.py).
$(VENV)/.installed: $(BIN)/python $(RUST_SOURCES) $(PACKAGE_FILES) pyproject.toml README.md
	$(CHECK_TOOLS)
	@echo "1 of 2: building the wheel, the first time about 3 minutes on two cores"
	rm -rf target/wheels
	$(BIN)/maturin build --release --interpreter $(BIN)/python --out target/wheels
	$(BIN)/python tools/pack_wheel.py target/wheels/tissuereg-*.whl
	@echo "2 of 2: installing it and the packages that it needs, a minute or less"
	$(BIN)/python -m pip install --quiet --force-reinstall --no-deps target/wheels/tissuereg-*.whl
	$(BIN)/python -m pip install --quiet target/wheels/tissuereg-*.whl
	cp $(VENV)/lib/python3*/site-packages/tissuereg/_core.*.so python/tissuereg
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet "$$(ls target/wheels/tissuereg-*.whl)[dev,mesh]"
	touch $@

wheel install: $(VENV)/.installed
install-dev: $(VENV)/.installed-dev

demo: $(VENV)/.installed
	@echo "registering the embedded phantom, some seconds"
	$(BIN)/tissuereg demo --out demo

# The wheel is tested.
PYTEST := TISSUEREG_INSTALLED=1 $(BIN)/python -m pytest

test: test-rust test-python

test-rust:
	$(CARGO) test

test-sturdy: $(VENV)/.installed-dev
	TISSUEREG_CASES=1000 $(CARGO) test -p tissuereg-fem --test manufactured -- --nocapture
	TISSUEREG_CASES=2000 $(CARGO) test -p tissuereg-fem --test fuzz
	TISSUEREG_CASES=10000 $(PYTEST) tests/unit/test_fuzzed_files.py

# Files side by side in a process a core, so that what a module prepares is made once; WORKERS=0: one after another.
# TESTS="tests/layout tests/unit/test_material*.py": these alone.
WORKERS ?= logical
TESTS ?=

test-python: $(VENV)/.installed-dev
	$(PYTEST) -m "not slow" -n $(WORKERS) --maxprocesses 8 --dist loadfile --no-loadscope-reorder $(TESTS)

# Tests that take minutes; among them, each bench and each study of the paper once with its smallest case.
test-slow: $(VENV)/.installed-dev
	$(MAKE) -C paper install
	$(PYTEST) -m slow
	$(MAKE) -C paper test-slow

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

# The site needs neither the wheel nor what it depends on: sources are read, not imported. Two builders take the same
# pages: mkdocs-material, whose maintenance ends in May 2027, and Zensical, which follows it. The 404 page is left out:
# its links begin at the root of a server, and the site is also read from files.
$(DOCS_VENV)/.installed: pyproject.toml tools/extra.py
	$(PYTHON) -m venv $(DOCS_VENV)
	$(DOCS_BIN)/python -m pip install --quiet --upgrade pip
	$(DOCS_BIN)/python tools/extra.py docs > $(DOCS_VENV)/requirements.txt
	$(DOCS_BIN)/python -m pip install --quiet --requirement $(DOCS_VENV)/requirements.txt
	touch $@

docs: $(DOCS_VENV)/.installed
	$(DOCS_BIN)/python tools/site_source.py build/site-source
	$(DOCS_BIN)/zensical build --config-file mkdocs.yml --strict --clean
	rm -rf build/site-zensical && mv build/site build/site-zensical
	NO_MKDOCS_2_WARNING=1 $(DOCS_BIN)/mkdocs build --strict --quiet
	rm -f build/site/404.html build/site-zensical/404.html
	$(DOCS_BIN)/python tools/check_site.py build/site build/site-zensical

# Times by stage of whole registrations; the other benches: benchmarks/README.md.
bench:
	$(MAKE) -C benchmarks/speed stages

# Runs of hours: each goes on where it was stopped. What is shipped are the files of build/phantom-model and build/phantom-graph.
phantom-data: $(VENV)/.installed
	$(BIN)/tissuereg simulate training/recipes/breast.toml --out build/phantom-data

# Pairs of simulation and truth of other rigs, with which the model is calibrated (paper/).
PRESSED ?= build/pressed
FOREIGN ?= build/foreign
PAIRS := --pairs build/phantom-pairs --pairs $(FOREIGN)/development --pairs $(PRESSED)

phantom-model: phantom-data training
	$(MAKE) -C paper pairs PRESSED=$(PRESSED)
	$(MAKE) -C benchmarks/learned data FOREIGN=$(FOREIGN)
	$(BIN)/tissuereg simulate training/recipes/breast-more.toml --out build/phantom-more
	$(BIN)/tissuereg simulate training/recipes/breast-pairs.toml --out build/phantom-pairs
	$(TRAINING_BIN)/tissuereg train training/recipes/closure.toml --data build/phantom-data --data build/phantom-more --out build/phantom-model $(PAIRS)
	$(TRAINING_BIN)/tissuereg train training/recipes/graph.toml --data build/phantom-data --data build/phantom-more --out build/phantom-graph $(PAIRS) --patterns 20

table2-model: phantom-data training
	$(TRAINING_BIN)/tissuereg train training/recipes/table2.toml --data build/phantom-data --out build/table2-model

small-model: training
	$(BIN)/tissuereg simulate training/recipes/small.toml --out build/small-data
	$(TRAINING_BIN)/tissuereg train training/recipes/small.toml --data build/small-data --out build/small-model

# What the README and docs/phantom.png show of the demo, with the model that is shipped.
demo-figures: $(VENV)/.installed-dev
	$(BIN)/python tools/demo_figures.py

clean:
	rm -rf python/tissuereg/_core.*.so target $(VENV) $(TRAINING_VENV) $(DOCS_VENV) .venv-peers build demo
