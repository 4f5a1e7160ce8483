"""Helper of planted: one function for each kind of defect."""
