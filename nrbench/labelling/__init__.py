"""Pages on which people label outputs, and the answers that the pages save."""
