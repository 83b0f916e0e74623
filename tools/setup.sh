#!/usr/bin/env bash
# Set-up shared by run.sh and test.sh: finds or installs what feltmb needs, builds it, installs it
# into a virtual environment. Source it and call `setup_feltmb [--tests]`, or run it by itself.
#
#   FELTMB_VENV                 where the virtual environment is (default: .venv of this clone)
#   FELTMB_PYTHON               the Python to use first (3.11 or newer, with its headers)
#   CXX, CMAKE_PREFIX_PATH      compiler and extra places of SUNDIALS and Eigen, as CMake reads them
#   FELTMB_LOG                  file of the output (default: build/install.log)
#   CMAKE_BUILD_PARALLEL_LEVEL  compilers at a time (default: cores, but 1.5 GB of memory for each)

start_dir=$PWD
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
log=${FELTMB_LOG:-$root/build/install.log}
venv=${FELTMB_VENV:-$root/.venv}
case $venv in /*) ;; *) venv=$start_dir/$venv ;; esac
vpy=$venv/bin/python
cd "$root" || exit 1

# ---------------------------------------------------------------- talking

say() { printf '%s\n' "$*"; }
die() { printf '%s\n' '' "$@" >&2; exit 1; }

short() { case $1 in "$root"/*) printf '%s' "${1#"$root"/}" ;; *) printf '%s' "$1" ;; esac; }

# step TITLE COMMAND...: runs quietly with a sign of life and the time taken; on failure the first
# error lines are shown and the step returns the command's status.
step() {
  local title=$1 status=0 begin=$SECONDS from ticker
  shift
  printf '\n### %s\n$ %s\n' "$title" "$*" >>"$log"
  from=$(wc -l <"$log")
  printf '  %s ' "$title"
  sign_of_life "$title" 9>&- &
  ticker=$!
  "$@" >>"$log" 2>&1 </dev/null || status=$?
  kill "$ticker" 2>/dev/null
  wait "$ticker" 2>/dev/null || true
  [ -t 1 ] && printf '\r  %s ' "$title"
  if [ "$status" = 0 ]; then
    printf '... done (%d s)\n' $((SECONDS - begin))
  else
    printf '... FAILED (%d s)\n' $((SECONDS - begin))
    first_errors "$from" >&2
  fi
  return "$status"
}

sign_of_life() {  # a clock on a terminal, a dot every 10 s elsewhere
  local seconds=0
  while sleep 1 >/dev/null 2>&1 && kill -0 $$ 2>/dev/null; do
    seconds=$((seconds + 1))
    if [ -t 1 ]; then
      printf '\r  %s ... %d s' "$1" "$seconds"
    elif [ $((seconds % 10)) = 0 ]; then
      printf '.'
    fi
  done
}

first_errors() {  # the first error lines of the log after line $1, else its end; not pip's own report
  local output lines
  local noise='subprocess-exited|did not run successfully|exit code: |Failed building|Failed to build|Could not build'
  local telling='(^|[^[:alnum:]_./-])(error|fatal error|E)(:| at )|cannot |could not |unable to '
  telling="$telling|no space left|permission denied|no module named|killed"
  output=$(tail -n "+$(($1 + 1))" "$log" | grep -v -E "$noise") || true
  lines=$(grep -i -E -m 5 -A 4 "$telling" <<<"$output" | head -n 20) || true
  [ -n "$lines" ] || lines=$(tail -n 15 <<<"$output")
  cut -c 1-200 <<<"$lines" | sed 's/^/    /'
  say "  the whole log: $(short "$log")"
}

# ---------------------------------------------------------------- what is there

prefixes() {
  printf '%s\n' "${CMAKE_PREFIX_PATH:-}" | tr ':;' '\n' | sed '/^$/d'
  printf '%s\n' ${CONDA_PREFIX:+"$CONDA_PREFIX"} /usr/local /usr
}

# prefix_with FILE...: the first prefix that holds one of the files (patterns allowed)
prefix_with() {
  local prefix pattern
  while IFS= read -r prefix; do
    for pattern in "$@"; do
      if compgen -G "$prefix/$pattern" >/dev/null; then
        printf '%s' "$prefix"
        return 0
      fi
    done
  done < <(prefixes)
  return 1
}

# header_number FILE MACRO...: the values of integer macros, joined by dots
header_number() {
  local file=$1 macro value='' number
  shift
  for macro in "$@"; do
    number=$(sed -n -E "s/^#[[:space:]]*define[[:space:]]+${macro}[[:space:]]+([0-9]+).*/\1/p" "$file" | head -n 1)
    value=$value${value:+.}${number:-0}
  done
  printf '%s' "$value"
}

at_least() { [ "$(printf '%s\n%s\n' "$2" "$1" | sort -V | head -n 1)" = "$2" ]; }

