"""What an eye sees of a picture, and the limits of what counts."""
