# make demo and make test are the two commands; both install what they need into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
OUT ?= out
DEMO := $(OUT)/demo

# A process a core: the linear algebra's own threads would wait for one another.
ONE_THREAD := OPENBLAS_NUM_THREADS=1

CHALLENGE ?= $(OUT)/challenge
RECORD ?= $(OUT)/record
RECORD_KEPT ?= $(RECORD)/kept
RECORD_PAGE ?= $(RECORD)/page
RECORD_PARTS ?= nulls-m mixed-m nulls-n mixed-n nulls-o mixed-o nulls-p mixed-p nulls-q nulls-r nulls-s nulls-t nulls-u
MIXED_CASES ?= 60
NULLS_CASES ?= 116
SEED ?=

.PHONY: help setup demo demo-sweep test long live quick quick-tests lint kernels bench chain sbc sbc-strata nulls follow-ups allowances evidence kills faults conformance fuzz soak docs-commands challenge record demonstration figures site pages house lock \
  clean

help:
	@echo "make demo    install, sweep a virtual bench that conceals physics, name it, reveal it: $(OUT)/demo/index.html"
	@echo "make test    install, then lint, type-check and test"
	@echo "make long    the tests that take longer: whole fits, diagnoses and campaigns, 15 to 40 minutes"
	@echo "make live    long tests of a bench that runs, from its bytes on; on a machine that does nothing else"
	@echo "make quick   lint and the quick tests, within a minute: for the inner loop"
	@echo "make setup   make $(VENV) with the command $(BIN)/spinbench"
	@echo "make bench   speed, as ratios against stated peers (minutes)"
	@echo "make kills   kill -9 at 200 random moments of every command that writes: nothing lost (an hour, resumable)"
	@echo "make faults  every fault of the menu on every kind of line: wrong values counted (minutes, resumable)"
	@echo "make conformance   other people's Modbus clients against our virtual devices, libmodbus behind our drivers (a minute)"
	@echo "make fuzz    codecs and readers by atheris, guided by coverage; wants the package atheris (15 minutes, resumable)"
	@echo "make soak    all kinds of lines at their full rate at once: rates, memory, wrong values (half an hour)"
	@echo "make docs-commands   every command of README and docs as it stands there, on fresh copies (a campaign)"
	@echo "make chain   from bytes to a verdict on benches of many kinds, and on benches that conceal something (hours)"
	@echo "make sbc     simulation-based calibration of the whole fit (a campaign, resumable)"
	@echo "make sbc-strata   the same of Laplace's intervals in strata, and against emcee (a campaign, resumable)"
	@echo "make nulls   how often a mismatch is seen where there is none: 1200 nulls of each noise class (hours, resumable)"
	@echo "make allowances   what each allowance of the diagnosis costs, on 24 recordings (minutes, resumable)"
	@echo "make follow-ups   what recommended tests promise against what they give, on 100 cases (hours, resumable)"
	@echo "make evidence   the evidence that sets are weighed by, against nested sampling in 50 sweeps (long, resumable)"
	@echo "make challenge   a blind campaign of 200 cases, in $(CHALLENGE) (long, resumable)"
	@echo "make record  the full blind record, in parts, and its page (hours, resumable)"
	@echo "make demonstration FILES=FOLDER   the demonstrations on public data of other rigs, whose files are in the folder"
	@echo "make figures the article's figures and results anew, in docs/figures and docs/reproduction.md"
	@echo "make site    the documentation as a site with a search, to be read without a network: $(OUT)/site/index.html"
	@echo "make pages   the pages that are made from code anew: docs/python-reference.md, docs/notebooks, configs/schemas"
	@echo "make lint    formatting, lint, import layers and types"
	@echo "make house   measure the code base: its size, what has grown too large, what imports in circles (LIST=1: which)"
	@echo "make lock    pin what requirements.lock lacks; make lock UPGRADE=--upgrade pins everything anew"
	@echo "make clean   remove $(VENV) and $(OUT)"

setup: $(STAMP)

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "spinbench needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) -V 2>&1). Try: make PYTHON=python3.12"; exit 2; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $(STAMP)

