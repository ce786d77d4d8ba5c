"""Tools that people would take instead, behind one interface; each needs what `comove[bench]` installs."""

from comove.experiments.systems import System

PEERS: dict[str, System] = {}
