"""Figures, notebooks and the workbench in the browser."""
