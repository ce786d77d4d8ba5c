"""Other tools for the same problems, as systems. Each needs packages that `comove[bench]` installs."""
