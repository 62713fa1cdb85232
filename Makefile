# One door for every chore; each target makes the environment it needs in .venv.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
FIRMWARE_TOOLS = gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm cppcheck clang valgrind
SERVICE_TOOLS = mosquitto chromium
SPARK_TOOLS = openjdk-17-jre-headless
BUILD_TOOLS = cmake cython ninja numpy scikit-build-core
PIP = .venv/bin/python -m pip --quiet --disable-pip-version-check
SOURCES = $(shell find src csrc -name '*.pyx' -o -name '*.px[di]' -o -name '*.[ch]')

.PHONY: demo test test-long test-core coverage spark kills broker-kills service-faults soak check format bench bench-compare study hostile firmware \
    firmware-tools service-tools spark-tools golden images clean

# What the build needs, then pmfid with what it needs itself, at the versions of requirements-dev.txt. An edit of Python
# counts at once, an edit of C after `make`. What a command imports is compiled to bytecode, as some environments forbid
# Python to do so later.
IMPORTED = click jinja2 matplotlib numpy polars pydantic rich scipy
.venv/installed: requirements-dev.txt pyproject.toml CMakeLists.txt $(SOURCES)
	test -x .venv/bin/python || $(PYTHON) -m venv .venv
	$(PIP) install --no-compile -c requirements-dev.txt $(BUILD_TOOLS)
	$(PIP) install --no-compile -c requirements-dev.txt --no-build-isolation -e .
	cd .venv/lib/python3*/site-packages && env -u PYTHONDONTWRITEBYTECODE ../../../bin/python -m compileall -q -j 0 \
	$(IMPORTED) ../../../../src
	touch $@

# What tests, checks and studies need beyond that.
.venv/tools: requirements-dev.txt | .venv/installed
	$(PIP) install -r requirements-dev.txt
	touch $@

demo: .venv/installed
	.venv/bin/python -m examples.demo --out demo-report

# Cross compiler, emulator and checkers for the tests of the firmware; without them those tests skip. Installed only on
# request, as .ci/run does, and only where apt answers.
firmware-tools:
	@if [ -n "$(INSTALL_TOOLS)" ] && command -v apt-get >/dev/null && ! (command -v arm-none-eabi-gcc && command -v \
	qemu-system-arm && command -v cppcheck && command -v clang && command -v valgrind) >/dev/null; then \
	  root=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$root timeout 60 apt-get update -qq >/dev/null 2>&1; \
	  $$root timeout 170 env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    $(FIRMWARE_TOOLS) >/dev/null 2>&1 || echo "no firmware tools: their tests will skip"; \
	fi

# The broker and the browser for the tests of the service; without them they skip. In the same way.
service-tools: firmware-tools
	@if [ -n "$(INSTALL_TOOLS)" ] && command -v apt-get >/dev/null && \
	! (PATH="$$PATH:/usr/sbin" command -v mosquitto && command -v chromium) >/dev/null; then \
	  root=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$root timeout 60 apt-get update -qq >/dev/null 2>&1; \
	  $$root timeout 170 env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    $(SERVICE_TOOLS) >/dev/null 2>&1 || echo "no service tools: their tests will skip"; \
	fi

# The Java runtime for the tests of the fleet on Spark, and the extra; without them those tests skip.
spark-tools:
	@if [ -n "$(INSTALL_TOOLS)" ] && command -v apt-get >/dev/null && ! command -v java >/dev/null; then \
	  root=$$([ "$$(id -u)" = 0 ] || echo "sudo -n"); \
	  $$root timeout 60 apt-get update -qq >/dev/null 2>&1; \
	  $$root timeout 300 env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends \
	    $(SPARK_TOOLS) >/dev/null 2>&1 || echo "no Java runtime: the tests on Spark will skip"; \
	fi

EXTRA = import sys, tomllib; \
    print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"][sys.argv[1]])
