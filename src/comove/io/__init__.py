"""Reading and writing of whole files: paths, atomic replacement, archives of arrays, entries of JSON, strict YAML."""
