# What every bench shares: the environment of the repository, and where things are. A bench is run in its own folder or by
# `make -C benchmarks/NAME`; what it makes on the way lies in build/ at the top of the repository.

TOP := $(abspath $(dir $(lastword $(MAKEFILE_LIST)))..)
DATA ?= $(TOP)/../shared/data
JOBS ?= 1
PYTHON := $(TOP)/.venv/bin/python
# Commands run at the top of the repository: `$(BENCH) -m misuse`, with one BLAS thread; `$(RUN) -m speed.run`, as a user.
RUN := cd $(TOP) && PYTHONPATH=benchmarks:tests $(PYTHON)
BENCH := cd $(TOP) && PYTHONPATH=benchmarks:tests OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(PYTHON)

.DEFAULT_GOAL := all
.PHONY: all install page

install:
	$(MAKE) -C $(TOP) install-dev
