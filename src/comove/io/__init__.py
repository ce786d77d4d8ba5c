"""Reading and writing of whole files: paths, free space, atomic replacement, archives of arrays, entries of JSON."""
