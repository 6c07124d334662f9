"""The commands by subject; `weberwhisk.cli` puts them together.

Conventions that every command keeps, beside those of `weberwhisk.cli`:

- Lengths are in millimetres, radii in micrometres, angles in degrees, forces in micronewtons, and
  every option's and column's name says so. Lists are comma-separated, or the option is repeated.
- ``--out`` names the folder for tables, figures and the record (see `weberwhisk.output`),
  ``--json`` prints the result alone on standard output, ``--seed`` makes a draw repeatable.
"""
