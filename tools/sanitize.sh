#!/usr/bin/env bash
# The C++ tests and some Python tests under the sanitizers of the compiler:
#   bash tools/sanitize.sh address|thread [folder of the build]
# address: memory errors and undefined behavior. thread: races between runs that share a mechanism.
# Needs what tools/test.sh installs. Ends with the status of the first part that failed.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
kind=${1:-address}
build=${2:-$root/build/sanitize-$kind}
case $kind in
  address) flags='-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all' ;;
  thread) flags=-fsanitize=thread ;;
  *) printf 'sanitize.sh: got %s, expected address or thread\n' "$kind" >&2; exit 2 ;;
esac
pybind11=$(python -m pybind11 --cmakedir 2>/dev/null || true)
cmake -S "$root" -B "$build" -DCMAKE_BUILD_TYPE=RelWithDebInfo -DFELTMB_TESTS=ON -DFELTMB_BENCH=OFF \
  -DFELTMB_PYTHON="$([ "$kind" = address ] && echo ON || echo OFF)" \
  ${pybind11:+-Dpybind11_DIR="$pybind11"} -DCMAKE_CXX_FLAGS="$flags -fno-omit-frame-pointer -O1 -g1 -D_GLIBCXX_ASSERTIONS" >"$build.log" 2>&1 ||
  { tail -n 20 "$build.log" >&2; exit 1; }
cmake --build "$build" -j "${CMAKE_BUILD_PARALLEL_LEVEL:-1}" >>"$build.log" 2>&1 || { tail -n 20 "$build.log" >&2; exit 1; }
export ASAN_OPTIONS=detect_leaks=1:strict_string_checks=1 UBSAN_OPTIONS=print_stacktrace=1
export TSAN_OPTIONS=halt_on_error=1
"$build/tests/cpp/feltmb_tests"
[ "$kind" = address ] || exit 0
# Python keeps memory to its end: no leaks are looked for there.
module=$(find "$build" -name '_core.*.so' | head -n 1)
package=$build/package
rm -rf "$package" && mkdir -p "$package" && cp -r "$root/python/feltmb" "$package/"
rm -f "$package"/feltmb/_core.*.so && cp "$module" "$package/feltmb/"
preload=$(${CXX:-g++} -print-file-name=libasan.so):$(${CXX:-g++} -print-file-name=libstdc++.so)
cd "$root"
ASAN_OPTIONS=detect_leaks=0 LD_PRELOAD=$preload PYTHONPATH=$package python -m pytest -q -p no:cacheprovider \
  tests/python/unit/test_events.py tests/python/unit/test_config_faults.py \
  tests/python/unit/test_strangers_core.py tests/python/hard/test_random_models.py
