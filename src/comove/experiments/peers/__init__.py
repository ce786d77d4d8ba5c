"""Tools that people would take instead, behind one interface; each needs what `comove[bench]` installs."""