find_compiler() {
  local candidate
  for candidate in "${CXX:-}" g++ g++-14 g++-13 g++-12; do
    [ -n "$candidate" ] || continue
    # GCC 11 and older, and Clang before 14, miss parts of C++20 that feltmb uses.
    # shellcheck disable=SC2086  # CXX may hold options
    if printf '%s\n' '#include <concepts>' '#if defined(__clang__) ? __clang_major__ < 14 : __GNUC__ < 12' \
      '#error too old' '#endif' | $candidate -std=c++20 -x c++ -fsyntax-only - >/dev/null 2>&1; then
      export CXX=$candidate
      return 0
    fi
    [ "$candidate" != "${CXX:-}" ] || say "  CXX=$candidate does not compile C++20; looking for g++"
  done
  return 1
}

find_cmake() {
  local version
  version=$(cmake --version 2>/dev/null | sed -n '1s/[^0-9]*//p') && [ -n "$version" ] && at_least "$version" 3.22
}

find_build_program() { command -v make >/dev/null || command -v ninja >/dev/null; }

find_sundials() {
  local prefix config=include/sundials/sundials_config.h
  prefix=$(prefix_with include/cvodes/cvodes.h) &&
    at_least "$(header_number "$prefix/$config" SUNDIALS_VERSION_MAJOR SUNDIALS_VERSION_MINOR)" 6.4 &&
    prefix_with 'lib*/libsundials_cvodes.a' 'lib/*/libsundials_cvodes.a' >/dev/null &&
    prefix_with 'lib*/libsundials_nvecserial.a' 'lib/*/libsundials_nvecserial.a' >/dev/null
}

find_eigen() {
  local macros=Eigen/src/Core/util/Macros.h prefix
  prefix=$(prefix_with "include/eigen3/$macros" "include/$macros") || return 1
  [ -e "$prefix/include/eigen3/$macros" ] && macros=eigen3/$macros
  at_least "$(header_number "$prefix/include/$macros" EIGEN_WORLD_VERSION EIGEN_MAJOR_VERSION)" 3.4
}

find_doctest() { prefix_with include/doctest/doctest.h >/dev/null; }

find_browser() {
  local name
  for name in chromium-headless-shell chromium chromium-browser google-chrome; do
    command -v "$name" >/dev/null && return 0
  done
  return 1
}

# Python >= 3.11; with "headers" also its Python.h.
python_suits() {
  "$1" - "${2:-}" >/dev/null 2>&1 <<'PYTHON'
import os, sys, sysconfig
header = os.path.join(sysconfig.get_path("include"), "Python.h")
sys.exit(sys.version_info < (3, 11) or ("headers" in sys.argv and not os.path.exists(header)))
PYTHON
}

find_python() {
  local candidate
  # An environment that is there already decides, unless another Python is asked for.
  for candidate in "${FELTMB_PYTHON:-}" "$vpy" python3 python3.13 python3.12 python3.11 /usr/bin/python3; do
    [ -n "$candidate" ] || continue
    if python_suits "$candidate" headers; then
      python=$candidate
      return 0
    fi
    [ "$candidate" != "${FELTMB_PYTHON:-}" ] ||
      say "  FELTMB_PYTHON=$candidate is missing, older than 3.11 or without headers; looking for another"
  done
  return 1
}

