# Build the replication: `make` lists what it can do, `make all` does it.
#
# A stage is a notebook with parameters. Its stamp is its executed copy, build/PROFILE/NAME.ipynb, which tras/workflow/runner.py moves into
# place as the last act of a successful run. Whether a stage is out of date is decided by content, not by time: tras/workflow/staleness.py
# rewrites build/PROFILE/NAME.key only when code, parameters, environment or outputs changed.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules --no-print-directory

ifeq ($(filter grouped-target,$(.FEATURES)),)
$(error this Makefile needs GNU make 4.3 or newer, this is $(MAKE_VERSION))
endif
ifneq ($(words $(CURDIR)),1)
$(error the folder "$(CURDIR)" has a blank in its path, which make cannot handle: move the checkout)
endif

# What `make identify` and `make control` take. Only what stands on the command line: TEST, FROM and TIME may be in anybody's environment. It is text, such
# as the name of a file: `override` keeps make from reading $(...) in it, here, before anything else could; the shell has it by `export`.
IDENTIFY := OUT ROLES STATES INPUTS TIME TRIAL TEST FROM TO DECIMATE DT RESAMPLE PREDICTOR DELAYS SMOOTHING LEAD EVERY ACTUATORS HORIZON DRAWS
CONTROL := OUT SETTINGS
TYPED := $(foreach name,RECORDING MODEL $(IDENTIFY) $(filter-out $(IDENTIFY),$(CONTROL)),$(if $(and $(filter command,$(origin $(name))),$(value $(name))),$(name)))
$(foreach name,$(TYPED),$(eval override $(name) := $$(value $(name)))$(eval export $(name)))

# The same bits on every run: sums depend on the number of BLAS threads, and on what BLAS and NumPy choose for the processor.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
export PYTHONHASHSEED := 0
# What else is in the environment stays out: another tras on PYTHONPATH, another kernel, the user's settings of notebooks and figures. With
# PYTHONDONTWRITEBYTECODE each stage would take 1.5 s longer (uv leaves compiling to the first import); kernels choose their own backend.
# What is said to make itself stays: make OPENBLAS_CORETYPE=Haswell verify.
OUTSIDE := PYTHON% JUPYTER% IPYTHON% MPLBACKEND MATPLOTLIB% OPENBLAS_% GOTO_% OMP_% MKL_% KMP_% NPY_% GLIBC_TUNABLES BASH_ENV
unexport $(foreach name,$(filter $(OUTSIDE),$(.VARIABLES)),$(if $(filter environment,$(origin $(name))),$(name)))
export MATPLOTLIBRC := /dev/null
export JUPYTER_PREFER_ENV_PATH := 1

# --- profiles: paper, smoke (the same code, small), or your own params/NAME.yaml ------------------------------------------------

PROFILE ?= paper
PARAMS := params/$(PROFILE).yaml
BUILD := build/$(PROFILE)
ifeq ($(PROFILE),paper)
DATA := data
FIGURES := figures
DOCS := build/docs
else
DATA := $(BUILD)/data
FIGURES := $(BUILD)/figures
DOCS := $(BUILD)/docs
endif

# --- stages and what they write; every file is named, so that a deleted one is made again ----------------------------------------

MODELS := $(foreach input,reference torque,$(addprefix $(input)_,linear gaussian gaussian28 monomials2)) \
  $(addprefix torque_,$(addprefix gaussian_seed,1 2 3) mechanical)
DRAWN := fig1_rig fig2_method fig3_overlay excitation spectrum horizon
ROBUSTNESS := robustness_noise robustness_sampling robustness_length residuals projection_error parameters benchmark_systems
ROBUSTNESS_DRAWN := robustness_noise robustness_length eigenfunctions parameters

