# PhysNet: `make` lists what there is. Needs Python 3.11 or newer with venv and pip, nothing else.
#
# Two environments, so that the service is proven to run without torch:
#   .venv-base  the base install, what a robot gets; + matplotlib for pictures, + pytest
#   .venv       everything: training, linters
# Every path is relative and every tool is called as `python -m`, so the checkout may lie in a path with spaces.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

# The first of these that is Python 3.11 or newer and can make environments; `make PYTHON=… demo` overrides it.
PYTHON_USABLE := import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))
ifndef PYTHON
PYTHON := $(shell for python in python3 python3.13 python3.12 python3.11 python; do \
	"$$python" -c '$(PYTHON_USABLE)' >/dev/null 2>&1 && { echo "$$python"; break; }; done)
endif

# torch may bring CUDA along (gigabytes); TORCH_INDEX=URL names a package index with the CPU build.
TORCH_INDEX ?=
PIP_FLAGS := --disable-pip-version-check --no-input
PYTEST_FLAGS ?=
SERVE_FLAGS ?=
TRAIN_FLAGS ?= --help

BASE := .venv-base
FULL := .venv
BASE_PYTHON := $(BASE)/bin/python
FULL_PYTHON := $(FULL)/bin/python

say = @printf '\n\033[1m==> %s\033[0m\n' "$(1)"

##@ Use

demo: $(BASE)/.installed-demo ## Start the service, post real depth frames, print the answers, write build/demo/*.png
	$(call say,demo: one push on each sample frame)
	"$(BASE_PYTHON)" examples/demo.py --out build/demo
	@printf '\npush them yourself: make serve, then http://127.0.0.1:8000 in a browser\n'

serve: $(BASE)/.installed-demo ## Run the service on 127.0.0.1:8000; SERVE_FLAGS="--http-port 9000"
	"$(BASE_PYTHON)" -m service serve $(SERVE_FLAGS)

train: $(FULL)/.installed ## Run physnet-train; TRAIN_FLAGS="simulate --help"
	"$(FULL_PYTHON)" -m training $(TRAIN_FLAGS)

docs: $(FULL)/.installed ## Build the documentation into build/site, warnings are errors
	$(call say,docs: mkdocs)
	NO_MKDOCS_2_WARNING=1 "$(FULL_PYTHON)" -m mkdocs build --strict --quiet

figures: $(FULL)/.installed ## Draw the pictures of docs/pipeline again: after new models or changed stages
	"$(FULL_PYTHON)" docs/figures/pipeline.py

web: ## Build the playground from web/ into service/web (needs Node 20.19 or newer)
	$(call say,web: npm ci and build)
	cd web && npm ci --no-audit --no-fund && npm run build

##@ Check

test: lint types imports docs test-base test-training ## Everything: lint, types, import directions, both test suites
	$(call say,all checks passed)
	@tail -n 1 build/test-base.log build/test-training.log

lint: $(FULL)/.installed ## ruff: rules and formatting of the imports
	$(call say,lint: ruff)
	"$(FULL_PYTHON)" -m ruff check .

types: $(FULL)/.installed ## mypy --strict on service and training
	$(call say,types: mypy --strict)
	"$(FULL_PYTHON)" -m mypy

imports: $(FULL)/.installed ## import-linter: who may import whom
	$(call say,imports: import-linter)
	"$(FULL_PYTHON)" -c "from importlinter.cli import lint_imports_command; lint_imports_command(['--no-logo'])"

test-base: $(BASE)/.installed-test ## The service's tests, where torch is not installed
	$(call say,tests of the service: base install without torch)
	"$(BASE_PYTHON)" -c "import importlib.util as u, sys; sys.exit('torch is installed in $(BASE)' if u.find_spec('torch') else 0)"
	@mkdir -p build
	"$(BASE_PYTHON)" -m pytest --ignore=tests/training $(PYTEST_FLAGS) | tee build/test-base.log

