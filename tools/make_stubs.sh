#!/usr/bin/env bash
# Writes python/feltmb/_core.pyi from the built extension; run it when the bindings change.
# Usage: bash tools/make_stubs.sh [PYTHON]   (a Python in which feltmb is installed)
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-.venv/bin/python}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
"$python" -m pybind11_stubgen feltmb._core -o "$out" --ignore-all-errors
{ find "$out" -name '_core.pyi' -exec cat {} +; find "$out" -path '*_core/__init__.pyi' -exec cat {} +; } \
  > python/feltmb/_core.pyi
"$python" -m ruff check --quiet --select I --fix python/feltmb/_core.pyi || true
"$python" -m ruff format --quiet python/feltmb/_core.pyi
