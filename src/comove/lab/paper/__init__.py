"""The reproduction of the paper: runs, then pictures, tables and claims, then one page."""
