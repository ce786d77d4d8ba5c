"""Datasets of verified episodes, in formats for policy learning."""

from comove.data.datasets.export import FORMATS, DatasetFormat, export_episodes

__all__ = ["FORMATS", "DatasetFormat", "export_episodes"]
