"""``python -m unmodeled``: the command line."""

from unmodeled.cli import main

main()
