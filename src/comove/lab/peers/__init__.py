"""Other tools for the same problems, as systems; each needs packages that `comove[bench]` installs."""
