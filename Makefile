# Two commands: `make demo` shows what coview does, `make test` says whether it is in order. Each sets up what it needs.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
SHAPES := --jaxtyping-packages=toolkit,models,placement_env,array_checks.check

# Open3D's wheel leaves these to the system.
LIBRARIES := libusb-1.0-0 libgl1 libgomp1
BROWSERS := chromium chromium-browser google-chrome
AS_ROOT := $(shell [ "$$(id -u)" = 0 ] || echo sudo)

# An ordinary torch depends on about 5 GB of CUDA, which nothing here needs: the CPU build of the pinned version is asked for
# first, and pip leaves it in place. Where pip's own index has none, `make TORCH_INDEX=...` names the one that PyTorch's
# installation page gives for CPU. `make TORCH_CPU=` takes the ordinary one.
TORCH_CPU := $(shell sed -n 's/^torch==//p' constraints.txt)+cpu
TORCH_INDEX :=

# what a target needs, such as lint and docs, is done two at a time
MAKEFLAGS += --jobs=2

.PHONY: setup demo test test-avx2 test-all bench lint docs compiled
setup: .venv/all

.venv/bin/python:
	$(PYTHON) -m venv .venv

define torch_without_cuda
	@test -z "$(TORCH_CPU)" || $(PIP) --no-deps $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) torch==$(TORCH_CPU) \
	2>/dev/null || echo "pip finds no torch $(TORCH_CPU): torch comes with CUDA, about 5 GB; see make TORCH_INDEX=..."
endef

define open3d_loads
	@$(BIN)/python -c "import open3d" 2>/dev/null \
	|| { $(AS_ROOT) apt-get update -qq && $(AS_ROOT) apt-get install -y -qq --no-install-recommends $(LIBRARIES); } \
	|| { echo "Open3D does not load: install $(LIBRARIES) with your system's package manager, then make again"; exit 1; }
endef

# The report is tested in a real browser, which is Debian's: what Playwright would download is not needed.
define chromium_is_there
	@for browser in $(BROWSERS); do command -v $$browser >/dev/null && exit 0; done; \
	{ $(AS_ROOT) apt-get update -qq && $(AS_ROOT) apt-get install -y -qq --no-install-recommends chromium; } \
	|| { echo "No Chromium, in which the report is tested: install one of $(BROWSERS), then make again"; exit 1; }
endef

# The demo needs the simulator and the report only; the tests need everything.
.venv/sim: pyproject.toml constraints.txt | .venv/bin/python
	$(torch_without_cuda)
	$(PIP) --editable ".[sim,report]"
	$(open3d_loads)
	touch $@

.venv/all: pyproject.toml constraints.txt | .venv/bin/python
	$(torch_without_cuda)
	$(PIP) --editable ".[all,dev]"
	$(open3d_loads)
	$(chromium_is_there)
	touch $@ .venv/sim

demo: .venv/sim
	$(BIN)/coview demo --out out/demo

lint: .venv/all
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: .venv/all
	$(BIN)/python -m sphinx -W --keep-going -E -q -b html docs out/docs

# Tests are compiled here once, not by each worker again; whatever is wrong in them, pytest tells below.
compiled: .venv/all
	PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest --collect-only -q >/dev/null 2>&1 || true

test: lint docs compiled
	PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

# Rays as another processor casts them: see tests/jittered_rays. NumPy and torch are held to AVX2 as well.
test-avx2: .venv/all
	PYTHONPATH=$(CURDIR)/tests/jittered_rays ATEN_CPU_CAPABILITY=avx2 NPY_DISABLE_CPU_FEATURES="AVX512F AVX512CD AVX512_SKX AVX512_ICL" \
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

test-all: lint docs
	PYTHONPATH=$(CURDIR)/tests/shape_checks $(BIN)/python -m pytest $(SHAPES)

bench: .venv/all
	for script in tests/benchmarks/*/bench_*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done
