#!/usr/bin/env bash
# The C++ tests and some Python tests under the sanitizers of the compiler:
#   bash tools/sanitize.sh address|thread [folder of the build]
# address: memory errors and undefined behavior, over all C++ tests and over Python tests that drive
#   the core by odd ways: events, faults of files, machines, surfaces, strings that are touched.
# thread: races. Runs what uses threads, and no more: `feltmb_thread_tests`, the C++ tests with batches,
#   gradients, steppers and tables that threads share, and loops that are divided among them.
# Needs what tools/test.sh installs; takes ninja and ccache if they are there. PYTHON: which python.
# Each part runs even when another failed. The last line tells what became of each.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
kind=${1:-address}
build=${2:-$root/build/sanitize-$kind}
python=${PYTHON:-python}
case $kind in
  # What is left out doubles the time to compile and trebles the code, and finds little that the
  # address sanitizer and the assertions of Eigen and the library do not.
  address)
    flags='-fsanitize=address,undefined,float-cast-overflow -fno-sanitize=null,alignment,object-size,vptr'
    flags="$flags -fno-sanitize-recover=all"
    target=feltmb_tests
    ;;
  thread)
    flags=-fsanitize=thread
    target=feltmb_thread_tests
    ;;
  *) printf 'sanitize.sh: got %s, expected address or thread\n' "$kind" >&2; exit 2 ;;
esac
python_tests=(
  tests/python/run/test_events.py tests/python/mechanism/test_config_faults.py
  tests/python/run/test_restart.py tests/python/run/test_threads.py tests/python/physics/test_ledger.py tests/python/run/test_machine.py
  tests/python/physics/test_surfaces_with_ends.py tests/python/physics/test_contacts_of_a_string.py
  tests/python/physics/test_random_models.py
)

summary=()
failures=0
begin=$SECONDS
# part NAME COMMAND...: runs it and keeps the outcome for the last line
part() {
  local name=$1 from=$SECONDS status=0
  shift
  "$@" || status=$?
  if [ "$status" = 0 ]; then
    summary+=("$name ok in $((SECONDS - from)) s")
  else
    summary+=("$name FAILED ($status)")
    failures=$((failures + 1))
  fi
  return "$status"
}
finish() {
  local text
  text=$(printf '%s, ' "${summary[@]}")
  printf 'sanitize %s: %s%d s in all\n' "$kind" "$text" $((SECONDS - begin))
  exit $((failures > 0))
}

configure() {
  local options=() pybind11
  mkdir -p "$build"
  if command -v ninja >/dev/null && [ ! -e "$build/Makefile" ]; then options+=(-G Ninja); fi
  if command -v ccache >/dev/null; then
    options+=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
    export CCACHE_BASEDIR=${CCACHE_BASEDIR:-$root} CCACHE_NOHASHDIR=1
  fi
  pybind11=$("$python" -m pybind11 --cmakedir 2>/dev/null || true)
  # A build type of its own adds no flags: those of the known ones would come last and win. File by
  # file and without precompiled headers ccache works, and each file shows that it includes what it uses.
  cmake -S "$root" -B "$build" "${options[@]}" -DCMAKE_BUILD_TYPE=Sanitize -DFELTMB_TESTS=ON \
    -DFELTMB_BENCH=OFF -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON -DFELTMB_UNITY=OFF \
    -DFELTMB_PYTHON="$([ "$kind" = address ] && echo ON || echo OFF)" \
    -DPython_EXECUTABLE="$(command -v "$python")" ${pybind11:+-Dpybind11_DIR="$pybind11"} \
    -DCMAKE_CXX_FLAGS="$flags -fno-omit-frame-pointer -O1 -g1 -D_GLIBCXX_ASSERTIONS"
}

compile() { cmake --build "$build" --target "$1" -j "${CMAKE_BUILD_PARALLEL_LEVEL:-2}"; }

# logged COMMAND...: says nothing unless it fails
logged() { "$@" >>"$build.log" 2>&1 || { tail -n 20 "$build.log" >&2; return 1; }; }

# Python keeps memory to its end: no leaks are looked for there.
run_python() {
  local module package=$build/package preload
  module=$(find "$build" -name '_core.*.so' -not -path "$package/*" | head -n 1)
  rm -rf "$package" && mkdir -p "$package" && cp -r "$root/python/feltmb" "$package/"
  rm -f "$package"/feltmb/_core.*.so && cp "$module" "$package/feltmb/"
  preload=$(${CXX:-g++} -print-file-name=libasan.so):$(${CXX:-g++} -print-file-name=libstdc++.so)
  (cd "$root" && ASAN_OPTIONS=detect_leaks=0 LD_PRELOAD=$preload PYTHONPATH=$package \
    "$python" -m pytest -q -p no:cacheprovider "${python_tests[@]}")
}

export ASAN_OPTIONS=detect_leaks=1:strict_string_checks=1 UBSAN_OPTIONS=print_stacktrace=1
export TSAN_OPTIONS=halt_on_error=1
mkdir -p "$(dirname "$build")"
: >"$build.log"
part configured logged configure || finish
part "build of $target" logged compile "$target" || finish
part 'C++ tests' "$build/tests/cpp/$target" || true
if [ "$kind" = address ]; then
  if part 'build of _core' logged compile _core; then part 'Python tests' run_python || true; fi
fi
finish
