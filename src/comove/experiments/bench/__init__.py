"""The benchmark: frozen sets of scenes, each with a witness that it can be solved; runs, reports, scaling."""
