#!/usr/bin/env bash
# The core as a WebAssembly module for `feltmb page`, beside the extension: python/feltmb/_core_page.wasm
#   bash tools/wasm.sh
# On Debian 12: emscripten libeigen3-dev nodejs cmake xz-utils. SUNDIALS is compiled once, into build/wasm.
#   SUNDIALS_SOURCE             folder with its source; default: Debian's source package
#   CMAKE_BUILD_PARALLEL_LEVEL  compilers at a time
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

sundials=6.4.1
work=$PWD/build/wasm
prefix=$work/prefix

missing=()
for program in em++:emscripten node:nodejs cmake:cmake; do
  command -v "${program%%:*}" >/dev/null || missing+=("${program##*:}")
done
eigen=
for place in ${CMAKE_PREFIX_PATH:-} /usr/local /usr; do
  folder=$place/share/eigen3/cmake
  if [ -z "$eigen" ] && [ -e "$folder/Eigen3Config.cmake" ]; then eigen=$folder; fi
done
[ -n "$eigen" ] || missing+=(libeigen3-dev)
if [ ${#missing[@]} -gt 0 ]; then
  printf 'wasm.sh: missing: %s\n  apt-get install -y --no-install-recommends %s\n' \
    "${missing[*]}" "${missing[*]}" >&2
  exit 1
fi

mkdir -p "$work"
flags='-O2 -fwasm-exceptions'
if [ ! -e "$prefix/lib/libsundials_cvodes.a" ]; then
  source=${SUNDIALS_SOURCE:-$work/sundials-$sundials}
  if [ ! -e "$source/CMakeLists.txt" ]; then
    orig=$work/sundials_$sundials+dfsg1.orig.tar.xz
    (cd "$work" && apt-get source --download-only sundials && [ -e "$orig" ]) || {
      printf 'wasm.sh: Debian has no source of SUNDIALS %s here: add "deb-src" to the types of its sources and run %s,\n  or give a folder with it in SUNDIALS_SOURCE\n' \
        "$sundials" 'apt-get update' >&2
      exit 1
    }
    tar -xf "$orig" -C "$work"
  fi
  # CMake seeks the size of a type in what the linker writes, which is a script here.
  emcmake cmake -S "$source" -B "$work/sundials" -DCMAKE_CROSSCOMPILING_EMULATOR=node \
    -DHAVE_HAS_int64_t=TRUE -DHAS_int64_t=8 \
    -DCMAKE_INSTALL_PREFIX="$prefix" -DCMAKE_INSTALL_LIBDIR=lib -DCMAKE_BUILD_TYPE=Release \
    -DCMAKE_C_FLAGS_RELEASE="$flags" -DBUILD_SHARED_LIBS=OFF -DEXAMPLES_ENABLE_C=OFF \
    -DEXAMPLES_INSTALL=OFF -DBUILD_ARKODE=OFF -DBUILD_CVODE=OFF -DBUILD_IDA=OFF -DBUILD_IDAS=OFF \
    -DBUILD_KINSOL=OFF
  cmake --build "$work/sundials"
  cmake --install "$work/sundials" >/dev/null
fi
emcmake cmake -S . -B "$work/core" -DCMAKE_CROSSCOMPILING_EMULATOR=node \
  -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_FLAGS_RELEASE="$flags" -DCMAKE_FIND_ROOT_PATH="$prefix" \
  -DEigen3_DIR="$eigen" -DFELTMB_WASM=ON -DFELTMB_TESTS=OFF -DFELTMB_BENCH=OFF
cmake --build "$work/core" --target feltmb_page
cp "$work/core/_core_page.wasm" python/feltmb/
printf 'python/feltmb/_core_page.wasm: %d kB\n' $(($(stat -c %s python/feltmb/_core_page.wasm) / 1000))