test-training: $(FULL)/.installed ## The tests of training, in the full install
	$(call say,tests of training: full install)
	@mkdir -p build
	"$(FULL_PYTHON)" -m pytest tests/training $(PYTEST_FLAGS) | tee build/test-training.log

format: $(FULL)/.installed ## Sort imports and apply ruff's safe fixes
	"$(FULL_PYTHON)" -m ruff check --fix .

proto: .venv-proto/.installed ## Write service/api/generated from proto/, with a generator that old robots understand
	.venv-proto/bin/python proto/generate.py service/api/generated

proto-lint: ## buf lint on proto/ (needs node's npx)
	cd proto && npx --yes @bufbuild/buf@1.75.0 lint

##@ Set up

environments: $(BASE)/.installed-demo $(BASE)/.installed-test $(FULL)/.installed ## Both environments, without running anything

wheel: $(FULL)/.installed ## Build dist/physnet-*.whl with the models inside
	"$(FULL_PYTHON)" -m pip $(PIP_FLAGS) wheel --no-deps --wheel-dir dist .

clean: ## Remove environments, caches and build outputs
	rm -rf "$(BASE)" "$(FULL)" build dist .mypy_cache .ruff_cache .pytest_cache .import_linter_cache

help: ## This list
	@awk 'BEGIN { FS = ":.*## " } \
		/^##@/ { printf "\n%s\n", substr($$0, 5) } \
		/^[a-z-]+:.*## / { printf "  make %-14s %s\n", $$1, $$2 }' Makefile
	@echo

# --- environments: installed again only when pyproject.toml is newer than the stamp -------------------------------

$(BASE_PYTHON) $(FULL_PYTHON):
	@"$(PYTHON)" -c '$(PYTHON_USABLE)' >/dev/null 2>&1 || { \
		echo 'error: no Python 3.11 or newer with venv and pip was found (tried: $(or $(PYTHON),python3 python3.13 python3.12 python3.11 python)).'; \
		echo '       Debian, Ubuntu: apt install python3 python3-venv; then, if it has another name: make PYTHON=/path/to/python3.12'; \
		exit 1; }
	$(call say,$(@:/bin/python=): creating the environment with $(PYTHON))
	"$(PYTHON)" -m venv --clear "$(@:/bin/python=)"

$(BASE)/.installed-demo: pyproject.toml | $(BASE_PYTHON)
	$(call say,$(BASE): installing the service and matplotlib)
	"$(BASE_PYTHON)" -m pip $(PIP_FLAGS) install --editable .
	@# Half of what a first start compiles is compiled while the rest is fetched.
	@"$(BASE_PYTHON)" -m service.warm_up & \
	"$(BASE_PYTHON)" -m pip $(PIP_FLAGS) install --editable ".[pictures]"
	@touch "$@"

$(BASE)/.installed-test: $(BASE)/.installed-demo
	$(call say,$(BASE): installing pytest and friends)
	"$(BASE_PYTHON)" -m pip $(PIP_FLAGS) install --editable ".[pictures,test]"
	@touch "$@"

$(FULL)/.installed: pyproject.toml | $(FULL_PYTHON)
	$(call say,$(FULL): installing everything with torch; a minute or more)
	"$(FULL_PYTHON)" -m pip $(PIP_FLAGS) install $(if $(TORCH_INDEX),--extra-index-url "$(TORCH_INDEX)") \
		--editable ".[training,cluster,pictures,test,oracle,lint,docs]"
	@touch "$@"

# One exact version: proto/generate.py says why. Its wheels are for Python 3.11 and 3.12.
.venv-proto/.installed: proto/generate.py
	"$(PYTHON)" -m venv --clear .venv-proto
	.venv-proto/bin/python -m pip $(PIP_FLAGS) install grpcio-tools==1.60.2 "protobuf<5" "setuptools<81"
	@touch "$@"

.NOTPARALLEL:
.PHONY: web demo docs figures serve train test lint types imports test-base test-training format proto proto-lint environments wheel clean help
