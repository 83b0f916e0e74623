#!/usr/bin/env bash
# Installs what is missing, builds feltmb, and runs its main job:
#   bash tools/run.sh [options of `feltmb demo`]
# Results are written to the folder out.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

setup_feltmb
"$vpy" -c 'import feltmb._core' || die 'feltmb is installed and cannot be imported.'

cd "$start_dir"
say "feltmb demo --out out${*:+ $*}"
mkdir -p out
"$venv/bin/feltmb" demo --out out "$@"

# A small diagnosis on measured data: the model lacks the friction of the guide.
say 'unmodeled diagnose unmodeled/examples/emps.py'
"$venv/bin/unmodeled" diagnose "$root/unmodeled/examples/emps.py" "$root"/unmodeled/examples/data/emps_*.csv \
  -o out/gap --force

say "more: $(short "$venv")/bin/feltmb --help"
