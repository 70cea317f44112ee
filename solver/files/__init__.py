"""Text to scenes and back."""