# The paper's own part is what `make paper` builds; the studies beyond it belong to `make all`. A study needs one name in STUDIES, one
# list of outputs in STUDY_OUTPUTS and one line `$(eval $(call stage,...))` at the end.
PAPER_STAGES := 01_data_generation 02_identification 03_validation 04_figures
STUDIES := 05_robustness 06_readings 07_comparison 08_claims 09_pictures 10_larger_models 11_control
STAGES := $(PAPER_STAGES) $(STUDIES)
OUT_01 := $(addprefix $(DATA)/,train.nc validation_multisine.nc validation_steps.nc validation_chirp.nc)
OUT_02 := $(addprefix $(DATA)/,held_out.nc identification.csv spectrum.csv $(MODELS:%=models/%.npz))
OUT_03 := $(addprefix $(DATA)/,metrics.csv horizon.csv overlay.csv)
OUT_04 := $(addprefix $(FIGURES)/,$(foreach kind,pdf svg png csv,$(DRAWN:%=%.$(kind))) table.csv)
OUT_05 := $(ROBUSTNESS:%=$(DATA)/%.csv) $(addprefix $(FIGURES)/,$(foreach kind,pdf svg png csv,$(ROBUSTNESS_DRAWN:%=%.$(kind))))
OUT_06 := $(addprefix $(DATA)/,readings.csv readings_around.csv readings_start.csv) $(foreach kind,pdf svg png csv,$(FIGURES)/readings_effects.$(kind) $(FIGURES)/readings_nearest.$(kind))
OUT_07 := $(addprefix $(DATA)/,comparison.csv comparison_tuning.csv comparison_data.csv) \
  $(foreach kind,pdf svg png csv,$(addprefix $(FIGURES)/,comparison_window.$(kind) comparison_horizon.$(kind) comparison_data.$(kind)))
OUT_08 := $(DATA)/claims.csv
OUT_09 := $(addprefix $(FIGURES)/,animation.gif animation.csv $(foreach kind,pdf svg png csv,portrait.$(kind)))
OUT_10 := $(addprefix $(DATA)/,larger.csv larger_gusts.csv) \
  $(foreach kind,pdf svg png csv,$(addprefix $(FIGURES)/,larger_accuracy.$(kind) larger_effects.$(kind) larger_gusts.$(kind)))
OUT_11 := $(DATA)/control.csv $(DATA)/control_motors.csv $(addprefix $(FIGURES)/,control_film.gif control_film.csv $(foreach kind,pdf svg png csv,control_tracking.$(kind) control_disturbance.$(kind)))

PAPER_OUTPUTS := $(OUT_01) $(OUT_02) $(OUT_03) $(OUT_04)
STUDY_OUTPUTS := $(OUT_05) $(OUT_06) $(OUT_07) $(OUT_08) $(OUT_09) $(OUT_10) $(OUT_11)

STAMPS := $(STAGES:%=$(BUILD)/%.ipynb)
KEYS := $(STAGES:%=$(BUILD)/%.key)
OUTPUTS := $(PAPER_OUTPUTS) $(STUDY_OUTPUTS)
# The stamp alone says that a stage is done. After a failure make would delete its outputs, the committed figures among them.
.PRECIOUS: $(OUTPUTS)

# --- the environment: its stamp carries the hash of the lock file ----------------------------------------------------------------

PYTHON ?= python3
LOCKS := environment.txt environment-build.txt
LOCKED := $(shell cat $(LOCKS) 2>/dev/null | { sha256sum || shasum -a 256; } 2>/dev/null | cut -c1-12)
READY := .venv/.ready-$(LOCKED)
PY := .venv/bin/python
# A file of tests is one process's: what its tests share is made once, and cells follow each other.
PYTEST := $(PY) -m pytest -n auto --maxprocesses 4 --dist loadfile

.PHONY: help setup all stages paper figures docs sweep smoke lint check test verify bless lab lock readme clean distclean bench bench-test identify control \
  example FORCE

