# Everything here makes its own virtual environment; it needs python3 (3.11 or newer), pip and make.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
INSTALLED = $(VENV)/.installed

.PHONY: announce demo docs pictures durations test machine test-browser test-long test-all check check-types check-house check-style mutants fuzz mistakes sbom benchmark clean

demo: $(VENV)/.base
	$(BIN)/undrift demo --out demo

announce:
	@echo "make test: about 6,200 tests, 8 minutes on two cores. On a new machine Python packages, gcc, chromium and PostgreSQL"
	@echo "are installed first, some minutes, and kernels are compiled once."

export OPENBLAS_NUM_THREADS = 1  # the matrices are small, threads cost more than they save
unexport PYTHONDONTWRITEBYTECODE  # the suite starts many processes: each would compile all of undrift and of its tests

# Side by side: what computes, what waits for sockets and processes, and the browser: tests/testkit/pools.py.
CORES := $(shell nproc 2>/dev/null || echo 2)
PYTEST = $(BIN)/python -m pytest tests --ignore=tests/house --dist loadscope
COMPUTE = --tx $(CORES)*popen//env:TEST_POOL=compute
WAIT = --tx 2*popen//env:TEST_POOL=wait
BROWSER = --tx 1*popen//env:TEST_POOL=browser

test: announce $(INSTALLED) machine
	@echo "collecting the tests, up to a minute; then a dot for each, and the share done at the end of a line"
	$(PYTEST) $(COMPUTE) $(WAIT) $(BROWSER) --durations=12

# What the tests want of the machine besides Python.
machine:
	@command -v gcc >/dev/null || { apt-get update -qq && apt-get install -qq -y gcc libc6-dev; } || \
	  { echo "the tests compile exported C and want gcc: install it"; exit 2; }
	@command -v chromium >/dev/null || { apt-get update -qq && apt-get install -qq -y --no-install-recommends chromium; } || \
	  echo "no chromium: the pages are not looked at in a browser"
	@ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 || command -v initdb >/dev/null || { mkdir -p /etc/postgresql-common && \
	  echo "create_main_cluster = false" >> /etc/postgresql-common/createcluster.conf && apt-get update -qq && \
	  DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends -o Dpkg::Options::=--force-confold postgresql; } || \
	  echo "no PostgreSQL: the registry is tested on SQLite alone"

# The bench in a browser alone: pages, wizards, the rate-table run, the emergency stop. Screenshots: build/screens.
test-browser: $(INSTALLED) machine
	UNDRIFT_SCREENS=build/screens $(BIN)/python -m pytest tests/web_browser -m "long or not long" --durations=12

# The bench's pictures of docs/bench.md, from a simulated phone and the practice device: commit what changed.
pictures: $(INSTALLED)
	UNDRIFT_PICTURES=docs/pictures $(BIN)/python -m pytest tests/web_browser/test_ways.py tests/web_browser/test_path.py -m "long or not long" -k "zip or pointer"

# The order of the tests, by what each takes: commit the file that changes.
durations: $(INSTALLED)
	$(PYTEST) $(COMPUTE) $(WAIT) $(BROWSER) --write-durations

# What `make test` leaves out: whole ways and large sizes of what it shows in small (tests/long.json), larger cohorts.
test-long: $(INSTALLED) machine
	$(PYTEST) $(COMPUTE) $(WAIT) $(BROWSER) -m long --timeout=0 --durations=12

# Linters, types, layers and house rules at once; each is printed as it ends.
check: $(INSTALLED)
	@$(MAKE) --no-print-directory --jobs=3 --output-sync=target check-types check-house check-style

check-types:
	$(BIN)/mypy --strict

check-house:
	$(BIN)/python -m pytest tests/house

check-style:
	$(BIN)/ruff check src tests benchmarks docs/*.py docs/figures
	$(BIN)/ruff format --check src tests benchmarks docs/*.py docs/figures
	$(BIN)/lint-imports

# The documentation site, from pages, docstrings, commands and models; docs/pictures are drawn anew, commit what changed.
docs: $(INSTALLED)
	$(BIN)/python docs/generate.py docs/pictures
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

# Faults planted in a copy of the source, one at a time: prints those that the nearest tests do not notice. WORDS="six_face lag" selects.
mutants: $(INSTALLED)
	$(BIN)/python -m tests.mutants $(WORDS)

# Damaged files, in workers with limits, and each command on a disk that is full at any write: prints what crashes, hangs, is lost or is
# no clear line. WORDS selects damaged files by name.
fuzz: $(INSTALLED)
	$(BIN)/python -m tests.fuzz $(WORDS)
	$(if $(WORDS),,$(BIN)/python -m tests.fuzz.full_disk)

# Mistakes that users make, planted into simulated recordings: prints which are named, refused, warned of or silent. WORDS="orient rad/s" selects.
mistakes: $(INSTALLED)
	$(BIN)/python -m tests.mistakes $(WORDS)

# What an install consists of, as a CycloneDX bill of materials: build/sbom.json.
sbom:
	$(PYTHON) -m venv build/sbom-env
	build/sbom-env/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt .
	$(PYTHON) -m venv build/sbom-tool
	build/sbom-tool/bin/python -m pip install --quiet --disable-pip-version-check 'cyclonedx-bom>=7'
	build/sbom-tool/bin/cyclonedx-py environment build/sbom-env/bin/python --pyproject pyproject.toml -o build/sbom.json

benchmark: $(INSTALLED)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks

# The suite on every other Python that this machine has.
test-all: test
	@for version in 3.12 3.13; do \
	  python=$$(command -v python$$version) && $$python -c '' 2>/dev/null || \
	    python=$$(ls -d "$$(pyenv root 2>/dev/null)"/versions/$$version*/bin/python$$version 2>/dev/null | tail -n 1); \
	  if [ -n "$$python" ]; then \
	    echo "== Python $$version"; \
	    $(MAKE) --no-print-directory test PYTHON=$$python VENV=.venv-$$version || exit 1; \
	  else echo "== Python $$version is not on this machine"; fi; \
	done

# What the demo needs, and no more; the other targets install the tools of development besides.
$(VENV)/.base: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "undrift wants Python 3.11 or newer, got $$($(PYTHON) --version); say make PYTHON=python3.12"; exit 2; }
	test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV) || \
	  { rm -rf $(VENV); $(PYTHON) -m pip install --quiet virtualenv && $(PYTHON) -m virtualenv --quiet $(VENV); }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(INSTALLED): $(VENV)/.base
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

clean:
	rm -rf docs/_build docs/_generated .venv .venv-3.* .mypy_cache .ruff_cache .pytest_cache .import_linter_cache build dist demo
