# Everything runs in .venv, made on first use. PYTHON must be 3.11 or newer.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
NATIVE := $(wildcard native/* native/lanes/*) CMakeLists.txt pyproject.toml
# An editable install knows the modules it was made with: one that comes or goes touches its folder.
FOLDERS := $(shell find src -type d -not -name __pycache__)

.PHONY: demo test lint bench studio dist docs clean \
        evidence-fig6 evidence-certify evidence-identify evidence-design evidence-rivals evidence-rivals-arms \
        evidence-readiness evidence-export evidence-franka evidence-studio evidence-lanes \
        evidence-reproduce evidence-bench evidence-choices

demo: $(VENV)/.installed
	$(BIN)/dashpot reproduce --out out/paper

test: $(VENV)/.test lint
	$(BIN)/python -m pytest -n auto -m 'not alone'
	$(BIN)/python -m pytest -n 0 -m alone

lint: $(VENV)/.test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(VENV)/.bench
	$(BIN)/python benchmarks/bench.py --check

# The source distribution, and from it this machine's wheel, in dist/.
dist: $(VENV)/.dist
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl

# The live arm in the browser: `make studio ARGS="fr3 --payload 2"`.
studio: $(VENV)/.studio
	$(BIN)/dashpot studio $(ARGS)

# These pages as a site that needs no network: open out/site/index.html.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

# A minute: the relations of the paper's figures over ten seeds, what `make demo` shows.
evidence-reproduce: $(VENV)/.installed
	$(BIN)/dashpot reproduce --out out/paper
	cp out/paper/results.json docs/evidence/reproduce.json

# Some minutes on an idle machine: all speeds, as ratios within one run.
evidence-bench: $(VENV)/.bench
	$(BIN)/python benchmarks/bench.py --json docs/evidence/bench.json.part
	mv docs/evidence/bench.json.part docs/evidence/bench.json

# About three minutes: the search for the gains of Fig. 6 (b).
evidence-fig6: $(VENV)/.installed
	$(BIN)/python -m dashpot.paper.instability > docs/evidence/fig6.json.part
	mv docs/evidence/fig6.json.part docs/evidence/fig6.json

# About five minutes: tries to prove the certificate wrong on 10,000 joints.
evidence-certify: $(VENV)/.installed
	$(BIN)/python -m dashpot.studies.soundness > docs/evidence/certify.json.part
	mv docs/evidence/certify.json.part docs/evidence/certify.json

# Seven to nine minutes: tries to prove the intervals of the identification wrong on 200 drives.
evidence-identify: $(VENV)/.installed
	$(BIN)/python -m dashpot.studies.identification > docs/evidence/identify.json.part
	mv docs/evidence/identify.json.part docs/evidence/identify.json
	$(BIN)/python -m dashpot.studies.identification_arms > docs/evidence/identify-arms.json.part
	mv docs/evidence/identify-arms.json.part docs/evidence/identify-arms.json

# An hour and a half: 150 designs simulated, 1,200,000 other gains looked at, three arms against hand-picked gains.
evidence-design: $(VENV)/.installed
	for part in predictions brute arms proof; do \
	  $(BIN)/python -m dashpot.studies.designs $$part > docs/evidence/design-$$part.json.part && \
	  mv docs/evidence/design-$$part.json.part docs/evidence/design-$$part.json || exit 1; \
	done

# Half a minute: what `dashpot design` makes of one joint at other periods, samplings and latencies.
evidence-choices: $(VENV)/.installed
	$(BIN)/python -m dashpot.studies.choices designs > docs/evidence/choices.json.part
	mv docs/evidence/choices.json.part docs/evidence/choices.json

# About ten minutes: tunes every law on one joint with one budget.
evidence-rivals: $(VENV)/.installed
	$(BIN)/python -m dashpot.studies.rivals_tuning > docs/evidence/rivals.json.part
	mv docs/evidence/rivals.json.part docs/evidence/rivals.json

# About an hour on two cores: every brake and tracker on whole arms, 504 runs per arm and brake.
# Goes on where it was stopped; `rm -r out/rivals-arms` to begin anew.
evidence-rivals-arms: $(VENV)/.installed
	$(BIN)/python -m dashpot.studies.rivals_arms

# About a minute on two cores: every fault with every payload in every pose on the fr3, 10,080 scenarios.
# Goes on where it was stopped.
evidence-readiness: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[campaign]'
	$(BIN)/python -m dashpot.studies.readiness > docs/evidence/readiness.json.part
	mv docs/evidence/readiness.json.part docs/evidence/readiness.json

# About three minutes: exported controllers against Python, on this machine and on an emulated Cortex-M.
evidence-export: $(VENV)/.test
	$(BIN)/python -m dashpot.studies.export > docs/evidence/export.json.part
	mv docs/evidence/export.json.part docs/evidence/export.json

# About two minutes on an idle machine: official pylibfranka against the simulated FR3, twenty times the same bits.
evidence-franka: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[franka]'
	$(BIN)/python -m dashpot.studies.franka > docs/evidence/franka.json.part
	mv docs/evidence/franka.json.part docs/evidence/franka.json

# Half an hour on two cores: the vectorised arm against MuJoCo's limit, and the readiness campaign on both engines.
evidence-lanes: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[campaign]'
	for part in agreement elements readiness; do \
	  $(BIN)/python -m dashpot.studies.lanes $$part > docs/evidence/lanes-$$part.json.part && \
	  mv docs/evidence/lanes-$$part.json.part docs/evidence/lanes-$$part.json || exit 1; \
	done

# Ten minutes: the studio with a page open in a headless Chromium, its processor time and memory.
evidence-studio: $(VENV)/.test
	$(BIN)/python -m dashpot.studies.studio_soak > docs/evidence/studio.json.part
	mv docs/evidence/studio.json.part docs/evidence/studio.json

$(VENV)/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "dashpot needs Python 3.11 or newer; try: make PYTHON=python3.11")'
	@echo "setting up: a virtual environment in $(VENV)"
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(NATIVE) $(FOLDERS) | $(VENV)/bin/python
	@echo "setting up: packages, and compiling the native code, a minute or two"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.test: $(VENV)/.installed
	@echo "setting up: what the tests need, a minute or two"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	@command -v chromium > /dev/null || command -v chromium-browser > /dev/null || command -v google-chrome > /dev/null || \
	  PLAYWRIGHT_DOWNLOAD_CONNECTION_TIMEOUT=10000 $(BIN)/python -m playwright install chromium > /dev/null 2>&1 || \
	  echo "No Chromium here, and none to be had: the test of the studio in a browser will be skipped; install chromium."
	touch $@

$(VENV)/.studio: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[studio]'
	touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

$(VENV)/.bench: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $@

$(VENV)/.dist: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dist]'
	touch $@

clean:
	rm -rf $(VENV) build dist out

# Pictures of the README and of the pages, from the code as it is.
figures: demo
	cp out/paper/fig5.png docs/images/
	-$(BIN)/dashpot certify k807 k807-resonant --out out/certify
	cp out/certify/joint6.png docs/images/certificate.png
	$(BIN)/dashpot excite k807 --controller k807-wrist --payload 3 --offset 0.15 --out out/excite
	$(BIN)/dashpot simulate k807 k807-wrist --payload 3 --offset 0.15 --motion out/excite/motion.csv --log out/identify.csv
	$(BIN)/dashpot identify out/identify.csv --robot k807 --sampling average --joint joint6
	cp out/identify/joint6.png docs/images/identify.png
	$(BIN)/python -m dashpot.studies.supervision docs/images/supervisor.png
	$(BIN)/python -m dashpot.studies.architecture docs/images/architecture.png
	$(BIN)/dashpot simulate fr3 fr3 --payload 2 --supervise --payload-at 1=4 --fault encoder_frozen:joint4@3 --duration 4 --log out/run.mcap
	$(BIN)/dashpot plot out/run.mcap --joint joint4
	cp out/plot/joint4.png docs/images/log.png
	$(BIN)/python -m dashpot.studies.vpc_pictures
	$(BIN)/dashpot map fr3 fr3 --joint joint2
	cp out/map/joint2.png docs/images/map.png
	$(MAKE) figures-tutorial
	$(MAKE) $(VENV)/.test
	$(BIN)/python -m dashpot.studies.studio_pictures --only scene controller faults
.PHONY: figures

# The commands of docs/tutorial.md up to its second picture.
figures-tutorial: DASHPOT = cd out/tutorial && $(abspath $(BIN)/dashpot)
figures-tutorial: $(VENV)/.test
	rm -rf out/tutorial && mkdir -p out/tutorial && cp examples/own_* out/tutorial
	$(DASHPOT) excite own_arm.toml --controller own_gains.toml --payload 1 --offset 0.3
	$(DASHPOT) simulate own_arm_true.toml own_gains.toml --payload 1 --offset 0.3 --motion out/excite/motion.csv --log log.mcap
	$(DASHPOT) identify log.mcap --robot own_arm.toml
	cp out/tutorial/out/identify/shoulder.png docs/images/tutorial-identify.png
	sed 's#../../own_arm.xml#own_arm.xml#; s#\(stiffness = 0.[0-9]*\) }#\1, damping = 0.5 }\ntorque_noise = 0.03#' \
	  out/tutorial/out/identify/own_arm.toml > out/tutorial/my_arm.toml
	$(DASHPOT) design my_arm.toml track --payload 3 --offset 0.3
	$(DASHPOT) simulate my_arm.toml out/design/controller.toml --payload 3 --offset 0.3 \
	  --fault encoder_frozen:elbow@2 --supervise --log fault.mcap
	$(DASHPOT) plot fault.mcap --joint elbow
	cp out/tutorial/out/plot/elbow.png docs/images/tutorial-fault.png
.PHONY: figures-tutorial
