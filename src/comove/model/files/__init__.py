"""Scene files: keys, versions, and obstacles described by other files."""
