# A test that ends its worker fails. Not in pyproject.toml: colcon runs pytest without these workers.
WORKERS = --max-worker-restart=0

.PHONY: reference demo test test-all lint check docs format stubs sanitize arm lock

demo:  ## Render a scene, replay it live through the nodes, print the result
	@./hoid demo

test:  ## Unit tests, then each node, topic and replay once; five minutes
	@./hoid dev python -m pytest $(WORKERS) -n auto --dist worksteal -m 'not slow' src bags lab
	@./hoid dev python -m pytest $(WORKERS) -n 2 --dist loadfile -m 'not alone and not thorough' tests

test-all:  ## What `make test` leaves out: slow units, faults, kills, many seeds, browsers
	@./hoid dev python -m pytest $(WORKERS) -n auto -m slow src bags lab
	@./hoid dev python -m pytest $(WORKERS) -n 2 --dist loadfile -m 'thorough and not alone' tests
	@./hoid dev python -m pytest -m alone tests

lint:  ## Style, spelling and types
	@./hoid dev ruff check .
	@./hoid dev ruff format --check .
	@./hoid dev codespell README.md docs src bags lab tests
	@./hoid dev mypy src bags lab tests
	@for folder in src/*/test bags/test lab/test; do ./hoid dev mypy $$folder/*.py || exit 1; done

check:  ## The quick experiments, held against stored bounds
	@./hoid bench --quick --check

docs:  ## The documents as a site, out/site; broken links are errors
	@NO_MKDOCS_2_WARNING=1 ./hoid dev python -m mkdocs build --quiet
	@echo 'open out/site/index.html, or serve it: python3 -m http.server --bind 127.0.0.1 --directory out/site'

reference:  ## Write the pages of parameters, commands, messages and decisions, and the tables of results, anew
	@./hoid dev python -m hoid_benchmarks.publish.parameter_reference > docs/reference/parameters.md
	@./hoid dev python -m hoid_benchmarks.publish.command_reference > docs/reference/commands.md
	@./hoid dev python -m hoid_benchmarks.publish.message_reference src/hoid_msgs > docs/reference/messages.md
	@./hoid dev python -m hoid_benchmarks.publish.pages

format:
	@./hoid dev ruff check --fix .
	@./hoid dev ruff format .

sanitize:  ## The kernels' tests under AddressSanitizer and UndefinedBehaviorSanitizer
	@./hoid dev src/hoid_native/sanitize

arm:  ## Compile the kernels for 64-bit ARM (apt: g++-aarch64-linux-gnu)
	@./hoid dev src/hoid_native/compile_for_arm

stubs:  ## Write the types of the compiled module anew, from what it says itself
	@./hoid dev python -m nanobind.stubgen -q -m hoid_native._native -o src/hoid_native/hoid_native/_native.pyi
	@./hoid dev ruff format -q src/hoid_native/hoid_native/_native.pyi

lock:  ## Pin the Python packages anew (needs uv)
	cd requirements && pin="uv pip compile --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --upgrade" && \
	  $$pin robot.in -o robot.lock && \
	  $$pin --no-deps build.in -o build.lock && \
	  $$pin experiments.in -c robot.lock -o experiments.lock && \
	  $$pin ros.in -c robot.lock -c experiments.lock -o ros.lock && \
	  $$pin dev.in -c robot.lock -c experiments.lock -c ros.lock -o dev.lock && \
	  $$pin view.in -c robot.lock -c experiments.lock -c ros.lock -c dev.lock -o view.lock && \
	  $$pin video.in -c robot.lock -c experiments.lock -c ros.lock -c dev.lock -o video.lock && \
	  $$pin mesh.in -c robot.lock -c experiments.lock -c ros.lock -c dev.lock -c view.lock -o mesh.lock
