"""What all texture models share: drawing, departures, random fields, and the base class of a model."""