# What the bench conceals is drawn by the seed: a drag. Nothing but the bench and `reveal` has the key. The solvers are
# compiled while the sweep runs.
demo: $(STAMP)
	rm -rf $(DEMO)
	mkdir -p $(DEMO)
	@$(MAKE) --no-print-directory -j2 demo-sweep kernels
	$(BIN)/spinbench runs verify last --logs $(DEMO)/logs
	$(BIN)/spinbench replay last --logs $(DEMO)/logs --with-model -o $(DEMO)/replay
	$(BIN)/spinbench runs export last --logs $(DEMO)/logs -o $(DEMO)/recording
	$(BIN)/spinbench diagnose $(DEMO)/recording -o $(DEMO)/diagnosis
	$(BIN)/spinbench reveal $(DEMO)/seal --key $(DEMO)/key --diagnosis $(DEMO)/diagnosis/diagnosis.json --json $(DEMO)/revealed.json
	$(BIN)/spinbench fit logs/published_sweep -o $(DEMO)/published_fit --seed 1
	@$(BIN)/python scripts/demo_page.py $(DEMO)

demo-sweep: $(STAMP)
	$(BIN)/spinbench sweep virtual --rate 10 --conceal $(DEMO)/seal --key $(DEMO)/key --conceal-seed 5 --only windage \
	  --logs $(DEMO)/logs --minutes-running 0 --operator demo

kernels: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m tests.kernels

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

