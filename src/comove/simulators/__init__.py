"""Simulators: joint motions in real physics."""
