"""Windows around elements, and the discriminant of whole and composite tiles."""
