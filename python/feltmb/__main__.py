"""``python -m feltmb``."""

from feltmb.cli import main

main()
