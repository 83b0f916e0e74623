#!/usr/bin/env bash
# The same set-up as run.sh, then formatting, lint, types, every test in C++ and Python, the site, and the structure:
#   bash tools/test.sh [--slow] [options of pytest]
# --slow adds the tests marked slow, runs the notebooks of the site and compiles the benches of speed. Each part runs even when another failed.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

pytest_options=()
site_options=(--fast)
benches=OFF
for argument in "$@"; do
  if [ "$argument" = --slow ]; then
    pytest_options+=(-m 'slow or not slow')
    site_options=()
    benches=ON
  else
    pytest_options+=("$argument")
  fi
done

setup_feltmb --tests
export PATH=$venv/bin:$PATH

summary=()
failures=0

result() { summary+=("$(printf '%-14s %s' "$1" "$2")"); }

# part NAME COMMAND...: runs it, shows its output, keeps the outcome for the summary
part() {
  local name=$1
  shift
  printf '\n== %s\n' "$name"
  if "$@"; then
    result "$name" ok
  else
    result "$name" FAILED
    failures=$((failures + 1))
    return 1
  fi
}

# ---------------------------------------------------------------- formatting, lint, types

install_linters() {
  local tools pinned
  mapfile -t tools < <(pyproject_list project optional-dependencies dev | grep -E '^(ruff|mypy|clang-format)[=<>~]')
  pinned=$(printf '%s\n' "${tools[@]}")
  fresh linters "$(sha256sum <<<"$pinned")" && return 0
  step "linters (${tools[*]})" pip install "${tools[@]}" && stamp linters "$(sha256sum <<<"$pinned")"
}

check_cpp_format() {
  local files
  mapfile -t files < <(find cpp tests/cpp tests/cmake_consumer bench -name '*.[ch]pp' | LC_ALL=C sort)
  clang-format --dry-run --Werror "${files[@]}" && say "${#files[@]} files already formatted"
}

linters=no
if install_linters; then linters=yes; fi

check_text() {
  if [ $linters = yes ]; then
    part 'ruff check' ruff check . || true
    part 'ruff format' ruff format --check . || true
    part 'mypy' mypy || true
    part 'clang-format' check_cpp_format || true
  else
    result 'linters' 'not run: they could not be installed'
  fi
  part 'site' env FELTMB_LOG="$root/build/site.log" bash tools/docs.sh "${site_options[@]}" || true
}

# ---------------------------------------------------------------- C++

# In the tree that the package was built in: its core is compiled once and its tests are linked to it.
build_cpp_tests() {
  if ! find_doctest; then
    say 'doctest (doctest/doctest.h) is missing; an administrator can run: sudo apt-get install -y doctest-dev'
    return 1
  fi
  # The CMake that built the package: another version would compile the core again.
  local cmake
  cmake=$(sed -n 's/^CMAKE_COMMAND:INTERNAL=//p' build/wheel/CMakeCache.txt 2>/dev/null || true)
  cmake=${cmake:-cmake}
  step 'configuring' "$cmake" -S . -B build/wheel -DCMAKE_BUILD_TYPE=Release -DFELTMB_TESTS=ON \
    -DFELTMB_BENCH="$benches" -DFELTMB_WERROR=ON &&
    step "compiling ($CMAKE_BUILD_PARALLEL_LEVEL at a time)" "$cmake" --build build/wheel
}

run_cpp_tests() {
  ctest --test-dir build/wheel --no-tests=error --output-on-failure &&
    sed -n 's/^\[doctest\] \(test cases\|assertions\)/\1/p' build/wheel/Testing/Temporary/LastTest.log
}

check_core() {
  if part 'C++ build' build_cpp_tests; then
    part 'C++ tests' run_cpp_tests || true
  else
    result 'C++ tests' 'not run: they were not built'
  fi
}

# ---------------------------------------------------------------- text and site beside the core

# Both have long steps of one process. The output of the first is shown when the second has ended.
outcome() { printf '%s\n' "${summary[@]}" >"$1" && return "$failures"; }
{ check_text && outcome build/text.summary; } >build/text.log 2>&1 &
text=$!
check_core
code=0
wait $text || code=$?
cat build/text.log
mapfile -t lines <build/text.summary
summary=("${lines[@]}" "${summary[@]}")
failures=$((failures + code))

# ---------------------------------------------------------------- summary, then Python

printf '\n== summary\n'
printf '  %s\n' "${summary[@]}"
if [ "$failures" -gt 0 ]; then
  printf '  %s\n' "$failures of these failed: this command fails, whatever the Python tests say"
fi
printf '  %s\n\n' 'Python tests   follow'

# Tests that share a fixture stay in one process until a process runs out of work.
# The tests of unmodeled run by themselves: they are those of another distribution.
python_tests() { pytest --numprocesses "$(nproc)" --dist worksteal "$@" "${pytest_options[@]}"; }

# What most people install has no compiled integrator. Tests of tape.py and of spellings switch it off themselves;
# these run once more without it, with diagnoses of equations and functions; all tests of unmodeled do so weekly.
without_extension=(unmodeled/tests/fit/test_{reads,coordinates,variational,ode,including,units_of_parameters,chain}.py
  unmodeled/tests/files unmodeled/tests/diagnosis/test_models_from_files.py unmodeled/tests/test_alone.py)
printf '\n== without the compiled integrator\n'
status=0
UNMODELED_NO_EXTENSION=1 python_tests "${without_extension[@]}" || status=$?
[ "$status" -ne 5 ] || status=0
for tests in unmodeled/tests tests/python; do
  printf '\n== %s\n' "$tests"
  code=0
  python_tests "$tests" || code=$?
  # 5: no test was selected, as by -k.
  [ "$code" -eq 0 ] || [ "$code" -eq 5 ] || status=$code
done
printf '\n== structure (tools/house.py)\n'
python tools/house.py || status=1
[ "$failures" -eq 0 ] || exit 1
exit "$status"
