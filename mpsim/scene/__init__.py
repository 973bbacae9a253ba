"""What is simulated, and how: the scene, its initial state, its settings, its files."""
