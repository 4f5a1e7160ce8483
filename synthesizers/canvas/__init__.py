"""The canvas on which patch methods lay their patches, and the seams along which patches are joined."""
