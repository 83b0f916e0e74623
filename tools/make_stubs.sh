#!/usr/bin/env bash
# Writes python/feltmb/_core/*.pyi from the built extension; run it when the bindings change.
# Usage: bash tools/make_stubs.sh [PYTHON]   (a Python in which feltmb is installed)
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-.venv/bin/python}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
"$python" -m pybind11_stubgen feltmb._core -o "$out" --ignore-all-errors
rm -rf python/feltmb/_core
mkdir -p python/feltmb/_core
cp "$out"/feltmb/_core/*.pyi python/feltmb/_core/
# Fields given by keyword are checked by the core, see cpp/bindings/fields.hpp.
sed -i 's|[*][*]kwargs)|**kwargs: typing.Any)|' python/feltmb/_core/*.pyi
"$python" -m ruff check --quiet --select I --fix --no-force-exclude python/feltmb/_core || true
"$python" -m ruff format --quiet --no-force-exclude python/feltmb/_core