has_ensurepip() { "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; }

lacking() { need_text+=("$1") need+=("$2"); }

# Fills need (without it nothing works) and want (there is another way, or only a part is left out).
look_around() {
  need=() need_text=() want=()
  find_compiler || lacking 'a C++20 compiler (g++ 12 or newer)' g++
  find_cmake || lacking 'CMake 3.22 or newer' cmake
  find_build_program || lacking 'ninja or make' ninja-build  # ninja compiles the bindings beside the core
  find_sundials || lacking 'SUNDIALS 6.4 or newer (cvodes/cvodes.h, static libraries)' libsundials-dev
  find_eigen || lacking 'Eigen 3.4 or newer (Eigen/Core)' libeigen3-dev
  if find_python; then
    has_ensurepip || [ -x "$vpy" ] || want+=(python3-venv)
  else
    lacking 'Python 3.11 or newer with its headers (Python.h)' python3-dev
    want+=(python3-venv)
  fi
  if [ "$with_tests" = yes ] && ! find_doctest; then want+=(doctest-dev); fi
}

# ---------------------------------------------------------------- Debian's packages

may_install() {
  as_root=()
  command -v apt-get >/dev/null || return 1
  [ "$(id -u)" = 0 ] && return 0
  command -v sudo >/dev/null && sudo -n true 2>/dev/null && as_root=(sudo -n)
}

apt() { "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive LC_ALL=C apt-get -o DPkg::Lock::Timeout=300 "$@"; }

install_packages() {
  local packages=("${need[@]}" "${want[@]}") plan
  say "installing from Debian: ${packages[*]}"
  step 'apt-get update' apt update || say '  (going on with the package lists that are there)'
  plan=$(apt install --no-install-recommends --assume-no "${packages[@]}" 2>/dev/null </dev/null) || true
  plan=$(printf '%s\n' "$plan" | sed -n -E \
    -e 's/.* ([0-9]+) newly installed.*/packages: \1/p' \
    -e 's/^Need to get (.*) of archives\./\1 to download/p' \
    -e 's/^After this operation, (.*) of additional.*/\1 on disk/p' | paste -s -d '|' | sed 's/|/, /g')
  case $plan in 'packages: '[1-9][0-9][0-9],*) plan="$plan; 2 to 5 minutes" ;; esac
  [ -z "$plan" ] || say "  $plan"
  step 'apt-get install' apt install -y --no-install-recommends "${packages[@]}"
}

get_system_ready() {
  look_around
  if [ $((${#need[@]} + ${#want[@]})) -gt 0 ]; then
    if may_install; then
      install_packages || true  # what is still missing is said below
      look_around
    fi
  fi
  # By itself: a system without this package still gets all others.
  if [ "$with_tests" = yes ] && ! find_browser; then
    if may_install; then
      step 'a browser for the tests of feltmb view (64 MB)' \
        apt install -y --no-install-recommends chromium-headless-shell || true
    fi
    find_browser || say '  no browser: the tests of feltmb view in a browser will be skipped'
  fi
  if [ ${#need[@]} -gt 0 ]; then
    die 'missing:' "${need_text[@]/#/  }" 'On Debian 12 ask an administrator to run:' \
      "  sudo apt-get update && sudo apt-get install -y --no-install-recommends ${need[*]}${want[*]:+ ${want[*]}}" \
      'Elsewhere install them in your own way; CXX, CMAKE_PREFIX_PATH and FELTMB_PYTHON say where they are.' \
      'Then give this command again.'
  fi
}

# ---------------------------------------------------------------- virtual environment and package

pip() { "$vpy" -m pip --disable-pip-version-check --no-input "$@"; }

make_environment() {
  if [ -x "$vpy" ] && python_suits "$vpy" headers && same_python; then return 0; fi
  if [ -e "$venv" ] && [ -n "$(ls -A "$venv" 2>/dev/null)" ] && [ ! -e "$venv/pyvenv.cfg" ]; then
    die "$venv is there and is not a virtual environment; set FELTMB_VENV to another place."
  fi
  step "virtual environment $(short "$venv")" "$python" -m venv --clear --without-pip "$venv" ||
    die "The virtual environment $venv could not be made."
  printf '*\n' >"$venv/.gitignore"
}

# An environment made by another Python than the one asked for is made anew.
same_python() {
  local what='import sys; print(sys.version_info[:2], sys.base_prefix)'
  [ "$("$python" -c "$what")" = "$("$vpy" -c "$what")" ]
}

make_pip() {
  pip --version >/dev/null 2>&1 && return 0
  if "$vpy" -c 'import ensurepip' 2>/dev/null; then
    step 'pip (from Python itself)' "$vpy" -m ensurepip && return 0
  fi
  if "$python" -m pip --python "$vpy" --version >/dev/null 2>&1; then
    step "pip (by the pip that is there)" "$python" -m pip --python "$vpy" --no-input install pip && return 0
  fi
  step 'pip (tools/get_pip.py)' "$vpy" tools/get_pip.py ||
    die 'There is no pip for the virtual environment. Install python3-venv, or set PIP_INDEX_URL to your package index.'
}

# pyproject_list TABLE... KEY: the strings of a list in pyproject.toml, one a line
pyproject_list() {
  "$vpy" - "$@" <<'PYTHON'
import sys, tomllib
with open("pyproject.toml", "rb") as file:
    value = tomllib.load(file)
for key in sys.argv[1:]:
    value = value[key]
print("\n".join(value))
PYTHON
}

# build_requirements: what both distributions need to be built, one a line
build_requirements() {
  "$vpy" - <<'PYTHON'
import tomllib
for folder in (".", "unmodeled"):
    with open(f"{folder}/pyproject.toml", "rb") as file:
        print(*tomllib.load(file)["build-system"]["requires"], sep="\n")
PYTHON
}

fingerprint() {  # of all that decides what the installed package is, without what its build writes
  {
    find pyproject.toml CMakeLists.txt README.md LICENSE cpp python unmodeled/pyproject.toml \
      unmodeled/setup.py unmodeled/README.md unmodeled/LICENSE unmodeled/src \
      \( -name __pycache__ -o -name '*.egg-info' -o -name '*.so' \) -prune -o -type f -print0 |
      LC_ALL=C sort -z | xargs -0 sha256sum
    # shellcheck disable=SC2086
    "$vpy" -VV && $CXX --version
  } | sha256sum | cut -d ' ' -f 1
}

fresh() { [ "$(cat "$venv/feltmb.$1" 2>/dev/null)" = "$2" ]; }
stamp() { printf '%s\n' "$2" >"$venv/feltmb.$1"; }

# The tree of the build, unless this clone was at another place then.
tree_is_here() { grep -q -x -F "CMAKE_HOME_DIRECTORY:INTERNAL=$root" build/wheel/CMakeCache.txt 2>/dev/null; }

# Most packages are fetched and unpacked while the core compiles. The wheel is installed by itself first, since pip
# leaves an older build with the same version as it is.
build_and_install() {
  local fetching fetched=0 built=0
  pip install --no-build-isolation "$of_unmodeled" &
  fetching=$!
  rm -rf build/wheels
  pip wheel --no-build-isolation --no-deps --wheel-dir build/wheels "${strict[@]}" . || built=$?
  wait $fetching || fetched=$?
  [ $((fetched + built)) = 0 ] &&
    pip install --force-reinstall --no-deps build/wheels/feltmb-*.whl &&
    pip install "$(echo build/wheels/feltmb-*.whl)[$extra]"
}

install_package() {
  local extra=live of_unmodeled=./unmodeled sources dependencies requirements strict=()
  sources=$(fingerprint)
  dependencies=$(cat pyproject.toml unmodeled/pyproject.toml | sha256sum)
  if fresh sources "$sources" && { [ "$with_tests" = no ] || { fresh tests "$dependencies" && tree_is_here; }; } &&
    "$vpy" -c 'import feltmb._core' 2>/dev/null; then
    say '  feltmb is up to date'
    return 0
  fi
  # tools/test.sh links its C++ tests to this core, in which warnings are errors.
  if [ "$with_tests" = yes ]; then
    extra='test' of_unmodeled='./unmodeled[test]' strict=(--config-settings=cmake.define.FELTMB_WERROR=ON)
  fi
  rm -f "$venv"/feltmb.sources
  mapfile -t requirements < <(build_requirements)
  "$vpy" -c 'import feltmb' 2>/dev/null ||
    say '  the first time: about 100 MB of Python packages (500 MB on disk) and the compilation, 1 to 6 minutes'
  # Built with the environment's own tools: an isolated build would compile everything anew.
  step 'build tools' pip install "${requirements[@]}" ||
    die 'The build tools could not be installed.'
  step "unmodeled and feltmb (compiling with $CMAKE_BUILD_PARALLEL_LEVEL at a time)" build_and_install ||
    die 'unmodeled and feltmb could not be built or installed.'
  step 'import check' "$vpy" -c 'import feltmb, feltmb._core' ||
    die 'feltmb was installed and cannot be imported.'
  stamp sources "$sources"
  [ "$with_tests" = no ] || stamp tests "$dependencies"
}

parallel_level() {  # min(cores, memory / 1.5 GB), at least 1
  local cores kilobytes limit level
  cores=$(nproc 2>/dev/null || echo 1)
  kilobytes=$(sed -n 's/^MemAvailable: *\([0-9]*\).*/\1/p' /proc/meminfo 2>/dev/null)
  limit=$(cat /sys/fs/cgroup/memory.max 2>/dev/null || echo max)
  kilobytes=${kilobytes:-1500000}
  [ "$limit" != max ] && [ $((limit / 1024)) -lt "$kilobytes" ] && kilobytes=$((limit / 1024))
  level=$((kilobytes / 1500000))
  [ "$level" -lt "$cores" ] || level=$cores
  [ "$level" -ge 1 ] || level=1
  printf '%d' "$level"
}

setup_feltmb() {
  with_tests=no
  [ "${1:-}" = --tests ] && with_tests=yes
  { mkdir -p build && touch "$log"; } 2>/dev/null || die "$root/build cannot be written; is this clone yours?"
  exec 9>build/setup.lock
  if command -v flock >/dev/null && ! flock -n 9; then
    say 'waiting for another set-up in this clone'
    flock 9
  fi
  : >"$log"
  trap 'printf "\ninterrupted\n" >&2; exit 130' INT
  say "set-up (log in $(short "$log"))"
  export CMAKE_BUILD_PARALLEL_LEVEL=${CMAKE_BUILD_PARALLEL_LEVEL:-$(parallel_level)}
  get_system_ready
  if [ -z "${CMAKE_GENERATOR:-}" ] && ! command -v make >/dev/null; then export CMAKE_GENERATOR=Ninja; fi
  make_environment
  make_pip
  install_package
  exec 9>&-
}

if [ "${BASH_SOURCE[0]}" = "$0" ]; then
  set -euo pipefail
  setup_feltmb "$@"
fi
