"""What is simulated, and how: the scene, its start, its settings, its files."""
