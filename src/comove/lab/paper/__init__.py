"""Reproduction of the paper: runs, pictures, tables, claims and page."""
