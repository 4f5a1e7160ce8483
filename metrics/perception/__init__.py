"""What an eye sees of a picture."""
