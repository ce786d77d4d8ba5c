"""The benchmark: frozen sets of scenes, each with a witness that it can be solved, and runs, reports, scaling."""
