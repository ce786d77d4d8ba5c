"""Scene files: keys, versions, and obstacles that other files describe."""
