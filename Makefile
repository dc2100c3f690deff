# Everything from a fresh clone; each target sets up what it needs, once.

.DEFAULT_GOAL := help
.PHONY: help setup setup-rig validate test test-slow test-wheel test-oldest check docs bench constraints

# Empty files inside .venv remember what was set up, and vanish with it.
PACKAGES := .venv/.packages-installed
LIBRARIES := .venv/.libraries-found
RIG := .venv/.rig-installed
SITE := .venv/.docs-installed
ASV := .venv/.asv-installed

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | expand -t 14

setup: $(LIBRARIES) ## set up .venv and the system libraries; nothing is done twice

setup-rig: $(RIG) ## set up .venv with what a rig uses: to measure, to fit, the node and the console

validate: $(LIBRARIES) ## the main job: render, track, fit, report, into out/validate
	.venv/bin/eyespot validate --out out/validate

# Two processes, a file's tests in one of them: they share what the file compiles. The files keep the
# order of tests/conftest.py. The slowest tests are printed: see "How tests are written".
test: $(LIBRARIES) ## run the tests
	.venv/bin/pytest -n 2 --dist loadfile --no-loadscope-reorder --durations 15

test-slow: $(LIBRARIES) ## run the tests that the default run leaves out
	.venv/bin/pytest -m 'slow and not gpu' -n 2 --dist loadfile --no-loadscope-reorder --durations 15

test-wheel: $(PACKAGES) ## build the wheel, install it in a fresh environment, run it there
	.venv/bin/pytest -m wheel

test-oldest: $(LIBRARIES) ## run a part of the tests with the lowest versions allowed
	tools/try-oldest

check: $(PACKAGES) ## lint, format, types
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy

docs: $(SITE) $(LIBRARIES) ## build the documentation into out/docs/site
	.venv/bin/sphinx-build --fail-on-warning --keep-going --quiet docs out/docs/site

# asv's fork server would fork after Mitsuba was loaded.
bench: $(ASV) $(LIBRARIES) ## measure speed for `asv compare`, then accuracy beside alternatives
	.venv/bin/asv machine --yes
	.venv/bin/asv run --environment existing:.venv/bin/python --launch-method spawn \
	    --set-commit-hash $$(git rev-parse HEAD)
	.venv/bin/python -m eyespot.benchmarks.bench

constraints: ## resolve all versions anew and write constraints.txt
	tools/pin-versions

$(PACKAGES): pyproject.toml constraints.txt tools/install-packages
	@tools/install-packages
	@touch $@

$(RIG): pyproject.toml constraints.txt tools/install-packages scenes/machine/packages.py
	@tools/install-packages rig
	@touch $@

$(LIBRARIES): $(PACKAGES) scenes/machine/llvm.py scenes/machine/variant.py tools/install-libraries
	@tools/install-libraries
	@touch $@

$(ASV): $(PACKAGES)
	@tools/install-packages bench
	@touch $@

$(SITE): $(PACKAGES)
	@tools/install-packages docs
	@touch $@