# A comment `## GROUP | TIME | TEXT` behind a target puts it into the list; times are those of two cores, with the environment there.
help: # this text
	@for group in replicate explore "your rig" maintain; do \
	  echo "$$group:"; \
	  awk -v group="$$group" -F ':.*## | \\| ' \
	    '/^[a-z-]+:.*## / && $$2 == group { printf "  make %-10s %7s  %s\n", $$1, $$3, $$4 }' Makefile; \
	done
	@echo "Another parameter set: make all PROFILE=NAME reads params/NAME.yaml and writes below build/NAME/."

setup: $(READY) ## maintain | 1 min | create .venv from environment.txt (the other targets do it by themselves)

all: stages ## replicate | 20 min | everything: data, models, figures, further studies; prints the table
	@$(PY) -m tras.paper.pages table --figures $(FIGURES) $(if $(filter paper,$(PROFILE)),--check)

stages: $(STAMPS) $(OUTPUTS)

paper: $(PAPER_STAGES:%=$(BUILD)/%.ipynb) $(PAPER_OUTPUTS) ## replicate | 45 s | the paper's own figures and numbers

figures: $(BUILD)/04_figures.ipynb $(OUT_04) ## replicate | 45 s | their figures alone, and what they need

docs: stages ## explore | + 20 s | the documentation site, readable without network: build/docs/index.html
	@$(PY) docs/make_site.py $(DOCS) --data $(DATA) --figures $(FIGURES) --build $(BUILD)

SWEEP ?= params/sweeps/dictionaries.yaml
sweep: $(READY) ## explore |  | many fits: SWEEP=params/sweeps/dictionaries.yaml, on this machine or SCHEDULER=tcp://host:8786
	@$(PY) -m tras.sweeps.command $(SWEEP) $(if $(SCHEDULER),--scheduler $(SCHEDULER))

# RECORDING=log.csv, "a.csv b.csv" or "run*.csv", and where names are not plain ROLES=roles.yaml or STATES=a,b INPUTS=c TIME=t TRIAL=run; also
# TEST= FROM= TO= DECIMATE= DT= RESAMPLE= PREDICTOR= DELAYS= SMOOTHING= LEAD= EVERY= ACTUATORS= HORIZON= DRAWS= OUT= (docs/own_rig.md).
lower = $(shell printf %s "$(1)" | tr A-Z a-z)

identify: $(READY) ## your rig | 15 s | a model of your own system: make identify RECORDING=log.csv (docs/own_rig.md)
	@$(if $(filter RECORDING,$(TYPED)),,echo "say which recording: make identify RECORDING=log.csv (make example writes one to try)" >&2; exit 2)
	@$(PY) -m tras.identification.command $(foreach name,$(filter $(IDENTIFY),$(TYPED)),--$(call lower,$(name))="$$$(name)") -- "$$RECORDING"

control: $(READY) ## your rig | 15 s | a controller from that model: make control MODEL=build/identify/log/model.npz (docs/control.md)
	@$(if $(filter MODEL,$(TYPED)),,echo "say which model: make control MODEL=build/identify/log/model.npz (make identify writes one)" >&2; exit 2)
	@$(PY) -m tras.control.command $(foreach name,$(filter $(CONTROL),$(TYPED)),--$(call lower,$(name))="$$$(name)") -- "$$MODEL"

example: $(READY) ## your rig |  | recordings of two simulated systems to try it on, in build/example/
	@$(PY) -m tras.identification.examples duffing build/example/duffing.csv
	@$(PY) -m tras.identification.examples cart_pole build/example/cart_pole.csv

smoke: $(READY) ## maintain |  | the same stages, small, below build/smoke/
	@$(MAKE) PROFILE=smoke stages

lint: $(READY) ## maintain | 1 s | ruff, as configured in pyproject.toml
	@$(PY) -m ruff check
	@$(PY) -m ruff format --check

check: lint ## maintain | 2 min | for a developer: lint, layers, and every test that is not slow
	@MPLBACKEND=Agg $(PYTEST) -q -x -m "not slow"

