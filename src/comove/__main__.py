"""`python -m comove`."""

from comove.cli import main

main()
