# Everything here makes its own virtual environment; it needs python3 (3.11 or newer), pip and make.
PYTHON ?= python3
VENV ?= .venv
BIN = $(VENV)/bin
INSTALLED = $(VENV)/.installed

.PHONY: demo docs pictures test machine test-browser test-slow test-all check check-types check-house check-style mutants fuzz mistakes sbom benchmark clean

demo: $(VENV)/.base
	$(BIN)/undrift demo --out demo

export OPENBLAS_NUM_THREADS = 1  # the matrices are small, threads cost more than they save
unexport PYTHONDONTWRITEBYTECODE  # the suite starts many processes: each would compile all of undrift and of its tests

# Two processes more than cores: tests of the rig and of the pages wait for sockets and clocks most of their time.
WORKERS := $(shell echo $$(($$(nproc 2>/dev/null || echo 2) + 2)))
PYTEST = $(BIN)/python -m pytest tests --ignore=tests/house -n $(WORKERS) --dist worksteal --durations=12

test: machine $(INSTALLED)
	@echo "Collecting the tests takes up to a minute. Then each test prints a dot."
	$(PYTEST)

# The system packages that the tests need: gcc compiles exported C, chromium shows the pages.
# Only root may install them, and only apt-get is known here. Without a package its tests are skipped with the reason.
machine:
	@missing=""; \
	command -v gcc >/dev/null || missing="gcc libc6-dev"; \
	command -v chromium >/dev/null || missing="$$missing chromium"; \
	if [ -z "$$missing" ]; then \
	  echo "System packages: nothing to install, gcc and chromium are here."; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  echo "System packages: apt-get installs $$missing."; \
	  apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $$missing || \
	    echo "System packages: apt-get failed. Tests that need $$missing are skipped."; \
	else \
	  echo "System packages: $$missing missing. Tests that need them are skipped. Only root on a system with apt-get installs them here."; \
	fi

# The bench in a browser alone: pages, wizards, the rate-table run, the emergency stop. Screenshots: build/screens.
test-browser: machine $(INSTALLED)
	UNDRIFT_SCREENS=build/screens $(BIN)/python -m pytest tests/web_browser -m "slow or not slow" --durations=12

# The bench's pictures of docs/bench.md, from a simulated phone and the practice device: commit what changed.
pictures: $(INSTALLED)
	UNDRIFT_PICTURES=docs/pictures $(BIN)/python -m pytest tests/web_browser/test_files.py tests/web_browser/test_practice.py -m "slow or not slow"

# What `make test` leaves out: tests marked slow. A test has no time limit here.
test-slow: machine $(INSTALLED)
	$(PYTEST) -m slow --timeout=0

# Linters, types, layers, house rules and habits of sentences at once; each is printed as it ends.
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
	$(BIN)/python docs/english.py

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
