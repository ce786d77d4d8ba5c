"""Datasets of verified episodes, in the formats from which policies learn."""

from comove.data.datasets.export import FORMATS, DatasetFormat, export_episodes

__all__ = ["FORMATS", "DatasetFormat", "export_episodes"]
