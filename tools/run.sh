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
"$venv/bin/feltmb" demo --out out "$@"

# A small diagnosis on measured data: the model lacks the friction of the guide.
say 'feltmb gap diagnose examples/gap/emps.py'
"$venv/bin/feltmb" gap diagnose "$root/examples/gap/emps.py" "$root"/examples/gap/data/emps_*.csv \
  -o out/gap --force

# A small diagnosis: records of an action whose shank bends more than the nominal's.
say "feltmb gap diagnose steinway45 examples/gap_action/small/*.csv -o out/gap_action"
"$venv/bin/feltmb" gap diagnose steinway45 "$root"/examples/gap_action/small/*.csv \
  -o out/gap_action --force --bootstrap 0 --max-effects 1 \
  --set shooting=single --set rtol=1e-6 --set channels=key,whippen,hammer \
  --set tolerances=let_off_button,capstan_height,felt.03,felt.06,joint_friction.butt,mass.head \
  --set "effects=coulomb_friction.butt,coulomb_friction.key,felt_relaxation.02,felt_thickness.06,shank_compliance,wire_compliance,spring_preload.butt_spring,string_impedance,backcheck_wire_angle,camera_skew,load_cell_mass"
say "more: $(short "$venv")/bin/feltmb --help"
