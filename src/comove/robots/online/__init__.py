"""Execution of carries step by step: measured joints in, commanded joints out, among obstacles that move."""
