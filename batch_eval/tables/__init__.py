"""The tables of `docs/benchmarks.md`, subject by subject; `report.py` puts them together."""