.venv/spark: pyproject.toml | .venv/tools
	$(PIP) install -c requirements-dev.txt $$(.venv/bin/python -c '$(EXTRA)' spark)
	touch $@

# One process: a Spark in it has the other cores.
spark: .venv/spark
	@$(MAKE) --no-print-directory spark-tools INSTALL_TOOLS=1
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m pytest -p no:benchmark tests/spark

# A process for each core with one thread each (the threads of several would only wait for each other), a file of tests
# in one of them; benchmarks stay out, they want the machine for themselves. Bytecode is kept: where an environment
# forbids it, each process rewrites every assertion again, and each command that a test starts compiles all of pmfid.
WORKERS ?= auto
KEPT = env -u PYTHONDONTWRITEBYTECODE OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
# The whole run is bounded as well [s], against what no test's own limit reaches. The tests of the structure are those
# of `make check`.
BOUND = 840
PYTEST = $(KEPT) timeout --kill-after=20 $(BOUND) .venv/bin/python -m pytest -n $(WORKERS) --dist loadfile \
    --max-worker-restart 2 -p no:benchmark
STRUCTURE = tests/test_architecture.py tests/test_names.py tests/test_prose.py
test: .venv/tools firmware-tools service-tools
	$(PYTEST) -m "not long" $(STRUCTURE:%=--ignore %)

# The rest, of seconds each.
test-long: BOUND = 7200
test-long: .venv/tools firmware-tools service-tools
	$(PYTEST) -m long

# Core's tests in an environment of the hard dependencies alone. Out stay the tests of the layers above core (service,
# fleets, design, what lists the results of all layers) and of the extras (formats, frames).
ABOVE = $(wildcard tests/test_fleet_*.py tests/test_design_*.py tests/test_hostile*.py) $(addprefix tests/, service spark) \
    $(patsubst %,tests/test_%.py,formats frames logs_study openings presentation reproduce unpacked)
build/core/bin/pytest: requirements-dev.txt pyproject.toml CMakeLists.txt $(SOURCES)
	$(PYTHON) -m venv build/core
	build/core/bin/pip install --quiet -c requirements-dev.txt $(BUILD_TOOLS) pytest pytest-timeout pytest-xdist hypothesis
	build/core/bin/pip install --quiet -c requirements-dev.txt --no-build-isolation -C build-dir=build/core/cmake -e .
test-core: build/core/bin/pytest
	$(PYTEST:.venv/%=build/core/%) -m "not long" $(STRUCTURE:%=--ignore %) $(ABOVE:%=--ignore %)

# The lines of src/pmfid that the fast tests reach in their own processes.
coverage: BOUND = 2700
coverage: .venv/tools firmware-tools service-tools
	mkdir -p build/coverage
	$(PYTEST) -m "not long" --cov --cov-report=html:build/coverage/html --cov-report=term

# An hour of a hundred axes at their full rate: memory, latency and open files over time.
soak: .venv/tools service-tools
	mkdir -p results/images
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m studies.service.load --axes 100 --seconds 3600 \
	--out results/service_soak.md --image results/images/service_soak.png

# The service killed without notice, at named points and at random; every state and row must be as without.
KILLS ?= 1000
kills: .venv/tools
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m tests.service.kill_campaign --kills $(KILLS)

# The broker killed with the whole service connected to it, and the service in between.
BROKER_KILLS ?= 50
SERVICE_KILLS ?= 20
broker-kills: .venv/tools service-tools
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m tests.service.broker_campaign \
	--kills $(BROKER_KILLS) --service-kills $(SERVICE_KILLS)

# The service when something else fails: messages, disks, browsers, the process itself. Wants a broker, and root for disks.
service-faults: .venv/tools service-tools
	mkdir -p results/images
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m studies.service.faults --out results/service_faults.md