test: $(READY) ## maintain | 12 min | unit tests, then every notebook of the small profile rerun and compared
	@failed=; \
	MPLBACKEND=Agg $(PYTEST) || failed="unit tests"; \
	$(MAKE) PROFILE=smoke stages \
	  && $(MAKE) example && $(MAKE) identify RECORDING=build/example/duffing.csv OUT=build/smoke/identify \
	  && IPYTHONDIR=$(CURDIR)/build/ipython $(PYTEST) --nbval -p no:cacheprovider $(STAGES:%=build/smoke/%.ipynb) build/smoke/identify/identify.ipynb \
	  || failed="$${failed:+$$failed, }notebooks of the small profile"; \
	test -z "$$failed" || { echo "make test: FAILED ($$failed): see the first failure of each above." >&2; exit 1; }; \
	echo "make test: the unit tests passed, and every notebook of the small profile gives what it gave."

# notebooks/.jupyter turns off JupyterLab's question about news, which would come before everything else.
lab: $(READY) ## explore |  | open the explorer in JupyterLab, the other notebooks beside it
	JUPYTER_CONFIG_PATH=notebooks/.jupyter $(PY) -m jupyterlab --ServerApp.root_dir=. $(if $(filter 0,$(shell id -u)),--allow-root) notebooks/explore.ipynb

lock: ## maintain |  | resolve environment.in, and what builds its sources, anew (needs uv; UPGRADE=1 for newer versions)
	@command -v uv >/dev/null || { echo "make lock needs uv, which was not found on PATH: python3 -m pip install uv." >&2; exit 1; }
	$(compile) environment.in --output-file environment.txt
	printf 'setuptools\nwheel\n' | $(compile) --no-annotate --constraint environment.txt - --output-file environment-build.txt

ifeq ($(PROFILE),paper)
verify: reference/SHA256SUMS $(STAMPS) $(OUTPUTS) ## replicate |  | compare data, models and figures with reference/: bytes, numbers, looks
	@$(PY) -m tras.paper.verification --paper $(PAPER_OUTPUTS) --studies $(STUDY_OUTPUTS)

reference/SHA256SUMS: # said before anything is built
	@echo "$@ does not exist, so there is nothing to compare with: git checkout reference, or make bless to take this machine's results." >&2; exit 2

bless: $(STAMPS) $(OUTPUTS) ## maintain |  | take them as the new reference/ (nothing else writes there)
	@$(PY) -m tras.paper.verification --bless --paper $(PAPER_OUTPUTS) --studies $(STUDY_OUTPUTS)
else
verify bless:
	@echo "make $@ is for PROFILE=paper, whose numbers reference/ holds; for PROFILE=$(PROFILE) there is no reference." >&2; exit 2
endif

readme: $(READY) ## maintain |  | write the tables of README.md and docs/paper.md
	@$(MAKE) PROFILE=paper stages
	@$(PY) -m tras.paper.pages --write

bench-test: $(READY) ## maintain |  | tests of the harness of make bench
	@$(PY) -m pytest benchmarks/tests

bench: $(READY) ## maintain |  | beside other packages: time, memory, accuracy; BENCH="--help" lists parts of it
	@$(PY) -m benchmarks.bench $(BENCH)

clean: ## maintain |  | remove build/ and what is generated and not in git (of the figures PNG and CSV are in git and stay)
	rm -rf build
	rm -f $(filter data/% figures/%.pdf figures/%.svg,$(OUTPUTS))
	rm -rf data/cache
	rm -rf $(addsuffix provenance,$(sort $(dir $(OUTPUTS))))
	@rmdir data/models 2>/dev/null || true

distclean: clean ## maintain |  | clean, and .venv too
	rm -rf .venv

# --- how ---------------------------------------------------------------------------------------------------------------------------

