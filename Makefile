# make help lists the targets. PYTHON picks the interpreter for the virtual environment (3.11 or newer);
# TORCH_INDEX=https://download.pytorch.org/whl/cpu keeps pip from fetching torch's CUDA build.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.setup-stamp
THREE := orchestrator/web/vendor/version.json
SEED ?= 1
OUT ?= out
JOBS ?= 2
FAULTS ?= 200
ARGS ?=

# One thread a process: services and test workers share the cores by processes, not by thread pools.
export OMP_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help setup demo serve test test-page chaos compose-check overload check docs format bench eval-tasks eval-results eval-text eval-tracker eval-planner clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-14s %s\n", $$1, $$2}'

setup: $(STAMP) $(THREE) ## make .venv with everything (quick when nothing changed)

$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "no Python found: install Python 3.11 or newer"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "$(PYTHON) is older than 3.11: set PYTHON"; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing torch (a few minutes) ..."
	@$(BIN)/python -m pip install -qq $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) -c constraints.txt torch
	@echo "installing motionloop with all its extras (a few minutes) ..."
	@$(BIN)/python -m pip install -qq -c constraints.txt -e '.[all,dev]'
	@$(BIN)/python -c 'import torch; print("torch", torch.__version__, "(CUDA %s)" % torch.version.cuda if torch.version.cuda else "(CPU build)")'
	@touch $@

# three.js for the live page comes from npm; without npm everything else still works, and the page says what is missing.
$(THREE): orchestrator/web/fetch_three.py $(STAMP)
	@$(BIN)/python -m orchestrator.web.fetch_three || true

demo: setup ## run the three services and one episode over HTTP; leaves out/demo/
	$(BIN)/motionloop demo --seed $(SEED) --out $(OUT)/demo $(ARGS)

serve: setup ## run all three services until Ctrl-C
	$(BIN)/motionloop serve all $(ARGS)

test: setup ## run the fast test suite
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile -m "not slow and not page" $(ARGS)

test-page: setup ## drive the live page in headless Chromium against the three services
	$(BIN)/python -m orchestrator.web.fetch_three
	$(BIN)/python -m tests.page.browser
	$(BIN)/python -m pytest tests/page -m page $(ARGS)

chaos: setup ## 200 faults over running episodes (about half an hour); FAULTS sets how many; leaves out/chaos.json and out/kills.json
	$(BIN)/python -m tests.chaos.run --faults $(FAULTS) --seed $(SEED) --json $(OUT)/chaos.json $(ARGS)
	$(BIN)/python -m tests.chaos.kills --seed $(SEED) --json $(OUT)/kills.json

# ENGINE=podman where podman-compose stands in for docker compose.
ENGINE ?= docker

compose-check: setup ## the built containers from nothing: health, demo, kill -9 of each, the end; leaves out/compose.json
	$(BIN)/python -m benchmarks.compose_check --engine $(ENGINE) --json $(OUT)/compose.json $(ARGS)

overload: setup ## half an hour of more commands than can be taken; leaves out/overload.json
	$(BIN)/python -m benchmarks.overload --json $(OUT)/overload.json $(ARGS)

check: setup ## ruff, mypy --strict, import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: setup ## build the documentation site into out/site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

format: setup ## format the tree and fix what ruff can
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: setup ## measure the loop in real time
	@mkdir -p $(OUT)
	$(BIN)/motionloop bench loop --characters 1 --seconds 60 --seed $(SEED) --json $(OUT)/bench_loop.json $(ARGS)

eval-tasks: setup ## success rate of the task `reach`
	@mkdir -p $(OUT)
	$(BIN)/motionloop eval tasks --tasks reach --episodes 100 --seed $(SEED) --json $(OUT)/eval_tasks.json $(ARGS)

# Variants of docs/results.md as NAME:OPTIONS, commas for spaces; N episodes a task, 50 sequences.
N ?= 200
RESULTS := second:--seed,2 open_loop:--variant,open_loop paper:--variant,paper short:--variant,short \
	long:--variant,long varied:--varied sequences:--sequences,50
comma := ,

eval-results: setup ## the tables of docs/results.md (hours; goes on where it was killed)
	@mkdir -p $(OUT)/results
	$(BIN)/motionloop eval tasks --tasks reach,strike,sit,get_up --episodes $(N) --seed $(SEED) --jobs $(JOBS) --resume $(OUT)/results/rows.jsonl --json $(OUT)/results/closed_loop.json --report $(OUT)/results/closed_loop.md --videos $(OUT)/results/videos $(ARGS)
	@for each in $(RESULTS); do \
	  name=$${each%%:*}; options=$$(echo "$${each#*:}" | tr '$(comma)' ' '); \
	  $(BIN)/motionloop eval tasks --tasks reach,strike,sit,get_up --episodes $(N) --seed $(SEED) --jobs $(JOBS) $$options --resume $(OUT)/results/rows.jsonl --json $(OUT)/results/$$name.json --report $(OUT)/results/$$name.md --against $(OUT)/results/closed_loop.json $(ARGS) || exit 1; \
	done
	$(BIN)/python benchmarks/results_table.py $(OUT)/results/*.json

eval-text: setup ## how many text commands are obeyed
	@mkdir -p $(OUT)
	$(BIN)/motionloop eval text --minutes 10 --seed $(SEED) --json $(OUT)/eval_text.json $(ARGS)

eval-tracker: setup ## how well recorded clips are tracked; CLIPS names the folder
	@test -n "$(CLIPS)" || { echo "set CLIPS to a folder of clips (BVH, AMC + ASF, SMPL npz)"; exit 2; }
	@mkdir -p $(OUT)
	$(BIN)/motionloop eval tracker --clips $(CLIPS) --seed $(SEED) --json $(OUT)/eval_tracker.json $(ARGS)

eval-planner: setup ## quality of the plans without physics; CORPUS names the folder of a corpus
	@test -n "$(CORPUS)" || { echo "set CORPUS to a corpus made by: motionloop data build"; exit 2; }
	@mkdir -p $(OUT)
	$(BIN)/motionloop eval planner --corpus $(CORPUS) --seed $(SEED) --json $(OUT)/eval_planner.json $(ARGS)

clean: ## remove caches and outputs, keep .venv
	rm -rf $(OUT) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -not -path './$(VENV)/*' -prune -exec rm -rf {} +
