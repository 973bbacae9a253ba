"""Figures, animations, tables and trajectory files. Figures use Matplotlib, with one style file."""
