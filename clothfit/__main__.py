"""`python -m clothfit` is the `clothfit` command."""

from clothfit.cli import main

main()
