"""What people look at: figures and animations. Matplotlib throughout, with one style file."""
