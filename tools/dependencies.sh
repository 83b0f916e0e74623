#!/usr/bin/env bash
# SUNDIALS (CVODES, static) and Eigen from their sources into a prefix, where the system has none
# that are new enough: before wheels are built in a bare image.
#   bash tools/dependencies.sh PREFIX
# SUNDIALS_SOURCE and EIGEN_SOURCE: folders with sources that are there already. SUNDIALS_VERSION,
# EIGEN_VERSION: others than these.
set -euo pipefail
shopt -s inherit_errexit

prefix=${1:?give the folder to install into}
sundials=${SUNDIALS_VERSION:-7.1.1}
eigen=${EIGEN_VERSION:-3.4.0}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fetch() { # NAME REPOSITORY TAG GIVEN: the folder of its source
  if [ -n "$4" ]; then
    printf '%s' "$4"
    return
  fi
  if ! git -c advice.detachedHead=false clone --quiet --depth 1 --branch "$3" "$2" "$work/$1" >&2; then
    printf '%s: could not be fetched from %s; give a folder with its source in %s_SOURCE\n' \
      "$1 $3" "$2" "${1^^}" >&2
    return 1
  fi
  printf '%s' "$work/$1"
}

source=$(fetch sundials https://github.com/LLNL/sundials "v$sundials" "${SUNDIALS_SOURCE:-}")
cmake -S "$source" -B "$work/sundials-build" -DCMAKE_INSTALL_PREFIX="$prefix" \
  -DCMAKE_BUILD_TYPE=Release -DCMAKE_POSITION_INDEPENDENT_CODE=ON -DCMAKE_INSTALL_LIBDIR=lib \
  -DBUILD_SHARED_LIBS=OFF -DBUILD_STATIC_LIBS=ON -DEXAMPLES_ENABLE_C=OFF -DEXAMPLES_INSTALL=OFF \
  -DBUILD_ARKODE=OFF -DBUILD_CVODE=OFF -DBUILD_IDA=OFF -DBUILD_IDAS=OFF -DBUILD_KINSOL=OFF
cmake --build "$work/sundials-build" --config Release --parallel
cmake --install "$work/sundials-build" --config Release

source=$(fetch eigen https://gitlab.com/libeigen/eigen.git "$eigen" "${EIGEN_SOURCE:-}")
cmake -S "$source" -B "$work/eigen-build" -DCMAKE_INSTALL_PREFIX="$prefix" -DBUILD_TESTING=OFF \
  -DEIGEN_BUILD_DOC=OFF -DEIGEN_BUILD_PKGCONFIG=OFF
cmake --install "$work/eigen-build"
