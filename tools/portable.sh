#!/usr/bin/env bash
# Whether every file of the core compiles with the oldest compilers, without making anything of it, and what
# clang-tidy says of it (.clang-tidy):
#   bash tools/portable.sh [COMPILER...]
# COMPILER: a command, with options if it needs some. Default: the oldest that `pip install` accepts, GCC 12 and
# Clang 14 with its own library, as Emscripten 3.1.6 has it, and clang-tidy 19 (on Debian: g++-12 clang-14
# libc++-14-dev clang-tidy-19). Faults of all files are shown. A compiler that is missing is a fault, too.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

compilers=("$@")
[ ${#compilers[@]} -gt 0 ] || compilers=(g++-12 'clang++-14 -stdlib=libc++' clang-tidy-19)
eigen=
for prefix in ${CMAKE_PREFIX_PATH:-} /usr/local /usr; do
  for folder in "$prefix/include/eigen3" "$prefix/include"; do
    if [ -z "$eigen" ] && [ -e "$folder/Eigen/Core" ]; then eigen=$folder; fi
  done
done
[ -n "$eigen" ] || { printf 'portable.sh: Eigen is missing; name its prefix in CMAKE_PREFIX_PATH\n' >&2; exit 1; }

failures=0
for compiler in "${compilers[@]}"; do
  if ! command -v "${compiler%% *}" >/dev/null; then
    printf '%s: not installed\n' "$compiler"
    failures=$((failures + 1))
    continue
  fi
  bad=0 count=0
  while IFS= read -r file; do
    count=$((count + 1))
    flags=(-std=c++20 -DFELTMB_VERSION='""' -I cpp/include -isystem "$eigen")
    # shellcheck disable=SC2086  # a compiler may have options
    case $compiler in
      clang-tidy*) $compiler --quiet --warnings-as-errors='*' "$file" -- "${flags[@]}" || bad=$((bad + 1)) ;;
      *) $compiler "${flags[@]}" -fsyntax-only -Wall -Wextra -Wpedantic -Werror "$file" || bad=$((bad + 1)) ;;
    esac
  done < <(find cpp/src cpp/fmu cpp/wasm tests/cmake_consumer -name '*.cpp' | LC_ALL=C sort)
  printf '%s: %d of %d files of the core pass\n' "$compiler" $((count - bad)) "$count"
  failures=$((failures + bad))
done
exit $((failures > 0))