# A venv without its interpreter (the system's Python was replaced: a link that leads nowhere, which `wildcard` takes for a file) is not
# ready whatever its stamp says. The stamp of the old venv goes first and that of the new one comes last: an interrupted setup never counts.
$(READY): $(if $(realpath $(PY)),,FORCE)
	@for lock in $(LOCKS); do test -s $$lock || { echo "$$lock is missing: restore it from git, or run make lock." >&2; exit 1; }; done
	@$(check_python)
	@echo "Creating .venv from environment.txt (once; half a minute to a few minutes)"
	@rm -f .venv/.ready-*; rm -rf .venv
	@# A package without a wheel is built by the locked setuptools, not by the newest one: hence two steps and no isolation.
	@if command -v uv >/dev/null; then \
	  uv venv --quiet --no-project --python "$(PYTHON)" .venv; \
	  uv pip install --quiet --python $(PY) --require-hashes -r environment-build.txt; \
	  uv pip install --quiet --python $(PY) --no-build-isolation --require-hashes -r environment.txt; \
	else \
	  $(PYTHON) -m venv .venv; \
	  for lock in environment-build.txt environment.txt; do \
	    $(PY) -m pip install --quiet --disable-pip-version-check --no-build-isolation --require-hashes -r $$lock; \
	  done; \
	fi
	@echo '../../../..' > "$$($(PY) -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/tras-checkout.pth"
	@touch $@

compile = uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url \
  --no-emit-find-links $(if $(UPGRADE),--upgrade)

define check_python
command -v "$(PYTHON)" >/dev/null || { \
  echo "$(PYTHON) was not found. On Debian 12: sudo apt-get install python3 python3-venv" >&2; exit 1; }; \
"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
  echo "$$("$(PYTHON)" --version) is too old, 3.11 or newer is needed. Name another one: make setup PYTHON=python3.12" >&2; exit 1; }; \
command -v uv >/dev/null || "$(PYTHON)" -c 'import venv, ensurepip' 2>/dev/null || { \
  echo "$(PYTHON) cannot create environments. On Debian 12: sudo apt-get install python3-venv" >&2; exit 1; }
endef

$(KEYS) &: FORCE | $(READY)
	@$(PY) -I -S tras/workflow/staleness.py --build $(BUILD) --params $(PARAMS) $(STAGES:%=notebooks/%.ipynb)

# $(call stage,NAME,OUTPUTS,STAGES BEFORE IT). The stamps before it stand for their outputs: a stage is out of date when one of
# its outputs is not what it wrote, so a missing recording reruns the stage that writes it.
define stage
$(2) $(BUILD)/$(1).ipynb &: $(BUILD)/$(1).key $(3:%=$(BUILD)/%.ipynb)
	@$(PY) -m tras.workflow.runner notebooks/$(1).ipynb $(BUILD)/$(1).ipynb --params $(PARAMS) \
	  --set data_dir=$(DATA) --set figures_dir=$(FIGURES) --outputs $(2)
endef

$(eval $(call stage,01_data_generation,$(OUT_01),))
$(eval $(call stage,02_identification,$(OUT_02),01_data_generation))
$(eval $(call stage,03_validation,$(OUT_03),01_data_generation 02_identification))
$(eval $(call stage,04_figures,$(OUT_04),01_data_generation 02_identification 03_validation))
$(eval $(call stage,05_robustness,$(OUT_05),01_data_generation))
$(eval $(call stage,06_readings,$(OUT_06),))
$(eval $(call stage,07_comparison,$(OUT_07),01_data_generation))
$(eval $(call stage,08_claims,$(OUT_08),02_identification 03_validation 05_robustness 06_readings 07_comparison 10_larger_models 11_control))
$(eval $(call stage,09_pictures,$(OUT_09),))
$(eval $(call stage,10_larger_models,$(OUT_10),))
$(eval $(call stage,11_control,$(OUT_11),01_data_generation 02_identification))
