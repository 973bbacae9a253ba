"""Measuring: how fast a run is, and how right."""