KERNEL = $(wildcard csrc/*.[ch] csrc/many/*.[ch] csrc/wire/*.[ch])

check: .venv/tools
	.venv/bin/ruff format --check .
	.venv/bin/clang-format --dry-run --Werror $(KERNEL)
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/python -m pytest -q $(STRUCTURE)

format: .venv/tools
	.venv/bin/ruff format .
	.venv/bin/clang-format -i $(KERNEL)
	.venv/bin/ruff check --fix .

# Peers that nothing else needs: sippy_unipi brings CasADi with it.
.venv/peers: requirements-bench.txt | .venv/tools
	$(PIP) install -r requirements-bench.txt
	touch $@

bench: .venv/peers
	mkdir -p .benchmarks
	.venv/bin/python -m pytest benchmarks --benchmark-only --benchmark-sort=name --benchmark-json=.benchmarks/latest.json
	.venv/bin/python -m benchmarks.instructions .benchmarks/instructions.json
	.venv/bin/python -m benchmarks.reading .benchmarks/reading.json
	mkdir -p results
	.venv/bin/python -m benchmarks.table .benchmarks/latest.json .benchmarks/instructions.json .benchmarks/reading.json \
		results/benchmarks.md

# The time of a sample in this version over that in the commit REF, in turn on this machine.
REF ?= HEAD~1
bench-compare: .venv/installed
	mkdir -p .benchmarks
	.venv/bin/python -m benchmarks.compare $(REF)

firmware: .venv/tools
	mkdir -p results/images
	.venv/bin/python -m tests.firmware.study --out results/footprint.md

# Every page of results, into results/: hours.
study: .venv/tools .venv/spark
	mkdir -p results/images
	.venv/bin/pmfid explain --page > docs/axis_toml.md
	.venv/bin/pmfid explain --plant --page > docs/plant_toml.md
	.venv/bin/python -m studies.accuracy --out results/accuracy.md
	.venv/bin/python -m studies.dead_time --out results/dead_time.md
	.venv/bin/python -m studies.no_settings --out results/no_settings.md
	.venv/bin/python -m studies.verdict --out results/verdict.md
	.venv/bin/python -m studies.known_mass --out results/known_mass.md
	.venv/bin/python -m studies.design --out results/design.md
	.venv/bin/python -m studies.design_machines --out results/commissioning.md
	.venv/bin/python -m studies.monitoring --out results/monitoring.md
	.venv/bin/python -m studies.monitoring_wrong_models --out results/monitoring_wrong_models.md
	.venv/bin/python -m studies.alarms --out results/alarms.md
	.venv/bin/python -m studies.laboratory --out results/laboratory.md --images results/images
	.venv/bin/python -m studies.black_box --out results/black_box.md
	.venv/bin/python -m studies.gaps --out results/gaps.md
	.venv/bin/python -m studies.glitches --out results/glitches.md
	.venv/bin/python -m studies.glitches_watched --out results/glitches_watched.md
	.venv/bin/python -m studies.scale --out results/scale.md
	.venv/bin/python -m studies.prediction --out results/prediction.md
	.venv/bin/python -m studies.terms --out results/terms.md
	.venv/bin/python -m studies.logs --out results/logs.md
	.venv/bin/python -m studies.checks --out results/checks.md
	.venv/bin/python -m studies.fleet_history --out results/fleet_history.md
	@$(MAKE) --no-print-directory spark-tools INSTALL_TOOLS=1
	.venv/bin/python -m studies.fleet_stream --out results/fleet_stream.md --seconds 120
	.venv/bin/python -m studies.million --out results/million.md
	.venv/bin/python -m tests.hostile.study --out results/hostile.md

# Attacks at length, an hour at most: crafted states under the sanitizers, openings, names in exports, calls, pipes.
hostile: .venv/tools
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m tests.hostile.campaign $(PARTS)

# What every method computes on fixed records; the diff shows a change of numbers.
golden: .venv/installed
	.venv/bin/python -m tests.golden.make

images: .venv/installed
	.venv/bin/python -m examples.demo --out demo-report --images docs/images

clean:
	rm -rf .venv build demo-report reproduced results
