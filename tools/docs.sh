#!/usr/bin/env bash
# Builds the site into build/docs, offline once the packages are there:
#   bash tools/docs.sh [--fast]
# Warnings are errors, links to pages and headings are checked. --fast does not run the notebooks.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"

notebooks=force
[ "${1:-}" = --fast ] && notebooks=off

setup_feltmb
mapfile -t packages < <(pyproject_list project optional-dependencies docs)
wanted=$(printf '%s\n' "${packages[@]}" | sha256sum)
if ! fresh docs "$wanted"; then
  step 'packages of the site' pip install "${packages[@]}" || die 'The packages of the site could not be installed.'
  stamp docs "$wanted"
fi
# Actions to play with in the browser, if the module of `feltmb page` is there. docs/conf.py links them.
pages=build/pages/actions
rm -rf build/pages && mkdir -p "$pages"
if "$vpy" -c 'import sys; from feltmb.live.page import MODULE; sys.exit(not MODULE.is_file())'; then
  for action in steinway45_leaded grand_action; do
    step "page of $action" "$vpy" -m feltmb page "$action" -o "$pages/$action.html" ||
      die "The page of $action could not be written."
  done
else
  say '  without pages of actions: their module is not built; bash tools/wasm.sh builds it'
fi
# Read anew, since the code that notebooks run may have changed.
FELTMB_DOCS_NOTEBOOKS=$notebooks "$vpy" -m sphinx --builder html --fail-on-warning --fresh-env --quiet \
  --doctree-dir build/docs-doctrees docs build/docs
say "wrote $(short "$root/build/docs/index.html")"
