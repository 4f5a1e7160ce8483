"""Wang tiles: tiles that fit where the colors of their edges agree."""
