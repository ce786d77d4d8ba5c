"""Benchmark: frozen scenes with witnesses, runs, reports and scaling."""
