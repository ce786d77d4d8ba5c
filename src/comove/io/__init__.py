"""Reading and writing of whole files. Paths, atomic replacement, archives of arrays, entries of JSON, strict YAML."""