# Three processes on two cores: some tests wait for a device.
test: $(STAMP)
	@$(MAKE) --no-print-directory -j2 lint kernels
	$(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder -m "not long"

# What whole fits, diagnoses and campaigns take minutes for.
long: $(STAMP) kernels
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "long and not live"

# One after the other: each has a bench, a sweep and a watchdog of its own, which a busy machine disturbs.
live: $(STAMP) kernels
	$(BIN)/python -m pytest -m live

# Of tests, what files of seconds hold.
quick: $(STAMP)
	@$(MAKE) --no-print-directory -j2 lint quick-tests

quick-tests: $(STAMP)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow and not long"

bench: $(STAMP)
	$(ONE_THREAD) $(BIN)/python tests/bench/run.py --json $(OUT)/bench.json

# Goes on where it was interrupted; SHARE=0.1 takes a tenth of the kills.
kills: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m tests.kills -o $(OUT)/kills $(if $(SHARE),--share $(SHARE))

# Goes on where it was interrupted; POLLS=10000 takes so many a cell.
faults: $(STAMP)
	$(BIN)/python -m tests.faults -o $(OUT)/faults $(if $(POLLS),--polls $(POLLS))

# Of other people's programs, those that are on the machine.
conformance: $(STAMP)
	$(BIN)/python -m tests.conformance

# Goes on where it was interrupted, and counts on; MINUTES=60 takes so long, of all targets together.
fuzz: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m tests.fuzz -o $(OUT)/fuzz $(if $(MINUTES),--minutes $(MINUTES))

# MINUTES=3 takes so long.
soak: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m tests.soak -o $(OUT)/soak $(if $(MINUTES),--minutes $(MINUTES))

# PAGES="README.md docs/replay.md" takes these pages; HOURS=1 also runs what takes hours.
docs-commands: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m tests.documented_commands -o $(OUT)/docs-commands $(if $(HOURS),--hours) $(PAGES)

# Goes on where it was interrupted; PAGE=docs/chain also writes the tables there.
chain: $(STAMP)
	$(BIN)/python -m tests.chain benches -o $(OUT)/chain $(if $(PAGE),--page $(PAGE))
	$(BIN)/python -m tests.chain concealed -o $(OUT)/chain $(if $(PAGE),--page $(PAGE))

sbc: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m calibration.studies.sbc -o $(OUT)/sbc --page docs/figures

sbc-strata: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m calibration.studies.strata -o $(OUT)/sbc_strata --page docs/figures

# PAGE=docs/follow_ups also writes the page there, ALSO=docs/follow_ups/cases.json counts the cases that are kept there.
follow-ups: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m calibration.studies.follow_ups -o $(OUT)/follow_ups $(if $(PAGE),--page $(PAGE)) $(if $(ALSO),--also $(ALSO))

# PAGE=docs/allowances also writes the page there.
allowances: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m calibration.studies.allowances -o $(OUT)/allowances $(if $(PAGE),--page $(PAGE))

# PAGE=docs/nulls also writes the page there.
nulls: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m calibration.studies.nulls -o $(OUT)/nulls $(if $(PAGE),--page $(PAGE))

# PAGE=docs/evidence also writes the page there; EVERY=3 has nested sampling in one case of three.
evidence: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m calibration.studies.evidence -o $(OUT)/evidence $(if $(EVERY),--nested-every $(EVERY)) $(if $(PAGE),--page $(PAGE))

# Goes on where it was interrupted; another folder is another campaign, with a seed of its own unless SEED=N is given.
challenge: $(STAMP)
	$(BIN)/spinbench challenge make $(CHALLENGE) --cases 200 --family development $(if $(SEED),--seed $(SEED))
	$(BIN)/spinbench challenge run $(CHALLENGE)
	$(BIN)/spinbench challenge score $(CHALLENGE) --page $(CHALLENGE)/page

# In parts, each a campaign of its own, made, run and scored before the next; what is kept of one is small, and may be
# moved to another machine, the ledger with it. The make-up holds in whole blocks of twenty cases.
# RECORD_KEPT=docs/challenge/record RECORD_PAGE=docs/challenge is the record of this repository. With SEED=N the parts
# have the seeds N + 1, N + 2, ...
record: $(STAMP)
	@set -e; part=0; for name in $(RECORD_PARTS); do \
	  part=$$((part + 1)); folder=$(RECORD)/record-$$name; \
	  if test -e $(RECORD_KEPT)/record-$$name.json.gz; then echo "$$name is there"; continue; fi; \
	  if ls $(RECORD_KEPT)/*.json.gz > /dev/null 2>&1; then \
	    $(BIN)/spinbench challenge pool $(RECORD_KEPT)/*.json.gz --same-code > /dev/null; fi; \
	  case $$name in nulls*) many="--cases $(NULLS_CASES) --only none";; *) many="--cases $(MIXED_CASES)";; esac; \
	  seed="$(if $(SEED),--seed $$(($(SEED) + part)))"; \
	  $(BIN)/spinbench challenge make $$folder $$many $$seed; \
	  $(BIN)/spinbench challenge run $$folder; \
	  $(BIN)/spinbench challenge score $$folder --follow-ups --oracle --keep $(RECORD_KEPT); \
	  $(BIN)/spinbench challenge pool $(RECORD_KEPT)/*.json.gz --page $(RECORD_PAGE); \
	done

# NAME is emps, dexpand, cylinder, baseball, whiffle_ball, or all of which there are files in the folder FILES.
NAME ?= all
demonstration: $(STAMP)
	@test -n "$(FILES)" || { echo "name the folder with the files: make demonstration FILES=FOLDER"; exit 2; }
	$(BIN)/python scripts/demonstrate.py $(NAME) $(FILES) --out $(OUT)/demonstrations

figures: $(STAMP)
	$(BIN)/spinbench reproduce -o docs/figures --page docs/reproduction.md

# A link or an anchor that leads nowhere is an error.
site: $(STAMP)
	rm -rf $(OUT)/site
	$(BIN)/python -m sphinx -q -E -W --keep-going -c docs -d $(OUT)/doctrees . $(OUT)/site
	@echo "$(OUT)/site/index.html"

pages: $(STAMP)
	$(BIN)/python scripts/python_reference.py
	$(BIN)/python scripts/notebooks.py
	$(BIN)/python scripts/schemas.py

# Needs no environment; where there is one, the import contracts are counted too.
house:
	@$(PYTHON) scripts/house.py $(if $(LIST),--list)

lock: $(STAMP)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet $(UPGRADE) --universal --python-version 3.11 --extra dev --no-header --no-annotate \
	  --no-emit-index-url --no-emit-find-links pyproject.toml -o requirements.lock

clean:
	rm -rf $(VENV) $(OUT)
